"""What may be off in a plan, what is tried of it, and what scores that."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import InputError

Offset = tuple[float, float]
"""Elevation and azimuth of a light, or tilt and rotation of the part, off by so much [°]."""

DEFAULT_TOLERANCE_TARGET = 0.95
"""Share of the score that the widest tolerances keep, unless asked otherwise."""

LARGEST_TOLERANCE = 16.0
"""The widest tolerance that is looked for, and the largest that may be asked about [°]."""

MOST_LIGHTS = 10
"""Of which all corners are tried: 4 per light, some million in all. Two lights more would be sixteen times as many."""


class Assess(Protocol):
    """Scores of lights and part that are off."""

    def __call__(self, pose: Offset, lights: Sequence[Sequence[Offset]]) -> NDArray[np.int64]:
        """Scores of all combinations of offsets, the last light's varying fastest.

        Parameters
        ----------
        pose
            Of the part, the same in all postures.
        lights
            Of each light, offsets to try.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """What may be off, and what is to be kept.

    Attributes
    ----------
    light_deg
        Elevation and azimuth of each light [°].
    pose_deg
        Tilt and rotation of the part [°].
    target
        Share of the score that the widest tolerances keep.
    draws
        Number of random draws.
    seed
        Of the random numbers.
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
    """Random offsets of the part and of each light, even within the tolerances."""
    numbers = np.random.default_rng(tolerances.seed).uniform(-1.0, 1.0, (tolerances.draws, lights + 1, 2))
    for draw in numbers:
        pose, *rest = draw
        yield (
            (float(pose[0]) * tolerances.pose_deg, float(pose[1]) * tolerances.pose_deg),
            [(float(e) * tolerances.light_deg, float(a) * tolerances.light_deg) for e, a in rest],
        )
