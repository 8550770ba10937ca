"""Tolerance analysis: how far a score falls when the lights or the part are misaligned.

Each light is off by up to so many degrees in elevation and in azimuth, the part by up to so many in tilt and in
rotation. Three results: the worst *corner*, where every angle is off by the full tolerance one way or the other; the
5 % quantile over draws where every angle is off by a uniformly random amount within its tolerance; and angle by angle
the widest tolerance that keeps the score. Each image is computed once: of a posture, with the part off by so much,
under one light that is off by so much. The scores of all combinations are composed of them.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from operator import itemgetter
from typing import Any, Literal, TypeVar

import numpy as np

from lightopt.config import RigConfig
from lightopt.core.arrays import Int64, UInt64
from lightopt.core.errors import InputError
from lightopt.core.run_context import Share, WorkCounter
from lightopt.core.threads import available_processors
from lightopt.core.transforms import Posture
from lightopt.design._candidates import panels_of
from lightopt.design.objectives._objective import Objective
from lightopt.design.postures._light_positions import combination_sums
from lightopt.design.responses._image_evaluator import ImageEvaluator, scattered_flags
from lightopt.design.responses._luminance_matrix import LevelThresholds, LuminanceMatrix
from lightopt.geometry import face_normals
from lightopt.lights import PanelLight
from lightopt.rendering import PatchTable, camera_visibility
from lightopt.scene import view_from_part

T = TypeVar("T")
Offset = tuple[float, float]  # elevation and azimuth of a light, or tilt and rotation of the part, off by so much [°]

# scores of all combinations of offsets, the last light's varying fastest, for an offset of the part, the same in all
# postures, and offsets of each light
ScoreFunction = Callable[[Offset, Sequence[Sequence[Offset]]], Int64]

EXACT: Offset = (0.0, 0.0)
DEFAULT_TOLERANCE_TARGET = 0.95  # share of the score that the widest tolerances keep by default
LARGEST_TOLERANCE = 16.0  # the widest tolerance that is tried, and the largest that may be requested [°]

# Of which all corners are tried: 4 per light, some million in all. Two lights more would be sixteen times as many.
MOST_LIGHTS = 10

QUANTILE = 0.05  # of the draws
STEPS_PER_DEG = 20  # the widest tolerances are multiples of 0.05°, and a step more does not keep the score

# tolerances that are tried before the first that costs too much is bisected [°]
RUNGS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, LARGEST_TOLERANCE)

# what is off, in which angle, and which light that is: the index, None for all of them or the part
Angle = tuple[str, str, int | None]

ImageKey = tuple[int, Offset, int, Offset]  # a posture, the offset of the part, a light, and its offset


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """The tolerances to analyse, and the share of the score to keep."""

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
            problems.append(
                "option 'tolerance_target': expected a share of the score between 0 and 1, such as 0.95, found "
                f"{self.tolerance_target:g}"
            )
        if self.draws < 1:
            problems.append(f"draws: expected at least 1, found {self.draws}")
        if problems:
            raise InputError(*problems)


def check_light_count(lights: int) -> None:
    """Refuse more lights than the number for which all corners can be tried."""
    if lights > MOST_LIGHTS:
        raise InputError(
            "option 'light_deg', option 'pose_deg': all corners of the lights' angles are tried, 4 per light: expected "
            f"at most {MOST_LIGHTS} lights ({4**MOST_LIGHTS:,} corners), found {lights}; omit the tolerances, or "
            "remove lights from the rig"
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
    """How far one angle, or all of the lights', may be off."""

    what: str  # name of the light, ``all lights``, or ``part``
    angle: str  # ``elevation``, ``azimuth``, ``both angles at once``, ``tilt`` or ``rotation``
    # the widest tolerance that keeps the score, every angle but these being exact [°]; of those that were tried: the
    # rungs, and multiples of 0.05° between the last that keeps it and the first that does not
    degrees: float
    open_ended: bool  # whether that is the widest that was tried


@dataclass(frozen=True, kw_only=True)
class ToleranceAnalysis:
    """Scores under misalignment."""

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
    """Find how far a score falls, for lights of these names.

    Raises InputError: More lights than all corners can be tried of.
    """
    check_light_count(len(names))
    varied: list[Angle] = [(name, axis, i) for i, name in enumerate(names) for axis in ("elevation", "azimuth")]
    varied += [("all lights", "both angles at once", None), ("part", "tilt", None), ("part", "rotation", None)]
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


def _widest_tolerance(
    score: ScoreFunction, exact: Sequence[Sequence[Offset]], varied: Angle, least: float
) -> WidestTolerance:
    """How far an angle may be off while the score is at least `least`."""
    what, angle, light = varied

    def keeps(degrees: float) -> bool:
        either: list[Offset] = [
            (sign * degrees, 0.0) if angle in ("elevation", "tilt") else (0.0, sign * degrees) for sign in (-1.0, 1.0)
        ]
        if angle == "both angles at once":
            return score(EXACT, [list(corners(degrees))] * len(exact)).min() >= least
        if light is None:
            return all(score(pose, exact)[0] >= least for pose in either)
        return score(EXACT, [either if i == light else o for i, o in enumerate(exact)]).min() >= least

    widest = 0.0
    for rung in RUNGS:
        if not keeps(rung):
            break
        widest = rung
    else:
        return WidestTolerance(what=what, angle=angle, degrees=widest, open_ended=True)
    # rungs are multiples of a step
    low, high = round(widest * STEPS_PER_DEG), round(rung * STEPS_PER_DEG)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if keeps(middle / STEPS_PER_DEG) else (low, middle)
    return WidestTolerance(what=what, angle=angle, degrees=low / STEPS_PER_DEG, open_ended=False)


@dataclass(frozen=True)
class Setup:
    """Postures that are evaluated together, and the positions of the lights in them."""

    rig: RigConfig
    postures: tuple[Posture, ...]
    angles: tuple[tuple[tuple[float, float], ...], ...]  # elevation and azimuth of each light, posture by posture [°]
    exposures: tuple[tuple[float, ...], ...]  # posture by posture, 1 among them
    points: int | Literal["auto"] | None = None  # point lights per panel, instead of the rig's

    def only(self, posture: int) -> "Setup":
        """One of the postures."""
        one = slice(posture, posture + 1)
        return replace(self, postures=self.postures[one], angles=self.angles[one], exposures=self.exposures[one])

    def panels(self, posture: int) -> tuple[PanelLight, ...]:
        """The lights in a posture, world frame."""
        return tuple(self.panel(posture, light, EXACT) for light in range(len(self.rig.lights)))

    def panel(self, posture: int, light: int, offset: Offset) -> PanelLight:
        """A light that is off by so much, world frame."""
        elevation, azimuth = self.angles[posture][light]
        return panels_of(self.rig, light, [(elevation + offset[0], azimuth + offset[1])], self.points)[0]


class _Assessment(ABC):
    """Scores of combinations of offsets, from images that are computed once: a `ScoreFunction`.

    The patches of the evaluator stay the same; which of them are visible does not.
    """

    def __init__(self, evaluator: ImageEvaluator, setup: Setup) -> None:
        self.evaluator, self.setup = evaluator, setup
        self.patches = evaluator.patches
        self.images: dict[ImageKey, Any] = {}
        self._facets = face_normals(evaluator.scene.mesh)[evaluator.table.patches.face[self.patches]]

    def __call__(self, pose: Offset, lights: Sequence[Sequence[Offset]]) -> Int64:
        # images of other poses than this one and the exact one are not needed again
        self.images = {key: image for key, image in self.images.items() if key[1] in (pose, EXACT)}
        for posture in range(len(self.setup.postures)):
            self._compute_images(posture, pose, lights)
        return self.scores(pose, lights)

    @abstractmethod
    def scores(self, pose: Offset, lights: Sequence[Sequence[Offset]]) -> Int64:
        """Scores of all combinations, the last light's offsets varying fastest."""

    @abstractmethod
    def keep(self, matrices: Sequence[LuminanceMatrix], light: int, at: int) -> Any:
        """The stored part of an image: row `at` of a light, in matrices of all exposures."""

    def _compute_images(self, posture: int, pose: Offset, lights: Sequence[Sequence[Offset]]) -> None:
        # the images that are not known yet, those of all lights in one go
        keys = ([(posture, pose, light, offset) for offset in offsets] for light, offsets in enumerate(lights))
        missing = [[key[-1] for key in some if key not in self.images] for some in keys]
        if not any(missing):
            return
        nominal = self.setup.postures[posture]
        there = Posture(nominal.elevation_deg + pose[0], nominal.rotation_deg + pose[1])
        panels = [[self.setup.panel(posture, light, one) for one in offsets] for light, offsets in enumerate(missing)]
        evaluator = replace(self.evaluator, table=self._table(there, posture))
        matrices = evaluator.matrices(there, panels, exposures=self.setup.exposures[posture])
        for light, offsets in enumerate(missing):
            for at, offset in enumerate(offsets):
                self.images[posture, pose, light, offset] = self.keep(matrices, light, at)

    def _table(self, posture: Posture, at: int) -> PatchTable:
        table = self.evaluator.table
        visible, grazing = np.zeros((2, 1, len(table.patches)), np.bool_)
        points, normals = table.patches.centroids[self.patches], table.patches.normals[self.patches]
        view = view_from_part(self.evaluator.scene, posture)
        sight = camera_visibility(points, normals, self._facets, view, self.evaluator.caster)
        visible[0, self.patches], grazing[0, self.patches] = sight
        # edges hardly move within the tolerances
        nominal = table.postures.index(self.setup.postures[at])
        return replace(table, postures=(posture,), visible=visible, grazing=grazing | table.grazing[nominal])


class PairAssessment(_Assessment):
    """Weight of the pairs of patch and defect that the images of all postures together find."""

    def keep(self, matrices: Sequence[LuminanceMatrix], light: int, at: int) -> Any:
        """One image, whatever the number of its exposures."""
        return scattered_flags(matrices, self.patches, light=light, place=at)

    def scores(self, pose: Offset, lights: Sequence[Sequence[Offset]]) -> Int64:
        """Add up the postures, then all combinations of the lights."""
        totals: list[UInt64] = []
        weights, needed, postures = self.evaluator.weights, self.evaluator.needed, range(len(self.setup.postures))
        for light, offsets in enumerate(lights):
            images = ([self.images[i, pose, light, offset] for i in postures] for offset in offsets)
            totals.append(np.stack([weights.sum_counts(some, needed) for some in images]))
        return combination_sums(totals, weights, needed, benefit=False, threads=self.evaluator.threads)[0]


class ObjectiveAssessment(_Assessment):
    """Score of an objective of levels at exposure 1, summed over the postures."""

    def __init__(
        self, evaluator: ImageEvaluator, setup: Setup, *, objective: Objective, thresholds: LevelThresholds
    ) -> None:
        super().__init__(evaluator, setup)
        self._objective, self._thresholds = objective, thresholds

    def keep(self, matrices: Sequence[LuminanceMatrix], light: int, at: int) -> Any:
        """Levels, and the areas of their patches."""
        return matrices[0].levels[light][at], matrices[0].areas

    def scores(self, pose: Offset, lights: Sequence[Sequence[Offset]]) -> Int64:
        """All combinations by the objective's own search."""
        total = np.zeros(int(np.prod([len(offsets) for offsets in lights])), np.int64)
        for posture in range(len(self.setup.postures)):
            keys = [[(posture, pose, light, offset) for offset in offsets] for light, offsets in enumerate(lights)]
            images = [[self.images[key] for key in some] for some in keys]
            levels = tuple(np.stack([own for own, _ in some]) for some in images)
            matrix = LuminanceMatrix(levels=levels, areas=images[0][0][1])
            threads, weights = self.evaluator.threads or available_processors(), self._objective.weights(matrix.areas)
            total += self._objective.scores(matrix, weights, self._thresholds, threads, None)
        return total
