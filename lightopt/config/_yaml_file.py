"""Read a YAML file of a kind, everything wrong with it at once, each with its line; and calibration files of OpenCV."""

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from lightopt.config._fields import FileConfig
from lightopt.config._strict_yaml import INVALID, Document, Keys, Problem, Source, YamlError, dotted, is_number, parse
from lightopt.core.errors import InputError, did_you_mean

MAX_BYTES = 1_000_000
_LONGEST = 60
_EXPECTED = ("expected", "literal_error")  # kinds of errors that name what is expected

# names of units, by the end of the keys that carry them
_UNITS = {"deg": "degrees", "rad": "radians", "um": "µm", "inch": "inches", "px": "pixels"}
_UNITS.update((unit, unit) for unit in ("mm", "cm", "m"))
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
        problems += _model_problems(model, error.errors(include_url=False), document)
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
        return document.problems or [Problem(1, (), f"{message}; found {_describe(document.data)}")]
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


def _describe(value: object) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, Mapping):
        return f"keys and values ({', '.join(map(str, value))})"[:_LONGEST] if value else "{}"
    text = json.dumps(value, ensure_ascii=False, default=repr)
    shown = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
    return f"{shown} in quotes" if isinstance(value, str) and is_number(value) else shown


def _model_problems(model: type[BaseModel], errors: Sequence[ErrorDetails], document: Document) -> list[Problem]:
    """Problems of a document that does not fit a model, except where they are already reported."""
    meant = _suggestions(model, errors)
    covered = {(*loc[:-1], known) for loc, known in meant.items()}
    problems: list[Problem] = []
    for error in errors:
        keys, kind = tuple(error["loc"]), error["type"]
        if keys and keys[-1] == "[key]":  # so pydantic calls what is wrong with the key of a mapping
            keys = keys[:-1]
        if error["input"] is INVALID or tuple(error["loc"]) in document.invalid:
            continue
        if kind in _EXPECTED and any(path[: len(keys)] == keys for path in document.invalid):
            continue  # a list with an invalid value in it
        if kind == "too_short" and len(error["input"]) >= error.get("ctx", {}).get("min_length", 1):
            continue  # pydantic does not count entries that are wrong themselves; those are reported
        wanted = {keys[-1]} if kind == "missing" else set(error.get("ctx", {}).get("keys", ()))
        if kind in ("missing", "absent", "extra_forbidden"):
            keys = keys[:-1]
        reported = keys in document.incomplete or any((*keys, w) in covered for w in wanted)
        if kind in ("missing", "absent") and reported:
            continue  # the key that was dropped or misspelt is reported
        place = tuple(error["loc"]) if kind == "extra_forbidden" else keys
        problems.append(Problem(document.line(place), keys, _message(model, error, meant)))
    return problems


def _message(model: type[BaseModel], error: ErrorDetails, meant: Mapping[Keys, str]) -> str:
    loc, kind, context = tuple(error["loc"]), error["type"], error.get("ctx", {})
    found = f"found {_describe(error['input'])}"
    if kind in ("complaint", "absent"):
        return str(context["reason"])
    if kind in _EXPECTED:
        expected = context["expected"].replace("'", "")  # pydantic puts each word of a Literal in quotes
        if expected.startswith(("a name", "text")) and isinstance(error["input"], (int, float)):
            found += "; put it in quotes to make it text"
        return f"expected {expected}, {found}"
    if kind == "missing":
        parent = _model_at(model, loc[:-1])
        field = parent.model_fields[str(loc[-1])] if parent else None
        return f'missing key "{loc[-1]}"' + (f": {' '.join(str(field.description).split())}" if field else "")
    if kind == "extra_forbidden":
        return _unknown_key(model, loc, meant.get(loc))
    if kind == "model_type":
        return f'expected keys and values ("key: value"), {found}'
    if kind == "tuple_type":
        return f"expected a list, {found}"
    if kind == "too_short":
        least = "one entry" if context["min_length"] == 1 else f"{context['min_length']} entries"
        return f"expected at least {least}, found {len(error['input']) or 'none'}"
    if kind == "too_long":
        return f"expected at most {context['max_length']} entries, found {context['actual_length']}"
    return f"this value cannot be used here: {found}"


def _unknown_key(model: type[BaseModel], loc: Keys, known: str | None) -> str:
    key = str(loc[-1])
    message = f"unknown key {_describe(key).removesuffix(' in quotes')}"
    if ":" in key:
        return f"{message}; put a space after the colon"
    if known is not None:
        return f'{message}; did you mean "{known}"?{_other_unit(key, known)}'
    parent = _model_at(model, loc[:-1])
    home = _home(model, parent, key)
    if home is not None:
        return f"{message}; it belongs to the entries of {home}: remove it, or move the entry there"
    return f"{message}; the keys here are {', '.join(parent.model_fields)}" if parent else message


def _home(model: type[BaseModel], parent: type[BaseModel] | None, key: str) -> str | None:
    """Key of a list whose entries have this key, where they extend the same keys as the mapping at hand."""
    bases = () if parent is None else (parent, *parent.__bases__)
    kinds = [base for base in bases if getattr(base, "model_fields", None)]
    more = tuple(m for kind in kinds for m in kind.__subclasses__() if key in m.model_fields)
    return next((name for name, field in model.model_fields.items() if _inner_model(field.annotation) in more), None)


def _other_unit(key: str, known: str) -> str:
    """What to do with the value where the key that is meant carries another unit."""
    found, expected = (_UNITS.get(name.lower().rpartition("_")[2]) for name in (key, known))
    if found is None or expected is None or found == expected:
        return ""
    return f" It is in {expected}: convert the value from {found}"


def _suggestions(model: type[BaseModel], errors: Sequence[ErrorDetails]) -> dict[Keys, str]:
    meant: dict[Keys, str] = {}
    for error in errors:
        loc = tuple(error["loc"])
        parent = _model_at(model, loc[:-1])
        if error["type"] != "extra_forbidden" or parent is None or _home(model, parent, str(loc[-1])):
            continue
        lower = {name.lower(): name for name in parent.model_fields}
        near = get_close_matches(str(loc[-1]).lower(), list(lower), n=1, cutoff=0.6)
        if near:
            meant[loc] = lower[near[0]]
    return meant


def _model_at(model: type[BaseModel], keys: Keys) -> type[BaseModel] | None:
    """Model that describes the mapping at a path of keys; None where the keys are names that the user gives."""
    here: Any = model
    named: Any = None  # model of the values of a mapping from names
    for key in keys:
        if isinstance(key, int):
            continue
        if named is not None:
            here, named = named, None
        elif here is None or key not in here.model_fields:
            return None
        else:
            annotation = here.model_fields[key].annotation
            here = _inner_model(annotation)
            if get_origin(annotation) is dict:
                here, named = None, here
    return here


def _inner_model(annotation: Any) -> type[BaseModel] | None:
    arguments = get_args(annotation)
    if not arguments:  # on Python 3.10 tuple[...] passes for a class
        return annotation if isinstance(annotation, type) and issubclass(annotation, BaseModel) else None
    return next((m for a in arguments if a is not Ellipsis and (m := _inner_model(a)) is not None), None)


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
