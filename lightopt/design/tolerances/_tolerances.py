"""The tolerances to analyse, and the misalignments that are tried."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from lightopt.core.arrays import Int64
from lightopt.core.errors import InputError

Offset = tuple[float, float]
"""Elevation and azimuth of a light, or tilt and rotation of the part, off by so much [°]."""

ScoreFunction = Callable[[Offset, Sequence[Sequence[Offset]]], Int64]
"""Scores of all combinations of offsets, the last light's varying fastest, for an offset of the part, the same in all
postures, and offsets of each light."""

DEFAULT_TOLERANCE_TARGET = 0.95
"""Share of the score that the widest tolerances keep by default."""

LARGEST_TOLERANCE = 16.0
"""The widest tolerance that is tried, and the largest that may be requested [°]."""

MOST_LIGHTS = 10
"""Of which all corners are tried: 4 per light, some million in all. Two lights more would be sixteen times as many."""


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """How far angles may be off, and what is to be kept.

    light_deg: Elevation and azimuth of each light [°].
    pose_deg: Tilt and rotation of the part [°].
    target: Share of the score that the widest tolerances keep.
    draws: Number of random draws.
    seed: Random seed.
    """

    light_deg: float = 0.0
    pose_deg: float = 0.0
    target: float = DEFAULT_TOLERANCE_TARGET
    draws: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        problems = [
            f"{option}: expected degrees from 0 to {LARGEST_TOLERANCE:g}, found {value:g}"
            for option, value in (
                ("--tolerance-deg", self.light_deg),
                ("--pose-tolerance-deg", self.pose_deg),
            )
            if not 0.0 <= value <= LARGEST_TOLERANCE
        ]
        if not 0.0 < self.target < 1.0:
            problems.append(
                "--tolerance-target: expected a share of the score between 0 and 1, such as 0.95, found "
                f"{self.target:g}"
            )
        if self.draws < 1:
            problems.append(f"draws: expected at least 1, found {self.draws}")
        if problems:
            raise InputError(*problems)


def lights_problem(lights: int) -> str | None:
    """What is wrong with a number of lights; None where nothing is."""
    if lights <= MOST_LIGHTS:
        return None
    return (
        f"--tolerance-deg, --pose-tolerance-deg: all corners of the lights' angles are tried, 4 per light: expected at "
        f"most {MOST_LIGHTS} lights ({4**MOST_LIGHTS:,} corners), found {lights}; leave the tolerances out, or some "
        "lights out of the rig"
    )


def corners(tolerance: float) -> Iterator[Offset]:
    """Offsets with both angles off by the full tolerance [°], one way or the other."""
    signs = (-tolerance, tolerance) if tolerance > 0.0 else (0.0,)
    yield from product(signs, signs)


def draws(lights: int, tolerances: Tolerances) -> Iterator[tuple[Offset, list[Offset]]]:
    """Uniformly random offsets of the part and of each light, within the tolerances."""
    numbers = np.random.default_rng(tolerances.seed).uniform(-1.0, 1.0, (tolerances.draws, lights + 1, 2))
    for draw in numbers:
        pose, *rest = draw
        yield (
            (float(pose[0]) * tolerances.pose_deg, float(pose[1]) * tolerances.pose_deg),
            [(float(e) * tolerances.light_deg, float(a) * tolerances.light_deg) for e, a in rest],
        )
