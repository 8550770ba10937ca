"""How far a score falls when the lights or the part are not quite where they should be.

The lights are each off by up to so many degrees in elevation and in azimuth, the part by up to so many in tilt and in
rotation. Of all that can happen within, three things are told: the worst *corner*, where every angle is off by the full
tolerance one way or the other; the 5 % quantile over draws where every angle is off by a random amount, even within its
tolerance; and angle by angle the widest tolerance that keeps the score.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lightopt.core.errors import InputError
from lightopt.design._plan_progress import Share
from lightopt.design.tolerances._tolerances import Assess, Offset, Tolerances, corners, draws, lights_problem
from lightopt.design.tolerances._widest import Widest, angles, widest

QUANTILE = 0.05


@dataclass(frozen=True, kw_only=True)
class Trust:
    """What becomes of a score.

    Attributes
    ----------
    score
        Where all angles are as they should be.
    worst
        The least over all corners.
    worst_pose, worst_lights
        The corner: offsets of the part and of each light [°].
    quantile
        5 % of the draws score this or less.
    least_drawn
        The least of the draws.
    widest
        Angle by angle.
    """

    score: int
    worst: int
    worst_pose: Offset
    worst_lights: tuple[Offset, ...]
    quantile: int
    least_drawn: int
    widest: tuple[Widest, ...]


def trust_of(
    assess: Assess,
    names: Sequence[str],
    tolerances: Tolerances,
    *,
    progress: Share | None = None,
) -> Trust:
    """Find out how far a score falls.

    Parameters
    ----------
    assess
        Scores offsets; asked often for the same ones, it may remember.
    names
        Of the lights.
    tolerances
        What may be off.
    progress
        Called with the share that is done.

    Raises
    ------
    InputError
        More lights than all corners can be tried of.
    """
    if problem := lights_problem(len(names)):
        raise InputError(problem)
    singly = list(angles(names))
    pose_corners = list(corners(tolerances.pose_deg))
    total, done = len(pose_corners) + tolerances.draws + len(singly), 0

    def tell() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done / total)

    exact: list[Sequence[Offset]] = [[(0.0, 0.0)]] * len(names)
    score = int(assess((0.0, 0.0), exact)[0])
    light_corners = list(corners(tolerances.light_deg))
    worst: tuple[int, Offset, tuple[Offset, ...]] | None = None
    for pose in pose_corners:
        table = assess(pose, [light_corners] * len(names))
        least = int(table.argmin())
        if worst is None or table[least] < worst[0]:
            at = np.unravel_index(least, [len(light_corners)] * len(names))
            worst = int(table[least]), pose, tuple(light_corners[int(i)] for i in at)
        tell()
    assert worst is not None
    drawn: list[int] = []
    for pose, lights in draws(len(names), tolerances):
        drawn.append(int(assess(pose, [[offset] for offset in lights])[0]))
        tell()
    found: list[Widest] = []
    for which in singly:
        found.append(widest(assess, exact, which, tolerances.target * score))
        tell()
    return Trust(
        score=score,
        worst=worst[0],
        worst_pose=worst[1],
        worst_lights=worst[2],
        quantile=sorted(drawn)[max(0, math.ceil(QUANTILE * len(drawn)) - 1)],
        least_drawn=min(drawn),
        widest=tuple(found),
    )
