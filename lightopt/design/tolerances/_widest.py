"""The widest tolerance of one angle that keeps a score, all others being as they should."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from lightopt.design.tolerances._tolerances import LARGEST_TOLERANCE, Assess, Offset, corners

STEPS_PER_DEG = 20
"""Steps of the widest tolerances: they are multiples of 0.05°, and a step more does not keep the score."""

RUNGS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, LARGEST_TOLERANCE)
"""Tolerances that are tried before the first that costs too much is bisected [°]."""

Angle = tuple[str, str, int | None]
"""What is off, in which angle, and which light that is: the index, None for all of them or the part."""


@dataclass(frozen=True, kw_only=True)
class Widest:
    """How far one angle, or all of the lights', may be off.

    Attributes
    ----------
    what
        Name of the light, ``all lights``, or ``part``.
    angle
        ``elevation``, ``azimuth``, ``both angles at once``, ``tilt`` or ``rotation``.
    degrees
        The widest tolerance that keeps the score, every angle but these being as it should [°]; of those that were
        tried: the rungs, and multiples of 0.05° between the last that keeps it and the first that does not.
    open_ended
        Whether that is the widest that was looked for.
    """

    what: str
    angle: str
    degrees: float
    open_ended: bool


def angles(names: Sequence[str]) -> Iterator[Angle]:
    """Every angle that may be off alone, and those of all lights at once."""
    for light, name in enumerate(names):
        yield name, "elevation", light
        yield name, "azimuth", light
    yield "all lights", "both angles at once", None
    yield "part", "tilt", None
    yield "part", "rotation", None


def widest(assess: Assess, exact: Sequence[Sequence[Offset]], which: Angle, least: float) -> Widest:
    """How far an angle may be off while the score keeps what it must.

    Parameters
    ----------
    assess
        Scores offsets.
    exact
        Of each light: off by nothing.
    which
        One of :func:`angles`.
    least
        The score that is kept.
    """
    what, angle, light = which
    degrees, open_ended = _searched(assess, exact, angle, light, least)
    return Widest(what=what, angle=angle, degrees=degrees, open_ended=open_ended)


def _searched(
    assess: Assess, exact: Sequence[Sequence[Offset]], angle: str, light: int | None, least: float
) -> tuple[float, bool]:
    def keeps(degrees: float) -> bool:
        either: list[Offset] = [
            (sign * degrees, 0.0) if angle in ("elevation", "tilt") else (0.0, sign * degrees)
            for sign in (-1.0, 1.0)
        ]
        if angle == "both angles at once":
            return assess((0.0, 0.0), [list(corners(degrees))] * len(exact)).min() >= least
        if light is None:
            return all(assess(pose, exact)[0] >= least for pose in either)
        return assess((0.0, 0.0), [either if i == light else o for i, o in enumerate(exact)]).min() >= least

    kept = 0.0
    for rung in RUNGS:
        if not keeps(rung):
            break
        kept = rung
    else:
        return kept, True
    # rungs are multiples of a step
    low, high = round(kept * STEPS_PER_DEG), round(rung * STEPS_PER_DEG)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if keeps(middle / STEPS_PER_DEG) else (low, middle)
    return low / STEPS_PER_DEG, False
