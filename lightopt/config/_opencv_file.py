"""Calibration files of OpenCV's FileStorage and of tools that write alike: YAML or JSON to plain data."""

import json
import re
from pathlib import Path
from typing import Any, cast

import yaml

from lightopt.core.errors import InputError

_HEADER = re.compile(r"\A%YAML[^\n]*\n")  # OpenCV writes %YAML:1.0, which no YAML parser takes


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
        if path.suffix.lower() == ".json":
            data = json.loads(text)
        else:
            data = yaml.load(_HEADER.sub("\n", text), Loader=_Loader)  # noqa: S506 - a safe loader
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}; expected a calibration file") from None
    except json.JSONDecodeError as error:
        raise InputError(f"{path}:{error.lineno}: not valid JSON: {error.msg}") from None
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise InputError(f"{path}:{line}: not valid YAML: {error.problem}") from None
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(f"{path}: expected YAML or JSON in UTF-8: {error}") from None
    if not isinstance(data, dict):
        raise InputError(f"{path}: expected keys such as camera_matrix at the top, found {type(data).__name__}")
    return {str(key): _plain(value) for key, value in data.items()}


def _plain(value: object) -> object:
    if isinstance(value, dict):
        fields = cast("dict[str, Any]", value)
        rows, columns, data = (fields.get(key) for key in ("rows", "cols", "data"))
        if (
            isinstance(rows, int)
            and isinstance(columns, int)
            and isinstance(data, list)
            and len(data) == rows * columns
        ):
            return [data[row * columns : (row + 1) * columns] for row in range(rows)]
        return {str(key): _plain(inner) for key, inner in fields.items()}
    return value
