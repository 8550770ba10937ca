"""Calibration files of OpenCV's FileStorage: YAML or JSON to plain data."""

import re
from pathlib import Path
from typing import Any

import yaml

from lightopt.core.errors import InputError


class _Loader(yaml.SafeLoader):
    """Plain data; ``!!opencv-matrix`` and its kin are mappings."""


_Loader.add_multi_constructor(
    "tag:yaml.org,2002:opencv-", lambda loader, _, node: loader.construct_mapping(node, deep=True)
)


def read_opencv_file(path: Path) -> dict[str, Any]:
    """Content of a calibration file by its keys; a matrix (rows, cols, data) becomes a list of its rows.

    Raises InputError: The file cannot be read, or is not YAML or JSON with keys at the top
    """
    try:
        text = path.read_text(encoding="utf-8")
        # OpenCV writes %YAML:1.0, which no YAML parser takes; JSON is YAML, but for tabs between its words
        data = yaml.load(re.sub(r"\A%YAML.*", "", text).replace("\t", " "), Loader=_Loader)  # noqa: S506 - a safe loader
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}; expected a calibration file") from None
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(f"{path}: expected YAML or JSON in UTF-8: {' '.join(str(error).split())}") from None
    if not isinstance(data, dict):
        raise InputError(f"{path}: expected keys such as camera_matrix at the top, found {type(data).__name__}")
    return {str(key): _rows(value) for key, value in data.items()}


def _rows(value: Any) -> Any:
    if not isinstance(value, dict) or not {"rows", "cols", "data"} <= value.keys():
        return value
    columns, data = int(value["cols"]), value["data"]
    return [data[first : first + columns] for first in range(0, len(data), columns)]
