"""Messages about what is wrong with a configuration."""

import json
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from lightopt.config._strict_yaml import INVALID, Document, Keys, Problem, is_number

_LONGEST = 60
_EXPECTED = ("expected", "literal_error")  # kinds of errors that name what is expected

# names of units, by the end of the keys that carry them
_UNITS = {"deg": "degrees", "rad": "radians", "um": "µm", "inch": "inches", "px": "pixels"}
_UNITS.update((unit, unit) for unit in ("mm", "cm", "m"))


def describe(value: object) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, Mapping):
        return f"keys and values ({', '.join(map(str, value))})"[:_LONGEST] if value else "{}"
    text = json.dumps(value, ensure_ascii=False, default=repr)
    shown = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
    return f"{shown} in quotes" if isinstance(value, str) and is_number(value) else shown


def model_problems(model: type[BaseModel], errors: Sequence[ErrorDetails], document: Document) -> list[Problem]:
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
    found = f"found {describe(error['input'])}"
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
    message = f"unknown key {describe(key).removesuffix(' in quotes')}"
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
    """Known key that is probably meant, by the path of the unknown key."""
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
