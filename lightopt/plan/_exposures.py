"""Further exposures of chosen postures: planned where they show enough more, and nowhere else.

The lights are placed for exposure 1. Offered are the postures' images at other exposures, all lights together; the one
that shows most pairs more is planned, then the next, as long as it shows enough more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lightopt.plan._counts import Counts, PairWeights, added, counts_of_images, no_counts, reached
from lightopt.plan._survey import Survey, scattered_flags
from lightopt.scene import PanelLight
from lightopt.transforms import Posture

__all__ = ["DEFAULT_EXPOSURE_GAIN", "Brackets", "Shot", "check_exposures", "pick_shots", "plan_exposures"]

DEFAULT_EXPOSURE_GAIN = 1.0
"""Points (hundredths of the pairs) that a further exposure of a posture has to add, unless asked otherwise."""


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A further exposure of a posture, all lights.

    Attributes
    ----------
    posture
        The posture.
    exposure
        Relative to exposure 1.
    gain
        Share of the pairs that it adds: to what is planned before it where it is planned, else to the whole plan.
    planned
        Whether the gain is enough.
    """

    posture: Posture
    exposure: float
    gain: float
    planned: bool


@dataclass(frozen=True, kw_only=True)
class Brackets:
    """The further exposures that were looked at.

    Attributes
    ----------
    before, after
        Share of the pairs that is seen without them and with those that are planned.
    shots
        The planned ones in the order in which they were chosen, then the others.
    least_gain
        Share that one has to add.
    """

    before: float
    after: float
    shots: tuple[Shot, ...]
    least_gain: float

    def of(self, posture: Posture) -> tuple[float, ...]:
        """Exposures of a posture in the plan, the longest first."""
        further = [shot.exposure for shot in self.shots if shot.planned and shot.posture == posture]
        return tuple(sorted([1.0, *further], reverse=True))


def check_exposures(offered: Sequence[float], gain_points: float) -> list[str]:
    """What is wrong with exposures and the gain that is asked of them."""
    problems = [
        f"--exposures: expected numbers above 0, such as 1,1/4,1/16, found {exposure:g}"
        for exposure in offered
        if not (math.isfinite(exposure) and exposure > 0.0)
    ]
    if len(set(offered)) < len(offered):
        problems.append("--exposures: the same exposure was given twice")
    if not (math.isfinite(gain_points) and 0.0 <= gain_points <= 100.0):
        problems.append(f"--exposure-gain: expected points from 0 to 100, found {gain_points:g}")
    return problems


def plan_exposures(
    survey: Survey,
    postures: Sequence[Posture],
    lights: Sequence[Sequence[PanelLight]],
    offered: Sequence[float],
    *,
    least: int,
    gain_points: float = DEFAULT_EXPOSURE_GAIN,
    tell: Callable[[float], None] | None = None,
) -> Brackets:
    """Plan a further exposure only where it shows more by at least a given gain.

    Parameters
    ----------
    survey
        The part.
    postures
        In the plan.
    lights
        Where they stand, posture by posture, world frame.
    offered
        Exposures; 1 is taken anyway.
    least
        Images that must show a pair, of all postures and exposures together.
    gain_points
        The least gain [hundredths of the pairs].
    tell
        Called with the share that is done.
    """
    further = [exposure for exposure in offered if exposure != 1.0]
    weights, patches = survey.weights, survey.patches
    now = no_counts(weights, least)
    shots: list[tuple[Posture, float, Counts]] = []
    for done, (posture, panels) in enumerate(zip(postures, lights, strict=True)):
        matrices = survey.matrices(posture, [[panel] for panel in panels], exposures=(1.0, *further))
        first, *rest = (
            counts_of_images(
                [scattered_flags(matrix, patches, light=light, place=0) for light in range(len(panels))],
                least,
            )
            for matrix in matrices
        )
        now = added(now, first)
        shots += [(posture, exposure, counts) for exposure, counts in zip(further, rest, strict=True)]
        if tell is not None:
            tell((done + 1) / len(postures))
    return pick_shots(now, shots, weights, least_gain=gain_points / 100.0)


def pick_shots(
    now: Counts,
    shots: Sequence[tuple[Posture, float, Counts]],
    weights: PairWeights,
    *,
    least_gain: float,
) -> Brackets:
    """Take the shot that adds most to what is seen, the first of equals, as long as it adds enough and anything.

    Parameters
    ----------
    now
        Counts of the plan without them.
    shots
        Posture, exposure and counts of each.
    weights
        Of the pairs.
    least_gain
        Share of the pairs.
    """
    total = max(1, weights.total)
    before = seen = reached(now, weights)
    left = list(range(len(shots)))
    planned: list[Shot] = []
    while True:
        gains = {i: reached(added(now, shots[i][2]), weights) - seen for i in left}
        best = max(left, key=lambda i: gains[i], default=None)
        if best is None or gains[best] == 0 or gains[best] < least_gain * total:
            break
        posture, exposure, counts = shots[best]
        planned.append(Shot(posture=posture, exposure=exposure, gain=gains[best] / total, planned=True))
        now, seen = added(now, counts), seen + gains[best]
        left.remove(best)
    rest = [
        Shot(posture=shots[i][0], exposure=shots[i][1], gain=gains[i] / total, planned=False) for i in left
    ]
    return Brackets(before=before / total, after=seen / total, shots=(*planned, *rest), least_gain=least_gain)
