"""Objective ``coverage``: area that two images or more show usably and at most one image shows saturated.

The two conditions of the paper's section 5.1 as a number: a defect must be confirmed by two or more images, and
highlights must not fall on the same place in several. With U the number of images in which a patch is usable (neither
shaded nor saturated) and S the number in which it is saturated,

    score = Σ area · [U ≥ 2 and S ≤ 1],

in whole square micrometres. A patch's part in it depends on the classes of its levels only. Along the candidates of a
light a patch is shaded, usable or saturated in runs. Over all lights its part in the score is constant on boxes, the
products of runs, which are added up as differences: see :class:`Differences`.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Float64, Int32, Int64
from lightopt.core.kernels import kernel
from lightopt.core.run_context import Share, WorkCounter
from lightopt.core.threads import blocks, run_all
from lightopt.design.objectives._objective import Objective, inspectable_surface
from lightopt.design.objectives._scores_by_units import Differences
from lightopt.design.responses._luminance_matrix import Levels, LevelThresholds, LuminanceMatrix, level_range

BOUND_PATCHES = 1 << 16  # patches whose bound is computed at once
SATURATED = 1 << 16  # added to a cell's count of usable images for each image in which it is saturated
CHUNK_PATCHES = 1 << 14  # most patches of one task of a thread
CHUNK_LEVELS = 1 << 24  # most of their levels, which are copied
CHUNK_BOXES = 1e6  # most of their boxes: less than 0.1 s, so that Ctrl-C is heard

# of each light: first run of each patch, as :func:`_runs` has it, and their offset in what follows: places and classes
_Runs = tuple[Int64, Int64, Int32, Int32]

LEAST_USABLE = 2  # images that must show a patch usably
MOST_SATURATED = 1  # images that may show it saturated


@dataclass(frozen=True)
class CoverageObjective(Objective):
    name: str = "coverage"
    unit: str = "µm²"
    share_of: str | None = inspectable_surface(edges=True)

    @property
    def meaning(self) -> str:
        return (
            f"of the surface is usable, neither shaded nor saturated, in {LEAST_USABLE} images or more and saturated "
            "in at most one"
        )

    def refusal(self, lights: int) -> str | None:
        """One image is never two."""
        if lights >= LEAST_USABLE:
            return None
        few = "and there is one light only; use the objective detectability"
        return f"objective coverage requires each patch to be usable in {LEAST_USABLE} images, {few}"

    def score(self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds) -> int:
        levels = np.concatenate(matrix.levels)
        saturated = levels >= thresholds.saturation
        usable = (levels >= thresholds.shade) & ~saturated
        covered = (usable.sum(axis=0) >= LEAST_USABLE) & (saturated.sum(axis=0) <= MOST_SATURATED)
        return int(weights[covered].sum())

    def scores(
        self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds, threads: int, progress: Share | None
    ) -> Int64:
        """By runs of candidates where a patch's class stays."""
        sizes = [len(layer) for layer in matrix.levels]
        limits = thresholds.shade, thresholds.saturation
        # number of boxes of each patch: the product over the lights of its numbers of runs
        boxes = np.prod([_run_counts(layer, *limits) for layer in matrix.levels], axis=0, dtype=np.float64)
        largest = int(boxes.max(initial=1.0))
        differences = Differences(sizes, threads)
        ends = _chunks(boxes, max(1, min(CHUNK_PATCHES, CHUNK_LEVELS // sum(sizes))))
        work = WorkCounter(boxes.sum(), progress)

        def add(start: int, end: int) -> None:
            runs = [_runs(np.ascontiguousarray(layer[:, start:end]), *limits) for layer in matrix.levels]
            first = np.stack([first for first, _, _ in runs])
            place = np.concatenate([place for _, place, _ in runs])
            kind = np.concatenate([kind for _, _, kind in runs])
            offset = np.cumsum([0, *(len(place) for _, place, _ in runs)])[:-1]
            with differences.borrowed() as (own,):
                _scatter(own, differences.strides, (first, offset, place, kind), weights[start:end], largest)
            work.add(float(boxes[start:end].sum()))

        run_all(((add, pair) for pair in itertools.pairwise(ends)), threads=differences.workers, done=work.report)
        return differences.summed()[0]

    def bound(self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds) -> int:
        """Patches that could be usable under two lights and need not be saturated under more than one."""
        total = 0
        for start, end in blocks(len(weights), BOUND_PATCHES):
            can_use = np.zeros(end - start, np.int64)
            must_saturate = np.zeros(end - start, np.int64)
            for layer in matrix.levels:
                usable, _, least = level_range(layer, thresholds.shade, thresholds.saturation, start, end)
                can_use += usable >= 0
                must_saturate += least >= thresholds.saturation
            could = (can_use >= LEAST_USABLE) & (must_saturate <= MOST_SATURATED)
            total += int(weights[start:end][could].sum())
        return total


COVERAGE = CoverageObjective()


def _chunks(products: Float64, most: int) -> list[int]:
    # where pieces of patches begin and end: at most so many patches, and boxes as far as a patch has fewer itself
    ends = [0]
    boxes = np.cumsum(products)
    while ends[-1] < len(products):
        before = boxes[ends[-1] - 1] if ends[-1] else 0.0
        reached = int(np.searchsorted(boxes, before + CHUNK_BOXES, side="right"))
        ends.append(min(max(reached, ends[-1] + 1), ends[-1] + most, len(products)))
    return ends


@kernel
def _run_counts(layer: Levels, shade: int, saturation: int) -> Int64:
    counts = np.ones(layer.shape[1], np.int64)
    for a in range(1, len(layer)):
        for p in range(layer.shape[1]):
            before, here = layer[a - 1, p], layer[a, p]
            counts[p] += (before < shade) != (here < shade) or (before < saturation) != (here < saturation)
    return counts


@kernel
def _runs(layer: Levels, shade: int, saturation: int) -> tuple[Int64, Int32, Int32]:
    # where each patch's runs begin and their classes, 0 shaded, 1 usable or SATURATED: patch p has those from first[p]
    # to first[p + 1]
    first = np.zeros(layer.shape[1] + 1, np.int64)
    first[1:] = np.cumsum(_run_counts(layer, shade, saturation))
    place, kind = np.empty(first[-1], np.int32), np.empty(first[-1], np.int32)
    for p in range(layer.shape[1]):
        k = first[p]
        last = -1
        for a in range(len(layer)):
            level = layer[a, p]
            here = 0 if level < shade else 1 if level < saturation else SATURATED
            if here != last:
                place[k], kind[k] = a, here
                last = here
                k += 1
    return first, place, kind


@kernel
def _scatter(differences: Int64, strides: Int64, all_runs: _Runs, weights: Int64, largest: int) -> None:
    first, offset, place, kind = all_runs
    lights = len(strides)
    at = np.empty(largest, np.int64)  # where in the table each box begins
    count = np.empty(largest, np.int64)  # its usable images + SATURATED · its saturated ones
    for p in range(len(weights)):
        size = 1
        at[0], count[0] = 0, 0
        for light in range(lights):
            start, end = offset[light] + first[light, p], offset[light] + first[light, p + 1]
            runs = end - start
            # the boxes so far, times the runs of this light; backwards, so that none is overwritten too early
            for box in range(size - 1, -1, -1):
                for r in range(runs - 1, -1, -1):
                    at[box * runs + r] = at[box] + strides[light] * place[start + r]
                    count[box * runs + r] = count[box] + kind[start + r]
            size *= runs
        for box in range(size):
            usable, saturated = count[box] % SATURATED, count[box] // SATURATED
            count[box] = 1 if usable >= LEAST_USABLE and saturated <= MOST_SATURATED else 0
        step = 1
        for light in range(lights - 1, -1, -1):
            runs = first[light, p + 1] - first[light, p]
            for box in range(size - 1, step - 1, -1):
                if (box // step) % runs:
                    count[box] -= count[box - step]
            step *= runs
        for box in range(size):
            if count[box]:
                differences[at[box]] += weights[p] * count[box]
