"""Kinds of values in the files, each with a description of what is expected, and how errors are reported."""

import contextlib
import math
import os.path
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal, TypeVar, cast

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
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from lightopt.config._source_file import Source

MOST_POINTS = 65_536

Value = TypeVar("Value")


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


Complaint = tuple[tuple[str | int, ...], object, PydanticCustomError]


class Frozen(BaseModel):
    """Base of all configuration: unknown keys are errors, nothing is converted, numbers are finite.

    The text below a key describes it in the schema and in messages.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


class FileConfig(Frozen):
    """Base of what a whole file holds."""

    _source: Source = PrivateAttr(default=Source(Path("<built in code>"), ""))

    @property
    def source(self) -> Source:
        return self._source


def complaint(reason: str) -> PydanticCustomError:
    return PydanticCustomError("complaint", "{reason}", {"reason": reason})


def absent(reason: str, *keys: str) -> PydanticCustomError:
    """Error that one of these keys is missing from the mapping around the field."""
    return PydanticCustomError("absent", "{reason}", {"reason": reason, "keys": keys})


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


def only_of_driver(owner: str, value: Value, info: ValidationInfo, *, missing: str | None) -> Value:
    """A value that only one driver has, and which that driver needs where there is a message for its absence."""
    driver = info.data.get("driver")
    if driver == owner and value is None and missing is not None:
        raise absent(missing, str(info.field_name))
    if driver not in (None, owner) and value is not None:
        raise complaint(f"only driver: {owner} has this, and the driver is {driver}; leave this out")
    return value


def exactly_one(value: object, info: ValidationInfo, *, other: str, missing: str) -> None:
    """Refuse a value together with that of the field `other`, which is right by itself, and the absence of both."""
    if value is None and info.data[other] is None:
        raise absent(missing, other, str(info.field_name))
    if value is not None and info.data[other] is not None:
        raise complaint(f"given together with {other}; expected only one of them")


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
        yield (i, "name"), names[i], complaint(f'the name "{names[i]}" is already that of {where}[{first}]{why}')


def with_complaints(value: object, handler: ValidatorFunctionWrapHandler, complaints: Iterable[Complaint]) -> Any:
    """Validate a value, and report complaints about it together with what the validation finds."""
    more = [InitErrorDetails(type=error, loc=loc, input=found) for loc, found, error in complaints]
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
ElevationRange = Annotated[
    tuple[Elevation, Elevation], LIST, ASCENDING, expecting("[low, high], two numbers between 0 and 180 (degrees)")
]
AzimuthRange = Annotated[
    tuple[Azimuth, Azimuth], LIST, ASCENDING, expecting("[low, high], two numbers from -360 to 360 (degrees)")
]
Distance = Annotated[
    float,
    Field(ge=0, le=1e6),
    expecting("a length between 0.001 and 1000000 (a number); a light around the part may be at 0"),
]
DistanceRange = Annotated[
    tuple[Distance, Distance], LIST, ASCENDING, expecting("[low, high], two lengths from 0 to 1000000")
]
Tilt = Annotated[float, Field(ge=-180, le=180), expecting("a number from -180 to 180 (degrees of tilt)")]
TiltRange = Annotated[
    tuple[Tilt, Tilt], LIST, ASCENDING, expecting("[low, high], two numbers from -180 to 180 (degrees)")
]
Coordinates = Annotated[tuple[Number, Number, Number], LIST, expecting("[x, y, z], three numbers up to 1000000")]


def _some_way(direction: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(direction):
        raise complaint("expected [x, y, z], three numbers that are not all 0")
    return direction


Direction = Annotated[Coordinates, AfterValidator(_some_way)]
Size = Annotated[
    tuple[Length, Length], LIST, expecting("[along azimuth, along elevation], two lengths between 0.001 and 1000000")
]
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


def require_file(folder: Path, file: str) -> None:
    """Raise unless a file exists, with its full path and a file of similar name."""
    path = folder / file
    is_folder, near = False, list[str]()
    with contextlib.suppress(OSError, ValueError):
        if path.is_file():
            return
        is_folder = path.is_dir()
        near = get_close_matches(path.name, sorted(p.name for p in path.parent.iterdir()), n=1, cutoff=0.5)
    full_path = os.path.normpath(folder.resolve() / file)
    if is_folder:
        raise complaint(f"{full_path} is a folder; expected a file")
    hint = f'; did you mean "{(PurePath(file).parent / near[0]).as_posix()}"?' if near else ""
    if "\\" in file and os.sep == "/":
        hint = "; separate folders with / , which works everywhere"
    raise complaint(f"no such file: {full_path}{hint}")
