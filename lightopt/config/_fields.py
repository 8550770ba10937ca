"""Kinds of values in the files, each with a description of what is expected, and how errors are reported."""

import contextlib
import math
import os.path
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path, PurePath
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, cast

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PrivateAttr,
    StringConstraints,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    field_validator,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from lightopt.config._strict_yaml import Source
from lightopt.core.errors import did_you_mean

MOST_POINTS = 65_536


def points_problem(points: int | str) -> str | None:
    """Message about a number of point lights; None for a square up to `MOST_POINTS`, and for auto."""
    if points == "auto":
        return None
    near = f"; at most {MOST_POINTS}" if isinstance(points, int) and points > MOST_POINTS else ""
    if isinstance(points, int) and 1 <= points <= MOST_POINTS:
        k = math.isqrt(points)
        if k * k == points:
            return None
        near = f"; the nearest are {k * k} and {(k + 1) ** 2}"
    return f"expected a square (1, 4, 9, 16, …) or auto, found {points}{near}"


Handler = ValidatorFunctionWrapHandler
Fault = str | PydanticCustomError  # what is wrong: the message, or the error where it has a kind of its own
Complaint = tuple[tuple[str | int, ...], Fault]  # the path of keys in a value, and what is wrong there


class Variants(NamedTuple):
    """Keys that a mapping has by the value of one of its keys."""

    by: str
    kinds: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]]  # of each value the keys that it needs, and others
    usual: Mapping[str, object] = MappingProxyType({})  # values of such keys that do no harm elsewhere


class Frozen(BaseModel):
    """Base of all configuration: unknown keys are errors, nothing is converted, numbers are finite.

    The text below a key describes it in the schema and in messages.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )

    one_of: ClassVar[tuple[str, ...]] = ()  # keys of which a file has exactly one
    variants: ClassVar[Variants | None] = None

    @model_validator(mode="wrap")
    @classmethod
    def _keys_together(cls, value: object, handler: ValidatorFunctionWrapHandler) -> Any:
        return with_complaints(value, handler, cls.misfits(value) if isinstance(value, Mapping) else ())

    @classmethod
    def misfits(cls, raw: Mapping[str, Any]) -> "Iterator[Complaint]":
        """What does not fit together of the keys of a mapping, whose values may be wrong."""
        yield from one_of_misfits(cls.one_of, raw)
        if cls.variants is None:
            return
        by, kinds, usual = cls.variants
        kind = raw.get(by, cls.model_fields[by].default)
        if not isinstance(kind, str) or kind not in kinds:
            return
        for key in kinds[kind][0]:
            if raw.get(key) is None:
                meaning = " ".join(str(cls.model_fields[key].description).split())
                yield (key,), absent(f'missing key "{key}": {meaning} {by.capitalize()} {kind} needs it', key)
        for key, value in raw.items():
            owners = [name for name, keys in kinds.items() if key in keys[0] + keys[1]]
            if owners and kind not in owners and value not in (None, usual.get(key)):
                yield (key,), f"{by} {kind} has no such key; it belongs to {', '.join(owners)}"


class FileConfig(Frozen):
    """Base of what a whole file holds."""

    _source: Source = PrivateAttr(default=Source(Path("<built in code>"), ""))

    @property
    def source(self) -> Source:
        return self._source


def complaint(reason: str) -> PydanticCustomError:
    return PydanticCustomError("complaint", "{reason}", {"reason": reason})


def _error(fault: Fault) -> PydanticCustomError:
    return complaint(fault) if isinstance(fault, str) else fault


def rule(*keys: str) -> Callable[[Callable[[Any, Any, ValidationInfo], Iterator[Fault]]], Any]:
    """Make a validator of keys from a class method that yields what is wrong with a value, given those before it."""

    def validator(faults: Callable[[Any, Any, ValidationInfo], Iterator[Fault]]) -> Any:
        def check(cls: Any, value: object, info: ValidationInfo) -> object:
            for fault in faults(cls, value, info):
                raise _error(fault)
            return value

        return field_validator(*keys)(classmethod(check))

    return validator


def absent(reason: str, *keys: str) -> PydanticCustomError:
    """Error that one of these keys is missing from the mapping around the field."""
    return PydanticCustomError("absent", "{reason}", {"reason": reason, "keys": keys})


def one_of_misfits(keys: Sequence[str], raw: Mapping[str, Any]) -> "Iterator[Complaint]":
    """Refuse a mapping that has several of these keys, or none of them."""
    given = [key for key in keys if raw.get(key) is not None]
    if keys and not given:
        names = [f'"{key}"' for key in keys]
        missing = f"missing key {', '.join(names[:-1])} or {names[-1]}: expected one of them"
        yield (keys[0],), absent(missing, *keys)
    if len(given) > 1:
        yield (given[-1],), f"given together with {given[0]}; expected only one of them"


def expecting(what: str) -> WrapValidator:
    """Report whatever is wrong with a value as: expected `what`, found the value."""

    def check(value: object, handler: ValidatorFunctionWrapHandler) -> object:
        try:
            return handler(value)
        except ValidationError as error:
            if any(e["type"] == "complaint" for e in error.errors(include_url=False)):
                raise
            raise PydanticCustomError("expected", "expected {expected}", {"expected": what}) from None

    return WrapValidator(check)


def that(holds: Callable[[Any], bool], reason: str) -> AfterValidator:
    """Refuse values for which something does not hold."""

    def check(value: object) -> object:
        if not holds(value):
            raise complaint(reason)
        return value

    return AfterValidator(check)


def repeated(keys: Iterable[Hashable | None]) -> Iterator[tuple[int, int]]:
    """Indices of keys that came before, each with the index of the first; None is passed over."""
    first: dict[Hashable, int] = {}
    for i, key in enumerate(keys):
        if key is not None and first.setdefault(key, i) != i:
            yield i, first[key]


def value_of(entry: object, key: str) -> Any:
    """Value of an entry's key, whether it was read from a file or is a model already."""
    return entry.get(key) if isinstance(entry, dict) else getattr(entry, key, None)


def mapping(value: object) -> Mapping[str, Any]:
    """A value of a file as a mapping; empty where it is none."""
    return cast("Mapping[str, Any]", value) if isinstance(value, Mapping) else {}


def entries(value: object) -> Sequence[object]:
    """A value of a file as a list; empty where it is none."""
    return cast("Sequence[object]", value) if isinstance(value, (list, tuple)) else ()


def same_names(items: Sequence[object], where: str, key: Callable[[str], str] = str) -> Iterator[Complaint]:
    """Complaints about entries of a list with the name of a previous one; `key`: what is the same of equal names."""
    names = [name if isinstance(name := value_of(item, "name"), str) else None for item in items]
    for i, first in repeated(None if name is None else key(name) for name in names):
        why = "" if names[i] == names[first] else " (upper and lower case are not distinguished)"
        yield (i, "name"), f'the name "{names[i]}" is already that of {where}[{first}]{why}'


def with_complaints(value: object, handler: ValidatorFunctionWrapHandler, complaints: Iterable[Complaint]) -> Any:
    """Validate a value, and report complaints about it together with what the validation finds."""
    more = [InitErrorDetails(type=_error(fault), loc=loc, input=None) for loc, fault in complaints]
    try:
        result = handler(value)
    except ValidationError as error:
        for e in error.errors(include_url=False):
            kind = PydanticCustomError(cast("Any", e["type"]), cast("Any", e["msg"]), e.get("ctx"))
            more.append(InitErrorDetails(type=kind, loc=e["loc"], input=e["input"]))
        raise ValidationError.from_exception_data("configuration", more) from None
    if more:
        raise ValidationError.from_exception_data("configuration", more)
    return result


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise complaint(f"expected [low, high], found the low end {pair[0]:g} above the high end {pair[1]:g}")
    return pair


def _square(points: int | str) -> int | str:
    if problem := points_problem(points):
        raise complaint(problem)
    return points


ASCENDING = AfterValidator(_ordered)
LIST = Field(strict=False)  # of fixed length; it becomes a tuple, which strict validation would refuse

Number = Annotated[float, Field(ge=-1e6, le=1e6), expecting("a number")]
Positive = Annotated[float, Field(gt=0, le=1e9), expecting("a number above 0, up to 1e9")]
Coefficient = Annotated[float, Field(ge=0, le=1e12), expecting("a number from 0 to 1e12")]
MOST_BOUNCES = 4
Bounces = Annotated[int, Field(ge=0, le=MOST_BOUNCES), expecting(f"a whole number from 0 to {MOST_BOUNCES}")]
Length = Annotated[float, Field(ge=1e-3, le=1e6), expecting("a length between 0.001 and 1000000 (a number)")]
ABOVE_TABLE = "a number between 0 and 180 (degrees above the table, ends excluded)"
Elevation = Annotated[float, Field(gt=0, lt=180), expecting(ABOVE_TABLE)]
Azimuth = Annotated[float, Field(ge=-360, le=360), expecting("a number from -360 to 360 (degrees about Z)")]
ElevationRange = Annotated[tuple[Elevation, Elevation], LIST, ASCENDING, expecting("[low, high] between 0 and 180 (°)")]
AzimuthRange = Annotated[tuple[Azimuth, Azimuth], LIST, ASCENDING, expecting("[low, high] from -360 to 360 (°)")]
Distance = Annotated[float, Field(ge=0, le=1e6), expecting("a length from 0 to 1000000 (a number)")]
DistanceRange = Annotated[tuple[Distance, Distance], LIST, ASCENDING, expecting("[low, high] from 0 to 1000000")]
Tilt = Annotated[float, Field(ge=-180, le=180), expecting("a number from -180 to 180 (degrees of tilt)")]
TiltRange = Annotated[tuple[Tilt, Tilt], LIST, ASCENDING, expecting("[low, high] from -180 to 180 (°)")]
Coordinates = Annotated[tuple[Number, Number, Number], LIST, expecting("[x, y, z], three numbers up to 1000000")]


Direction = Annotated[Coordinates, that(any, "expected [x, y, z], three numbers that are not all 0")]
Size = Annotated[tuple[Length, Length], LIST, expecting("[along azimuth, along elevation], two lengths")]
Points = Annotated[
    Annotated[int, Field(ge=1, le=MOST_POINTS)] | Literal["auto"],
    AfterValidator(_square),
    expecting(f"a square number of points from 1 to {MOST_POINTS} (1, 4, 9, 16, ...) or auto"),
]
Text = Annotated[
    str,
    StringConstraints(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$"),
    expecting("text of one line, up to 200 characters"),
]


def _portable(name: str) -> str:
    stem = name.partition(".")[0].upper()
    devices = {"CON", "PRN", "AUX", "NUL"} | {f"{port}{i}" for port in ("COM", "LPT") for i in range(1, 10)}
    if stem in devices or name.endswith("."):
        why = "Windows reserves" if stem in devices else "ends with a dot"
        raise complaint(f'expected a name that can be a file name, found "{name}", which {why}')
    return name


FileName = Annotated[
    str,
    StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_][A-Za-z0-9._-]*$"),
    AfterValidator(_portable),
    expecting("a name of letters, digits and . _ - (up to 64; it becomes a file name)"),
]


class PostureConfig(Frozen):
    """One posture of the stage."""

    elevation_deg: Tilt
    """Tilt of the cradle about X [deg]."""
    rotation_deg: Azimuth
    """Rotation of the part about the stage's own axis [deg]."""


def file_of(*suffixes: str) -> AfterValidator:
    """Refuse names that do not end in one of these, and of no file in the folder of the configuration."""

    def check(file: str, info: ValidationInfo) -> str:
        if suffixes and PurePath(file).suffix.lower() not in suffixes:
            raise complaint(f'expected a file ending in {", ".join(suffixes)}, found "{file}"')
        if info.context is not None:
            _require_file(info.context["folder"], file)
        return file

    return AfterValidator(check)


def _require_file(folder: Path, file: str) -> None:
    """Raise unless a file exists, with its full path and a file of similar name."""
    path, hint, is_folder = folder / file, "", False
    with contextlib.suppress(OSError, ValueError):
        if path.is_file():
            return
        is_folder = path.is_dir()
        hint = did_you_mean(path.name, sorted(p.name for p in path.parent.iterdir()), cutoff=0.5)
    if "\\" in file and os.sep == "/":
        hint = "; separate folders with / , which works everywhere"
    full_path = os.path.normpath(folder.resolve() / file)
    raise complaint(f"{full_path} is a folder; expected a file" if is_folder else f"no such file: {full_path}{hint}")
