"""Tolerance analysis: how far a score falls when the lights or the part are misaligned.

Each light is off by up to so many degrees in elevation and in azimuth, the part by up to so many in tilt and in
rotation. Channels of one light move as one body, as :mod:`lightopt.design._misalignment` describes.

Three results: the worst *corner*, where every angle is off by the full tolerance one way or the other; the 5 % quantile
over draws where every angle is off by a uniformly random amount within its tolerance; and angle by angle the widest
tolerance that keeps the score.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from operator import itemgetter
from typing import TypeVar

import numpy as np

from lightopt.core.arrays import Int64
from lightopt.core.errors import InputError, refuse
from lightopt.core.run_context import Share, WorkCounter

T = TypeVar("T")
Offset = tuple[float, float]  # elevation and azimuth of a light, or tilt and rotation of the part, off by so much [°]

# scores of all combinations of offsets, the last body's varying fastest, for an offset of the part, the same in all
# postures, and offsets of each body of lights
Offsets = Sequence[Sequence[Offset]]
ScoreFunction = Callable[[Offset, Offsets], Int64]

EXACT: Offset = (0.0, 0.0)
DEFAULT_TOLERANCE_TARGET = 0.95  # share of the score that the widest tolerances keep by default
LARGEST_TOLERANCE = 16.0  # the widest tolerance that is tried, and the largest that may be requested [°]

# Of which all corners are tried: 4 per body, some million in all. Two bodies more would be sixteen times as many.
MOST_BODIES = 10

QUANTILE = 0.05  # of the draws
STEPS_PER_DEG = 20  # the widest tolerances are multiples of 0.05°, and a step more does not keep the score

# tolerances that are tried before the first that costs too much is bisected [°]
RUNGS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, LARGEST_TOLERANCE)

# the same for joint tolerances, which are known to this share
FEW_RUNGS, KNOWN_TO = (1.0, 2.0, 4.0, 8.0, LARGEST_TOLERANCE), 0.05

BOTH_ANGLES = "both angles at once"

# what is off, in which angle, and which body that is: the index, None for all of them or the part
Angle = tuple[str, str, int | None]


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    light_deg: float = 0.0  # elevation and azimuth of each light [°]
    pose_deg: float = 0.0  # tilt and rotation of the part [°]
    tolerance_target: float = DEFAULT_TOLERANCE_TARGET  # share of the score that the widest tolerances keep
    draws: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        problems = [
            f"{option}: expected degrees from 0 to {LARGEST_TOLERANCE:g}, found {value:g}"
            for option, value in (("option 'light_deg'", self.light_deg), ("option 'pose_deg'", self.pose_deg))
            if not 0.0 <= value <= LARGEST_TOLERANCE
        ]
        if not 0.0 < self.tolerance_target < 1.0:
            found = f"expected a share of the score between 0 and 1, found {self.tolerance_target:g}"
            problems.append(f"option 'tolerance_target': {found}")
        refuse(problems)


def check_body_count(bodies: int) -> None:
    """Refuse more bodies of lights than the number for which all corners can be tried."""
    if bodies > MOST_BODIES:
        raise InputError(
            "option 'light_deg', option 'pose_deg': all corners of the lights' angles are tried: expected at most "
            f"{MOST_BODIES} lights ({4**MOST_BODIES:,} corners), found {bodies}; omit the tolerances"
        )


def corners(tolerance: float) -> Iterator[Offset]:
    """Offsets with both angles off by the full tolerance [°], one way or the other."""
    signs = (-tolerance, tolerance) if tolerance > 0.0 else (0.0,)
    yield from product(signs, signs)


def draws(lights: int, tolerances: Tolerances) -> Iterator[tuple[Offset, list[Offset]]]:
    """Uniformly random offsets of the part and of each light, within the tolerances."""
    numbers = np.random.default_rng(tolerances.seed).uniform(-1.0, 1.0, (tolerances.draws, lights + 1, 2))
    for (tilt, rotation), *rest in numbers.tolist():
        yield (
            (tilt * tolerances.pose_deg, rotation * tolerances.pose_deg),
            [(e * tolerances.light_deg, a * tolerances.light_deg) for e, a in rest],
        )


@dataclass(frozen=True, kw_only=True)
class WidestTolerance:
    what: str  # name of the light, ``all lights``, or ``part``
    angle: str  # ``elevation``, ``azimuth``, ``both angles at once``, ``tilt`` or ``rotation``
    # the widest tolerance that keeps the score, every angle but these being exact [°]; of those that were tried: the
    # rungs, and multiples of 0.05° between the last that keeps it and the first that does not
    degrees: float
    open_ended: bool  # whether that is the widest that was tried


@dataclass(frozen=True, kw_only=True)
class ToleranceAnalysis:
    lights: tuple[str, ...]
    score: int  # where all angles are exact
    worst: int  # the least over all corners
    worst_pose: Offset  # the corner: offset of the part [°]
    worst_lights: tuple[Offset, ...]  # offset of each light there [°]
    quantile: int  # 5 % of the draws score this or less
    least_drawn: int  # the least of the draws
    widest: tuple[WidestTolerance, ...]


def analyse_tolerances(
    score: ScoreFunction, names: Sequence[str], tolerances: Tolerances, *, progress: Share | None = None
) -> ToleranceAnalysis:
    """Find how far a score falls, for bodies of lights of these names.

    Raises InputError: More bodies than all corners can be tried of.
    """
    check_body_count(len(names))
    varied: list[Angle] = [(name, axis, i) for i, name in enumerate(names) for axis in ("elevation", "azimuth")]
    varied += [("all lights", BOTH_ANGLES, None), ("part", "tilt", None), ("part", "rotation", None)]
    pose_corners, light_corners = list(corners(tolerances.pose_deg)), list(corners(tolerances.light_deg))
    work = WorkCounter(len(pose_corners) + tolerances.draws + len(varied), progress)
    sizes, every_corner = [len(light_corners)] * len(names), [light_corners] * len(names)

    def reported(items: Iterable[T]) -> Iterator[T]:
        for item in items:
            yield item
            work.add(1)
            work.report()

    def worst_at(pose: Offset) -> tuple[int, Offset, tuple[Offset, ...]]:
        table = score(pose, every_corner)
        at = np.unravel_index(table.argmin(), sizes)
        return int(table.min()), pose, tuple(light_corners[int(i)] for i in at)

    exact: list[Sequence[Offset]] = [[EXACT]] * len(names)
    nominal = int(score(EXACT, exact)[0])
    worst, worst_pose, worst_lights = min(map(worst_at, reported(pose_corners)), key=itemgetter(0))
    drawn = [
        int(score(pose, [[offset] for offset in lights])[0]) for pose, lights in reported(draws(len(names), tolerances))
    ]
    least = tolerances.tolerance_target * nominal
    return ToleranceAnalysis(
        lights=tuple(names),
        score=nominal,
        worst=worst,
        worst_pose=worst_pose,
        worst_lights=worst_lights,
        quantile=sorted(drawn)[max(0, math.ceil(QUANTILE * len(drawn)) - 1)],
        least_drawn=min(drawn),
        widest=tuple(_widest_tolerance(score, exact, angle, least) for angle in reported(varied)),
    )


def _widest_tolerance(score: ScoreFunction, exact: Offsets, varied: Angle, least: float) -> WidestTolerance:
    """How far an angle may be off while the score is at least `least`."""
    what, angle, light = varied

    def keeps(degrees: float) -> bool:
        either: list[Offset] = [
            (sign * degrees, 0.0) if angle in ("elevation", "tilt") else (0.0, sign * degrees) for sign in (-1.0, 1.0)
        ]
        if angle == BOTH_ANGLES:
            return score(EXACT, [list(corners(degrees))] * len(exact)).min() >= least
        if light is None:
            return all(score(pose, exact)[0] >= least for pose in either)
        return score(EXACT, [either if i == light else o for i, o in enumerate(exact)]).min() >= least

    return widest_kept(what, angle, keeps)


def widest_kept(
    what: str, angle: str, keeps: Callable[[float], bool], rungs: Sequence[float] = RUNGS, known_to: float = 0.0
) -> WidestTolerance:
    """The widest tolerance that keeps the score, to a step or a share of it."""
    widest = 0.0
    for rung in rungs:
        if not keeps(rung):
            break
        widest = rung
    else:
        return WidestTolerance(what=what, angle=angle, degrees=widest, open_ended=True)
    # rungs are multiples of a step
    low, high = round(widest * STEPS_PER_DEG), round(rung * STEPS_PER_DEG)
    while high - low > max(1.0, known_to * high):
        middle = (low + high) // 2
        low, high = (middle, high) if keeps(middle / STEPS_PER_DEG) else (low, middle)
    return WidestTolerance(what=what, angle=angle, degrees=low / STEPS_PER_DEG, open_ended=False)


@dataclass(frozen=True, kw_only=True)
class JointTolerances:
    """How far angles may be off, all at once and in either direction, while the share found is kept."""

    lights: WidestTolerance | None  # of all lights; None where they are too many for all corners to be tried
    part: WidestTolerance  # against its postures


def joint_tolerances(
    score: ScoreFunction, bodies: int, target: float, *, progress: Share | None = None
) -> JointTolerances:
    """How far all bodies of lights may be off in both angles at once, and the part in both of its own.

    Known to 0.05° or 5 %. `target` is the share of the score that is kept in every corner.
    """
    exact: list[Sequence[Offset]] = [[EXACT]] * bodies
    least = target * int(score(EXACT, exact)[0])
    work = WorkCounter(2, progress)

    def one_by_one(off: Callable[[Offset], Int64]) -> Callable[[float], bool]:
        # the corner that cost too much is tried first the next time: mostly it does so again
        signs = list(corners(1.0))

        def keeps(degrees: float) -> bool:
            for sign in signs:
                if off((sign[0] * degrees, sign[1] * degrees))[0] < least:
                    signs.remove(sign)
                    signs.insert(0, sign)
                    return False
            return True

        return keeps

    def widest(what: str, keeps: Callable[[float], bool]) -> WidestTolerance:
        found = widest_kept(what, BOTH_ANGLES, keeps, FEW_RUNGS, KNOWN_TO)
        work.add(1)
        work.report()
        return found

    def all_at_once(degrees: float) -> bool:
        return bool(score(EXACT, [list(corners(degrees))] * bodies).min() >= least)

    of_lights = one_by_one(lambda offset: score(EXACT, [[offset]])) if bodies == 1 else all_at_once
    lights = widest("all lights", of_lights) if bodies <= MOST_BODIES else None
    return JointTolerances(lights=lights, part=widest("part", one_by_one(lambda offset: score(offset, exact))))
