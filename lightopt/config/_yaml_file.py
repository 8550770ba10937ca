"""Read a YAML file of a kind, everything wrong with it at once, each with its line; and calibration files of OpenCV."""

import hashlib
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import ValidationError

from lightopt.config._fields import FileConfig
from lightopt.config._messages import describe, model_problems
from lightopt.config._strict_yaml import Document, Keys, Problem, Source, YamlError, dotted, parse
from lightopt.core.errors import InputError, did_you_mean

MAX_BYTES = 1_000_000
_KINDS = {
    "lightopt-rig": "a rig",
    "lightopt-part": "a part",
    "lightopt-images": "an image set",
    "lightopt-targets": "the targets of a calibration",
    "lightopt-sensor": "the data sheet of a sensor",
    "lightopt-ranges": "the ranges of a dataset",
    "lightopt-batch": "the jobs of a batch",
}

Config = TypeVar("Config", bound=FileConfig)
Misfits = Callable[[Mapping[str, Any]], Iterable[tuple[Keys, str]]]


def load_file(path: Path, model: type[Config], expected: str, misfits: Misfits | None = None) -> Config:
    """Read a YAML file of a kind and version.

    misfits: What else is wrong, by its keys; it is given plain data, of which any value may be wrong
    Raises lightopt.core.errors.InputError: With one message per thing that is wrong, sorted by line
    """
    data = read_bytes(path, expected)
    try:
        text = decode(data, path)
        document = parse(text)
    except YamlError as error:
        raise _error(path, [error.problem]) from None
    if document.data is None and not document.problems:
        raise InputError(f'{path}: the file is empty; expected {_kind(expected)} that begins "format: {expected}"')
    if problems := _wrong_kind(document, expected):
        raise _error(path, problems)
    more = misfits(document.data) if misfits is not None and isinstance(document.data, dict) else ()
    problems = [*document.problems, *(Problem(document.line(keys), keys, message) for keys, message in more)]
    try:
        config = model.model_validate(document.data, context={"folder": path.parent})
    except ValidationError as error:
        problems += model_problems(model, error.errors(include_url=False), document)
        raise _error(path, problems) from None
    if problems:
        raise _error(path, problems)
    config._source = Source(path, hashlib.sha256(data).hexdigest(), document.lines, text)
    return config


def _error(path: Path, problems: list[Problem]) -> InputError:
    messages: list[str] = []
    for p in sorted(problems, key=lambda p: p.line):
        text = f"{dotted(p.keys)}: {p.message}" if p.keys else p.message
        # what a terminal would not show, or obey, is written as an escape
        printable = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
        messages.append(f"{path}:{p.line}: {printable}")
    return InputError(*messages)


def _kind(format_: str) -> str:
    return _KINDS.get(format_.partition("/")[0], "a file of another kind")


def _wrong_kind(document: Document, expected: str) -> list[Problem]:
    """Problems that make it pointless to compare the file with the model key by key."""
    if not isinstance(document.data, dict):
        message = f'expected {_kind(expected)}, keys and values that begin "format: {expected}"'
        return document.problems or [Problem(1, (), f"{message}; found {describe(document.data)}")]
    found = document.data.get("format")
    if not isinstance(found, str) or found == expected:
        return []
    line = document.lines["format",]
    message = f'expected {expected}, found "{found[:60]}"'
    name, _, version = found.partition("/")
    if name in _KINDS and name != expected.partition("/")[0]:
        message = f"this is {_kind(found)} ({found}); expected {_kind(expected)} ({expected})"
    elif name in _KINDS and version:
        message += "; this lightopt reads version 1 only"
    return [*document.problems, Problem(line, ("format",), message)]


def read_bytes(path: Path, expected: str) -> bytes:
    try:
        if path.is_dir():
            raise InputError(f"{path}: this is a folder; expected the YAML file of {_kind(expected)}")
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file{_near(path)}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(data) > MAX_BYTES:
        raise InputError(f"{path}: larger than 1 MB; this is not {_kind(expected)} file")
    return data


def _near(path: Path) -> str:
    try:
        names = sorted(p.name for p in path.parent.iterdir() if p.is_file())
    except OSError:
        return f"; the folder {path.parent} is not there either"
    return did_you_mean(path.name, names, cutoff=0.5)


def decode(data: bytes, path: Path) -> str:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{path}: the text is UTF-16; save the file as UTF-8")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        byte = f"0x{data[error.start]:02x}"
        raise InputError(f"{path}:{line}: byte {byte} is not UTF-8 text; expected YAML, saved as UTF-8") from None
    if "\0" in text:
        raise InputError(f"{path}: this is a binary file; expected YAML text")
    return text


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
