"""Options that several commands take, and how their texts are read."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from lightopt.core.errors import InputError

if TYPE_CHECKING:
    from lightopt.core.transforms import Posture


RigFile = Annotated[Path, typer.Argument(metavar="RIG", help="Rig file (YAML): camera, lights, stage.")]
PartFile = Annotated[
    Path, typer.Argument(metavar="PART", help="Part file (YAML): mesh, postures, reflectance.")
]
Out = Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Output folder; made if missing.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite existing results.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")]
Postures = Annotated[
    list[str] | None,
    typer.Option(
        "--posture", metavar="θ,φ", help="This tilt and rotation [deg] instead of the part's; repeatable."
    ),
]
Lights = Annotated[
    list[str] | None, typer.Option("--light", metavar="NAME", help="Only this light; repeatable.")
]
Sheet = Annotated[
    bool,
    typer.Option(
        "--sheet", help="Also a labelled contact sheet of all images, contact-sheet.png; one per exposure."
    ),
]
Points = Annotated[
    str | None,
    typer.Option(metavar="M", help="Point lights per panel: 1, 4, 9, 16, … or auto, the converged panel."),
]
NoShadows = Annotated[bool, typer.Option("--no-shadows", help="The part casts no shadows.")]
Patches = Annotated[
    int | None, typer.Option(metavar="N", help="About how many surface patches may be visible. [200000]")
]
Threads = Annotated[
    int | None, typer.Option(metavar="N", help="Threads; all by default. The files do not depend on it.")
]


LEAST_EXPOSURE, MOST_EXPOSURE = 1e-9, 1e9
"""Relative to exposure 1; it is a part of file names."""


def make_folder(folder: Path) -> None:
    """Make an output folder; an InputError says why where that fails."""
    from lightopt.images import make_folder as make

    make(folder)


def parse_posture(text: str) -> Posture:
    """Read ``θ,φ`` in degrees."""
    from lightopt.core.transforms import Posture

    parts = text.split(",")
    try:
        elevation, rotation = (float(part) for part in parts)
    except ValueError:
        elevation = rotation = math.nan
    if not (math.isfinite(elevation) and math.isfinite(rotation)):
        raise InputError(f'--posture: expected elevation,rotation in degrees such as 0,82, found "{text}"')
    return Posture(elevation, rotation)


def parse_exposure(text: str, *, option: str = "--exposure") -> float:
    """Read a number or a fraction such as 1/16, given with an option."""
    value = _number(text)
    if not LEAST_EXPOSURE <= value <= MOST_EXPOSURE:
        raise InputError(
            f"{option}: expected a number from {LEAST_EXPOSURE:g} to {MOST_EXPOSURE:g} or a fraction such as 1/16, "
            f'found "{text}"'
        )
    return value


def parse_share(text: str, *, option: str, expected: str) -> float:
    """Read a number, a fraction such as 10/255, or per cent such as 95%; whether it is in its range is not looked at.

    expected: What it is a share of and an example, for the message
    """
    number, percents, rest = text.partition("%")
    value = _number(number) / (100.0 if percents else 1.0)
    if rest or not math.isfinite(value):
        raise InputError(f'{option}: expected a share {expected}, found "{text}"')
    return value


def _number(text: str) -> float:
    # of a number or a fraction; nan where it is neither
    try:
        return float(Fraction(text))
    except (ValueError, ZeroDivisionError, OverflowError):
        return math.nan


def parse_points(text: str) -> int | Literal["auto"]:
    """Read the number of point lights of a panel."""
    if text == "auto":
        return "auto"
    try:
        return int(text)
    except ValueError:
        raise InputError(f'--points: expected a square (1, 4, 9, 16, …) or auto, found "{text}"') from None
