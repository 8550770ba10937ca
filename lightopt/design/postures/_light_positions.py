"""Positions of lights that stand the same in all postures: the combination of candidates that shows most.

Every combination is tried, a table of so many after the other; where there are too many, lights are moved one at a
time until that gains nothing.

The postures' images of a position are counted before (see :mod:`lightopt.design.responses._packed_bits`), so that a
combination adds up one count per light, whatever the number of postures. The sums come from the places where counts
change (:mod:`lightopt.design.objectives._scores_by_image_counts`). Patches where they change nearly everywhere are
added up combination by combination; the last light's positions share the sum of the others.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Int64, UInt64
from lightopt.core.errors import InputError
from lightopt.core.kernels import kernel
from lightopt.core.run_context import Share, part_of
from lightopt.core.threads import available_processors, run_all
from lightopt.core.transforms import Posture
from lightopt.design._candidates import Candidates
from lightopt.design.objectives._scores_by_image_counts import at_least, count_run_sums, up_to
from lightopt.design.responses._image_evaluator import ImageEvaluator
from lightopt.design.responses._luminance_matrix import select_rows
from lightopt.design.responses._packed_bits import Counts, PairWeights, Words, add_counts, counts_of_images, word_weight
from lightopt.design.search._combinations import CombinationSpace, allowed_mask, digits
from lightopt.design.search._exact_search import DEFAULT_LIMIT, TABLE_CELLS

PositionCounts = UInt64  # counts of every place of a light, shape (places, k, p, words)

# words that a task of plain additions reads, at most: some 0.1 s of a thread, so that Ctrl-C is heard
TASK_WORDS = 100_000_000


def combination_sums(
    lights: Sequence[PositionCounts], weights: PairWeights, *, threads: int | None = None, progress: Share | None = None
) -> tuple[Int64, Int64]:
    """Covered weight and benefit of every combination of positions, the last light's varying fastest."""
    k = lights[0].shape[1]
    count = threads or available_processors()
    # where one image is enough, the covered weight is the benefit
    values = np.stack([at_least(k), up_to(k)][: min(k, 2)])
    tables, left = count_run_sums(
        lights, weights.areas, (weights.masks, weights.factors), values, threads=count, progress=progress
    )
    covered, benefit = tables[0], tables[-1]
    if left.any():
        plain = _added_up([positions[:, :, left] for positions in lights], weights.of(left), count, progress)
        # not in place: with k = 1 both are the same table
        covered, benefit = covered + plain[0], benefit + plain[1]
    return covered, benefit


def _added_up(
    lights: Sequence[PositionCounts], weights: PairWeights, threads: int, progress: Share | None
) -> tuple[Int64, Int64]:
    sizes = [len(positions) for positions in lights]
    inner = math.prod(sizes[1:])
    k, patches = lights[0].shape[1:3]
    covers, benefits = np.zeros((sizes[0], inner), np.int64), np.zeros((sizes[0], inner), np.int64)
    step = max(1, TASK_WORDS // (inner * lights[0][0, :, 0].size))

    def of_first(first: int, start: int, end: int) -> None:
        own = weights.of(slice(start, end))
        some = [positions[:, :, start:end] for positions in (lights[0][first : first + 1], *lights[1:])]

        def add(light: int, so_far: Counts, at: int) -> int:
            # sums of the combinations of the lights from `light` on, written from `at` on; where the next ones go
            if light < len(some) - 1:
                for positions in some[light]:
                    at = add(light + 1, add_counts(so_far, positions), at)
                return at
            here = slice(at, at + len(some[light]))
            sums = covers[first, here], benefits[first, here]
            _last(so_far, some[light], own.areas, own.masks, own.factors, *sums)
            return here.stop

        add(0, own.zero_counts(k), 0)

    for start in range(0, patches, step):
        # a row of the tables is written by one task at a time
        tasks = ((of_first, (first, start, min(start + step, patches))) for first in range(sizes[0]))
        run_all(tasks, threads=threads, done=None if progress is None else lambda: progress(1.0))
    return covers.ravel(), benefits.ravel()


@kernel
def _last(
    counts: Counts,
    positions: PositionCounts,
    areas: Int64,
    masks: Words,
    factors: Int64,
    covered: Int64,
    benefit: Int64,
) -> None:
    k = counts.shape[0]
    for c in range(len(positions)):
        for p in range(counts.shape[1]):
            most, each = np.int64(0), np.int64(0)
            for w in range(counts.shape[2]):
                for level in range(k):
                    flags = counts[level, p, w] | positions[c, level, p, w]
                    for low in range(level):
                        flags |= counts[low, p, w] & positions[c, level - 1 - low, p, w]
                    if flags:
                        value = word_weight(flags, w, masks, factors)
                        each += value
                        if level == k - 1:
                            most += value
            covered[c] += areas[p] * most
            benefit[c] += areas[p] * each


Rows = Sequence[Int64]

# of the counts of all candidate postures, and of all positions of the lights, that are held at a time
MOST_COUNT_BYTES = 1_500_000_000


@dataclass(frozen=True, kw_only=True)
class LightPositions:
    """One position of each light.

    candidates: Index of each light's position.
    covered: Weight of the pairs that are seen in k images or more.
    benefit: Σ weight · min(k, count); decides between positions that cover the same.
    exact: Whether all combinations were tried; else lights were moved one at a time until that gained nothing.
    """

    candidates: tuple[int, ...]
    covered: int
    benefit: int
    exact: bool


def place_lights(
    lights: Sequence[PositionCounts],
    weights: PairWeights,
    space: CombinationSpace,
    *,
    limit: int = DEFAULT_LIMIT,
    table_cells: int = TABLE_CELLS,
    threads: int | None = None,
    progress: Share | None = None,
) -> LightPositions:
    """Positions of lights that stand the same in all postures: most covered, then most benefit, then first in order.

    lights: Of each light, counts of each position over all postures, shape (positions, k, p, words).
    limit: With more combinations than that, lights are moved one at a time.
    table_cells: Most combinations to try at once.
    Raises InputError: No combination is allowed.
    """
    exact = sum(math.prod(len(rows) for rows in group) for group in space.groups) <= limit
    boxes = [box for group in space.groups for box in (_boxes(group, table_cells) if exact else [group])]
    search = _Search(lights, weights, space, threads)
    found: list[LightPositions | None] = []
    for done, box in enumerate(boxes):
        report = part_of(progress, done / len(boxes), (done + 1) / len(boxes))
        found.append(search.best_of(box, report) if exact else search.one_at_a_time(box))
    best = max(filter(None, found), key=lambda one: (one.covered, one.benefit), default=None)
    if best is None:
        raise InputError(
            "no combination of the lights' positions is left: in each, panels collide; widen their ranges or take "
            "smaller panels"
        )
    return best


def _boxes(rows: Rows, most: int) -> Iterator[Rows]:
    # pieces of at most so many combinations, those that come first in order first
    inner = math.prod(len(some) for some in rows[1:])
    step = max(1, most // inner)
    for start in range(0, len(rows[0]), step):
        first = rows[0][start : start + step]
        if inner <= most or len(rows) == 1:
            yield first, *rows[1:]
        else:
            for rest in _boxes(rows[1:], most):
                yield first, *rest


@dataclass(frozen=True, eq=False)
class _Search:
    lights: Sequence[PositionCounts]
    weights: PairWeights
    space: CombinationSpace
    threads: int | None

    def best_of(self, rows: Rows, progress: Share | None = None) -> LightPositions | None:
        allowed = allowed_mask(self.space, tuple(rows))
        if allowed is not None and not allowed.any():
            return None
        some = [select_rows(positions, own) for positions, own in zip(self.lights, rows, strict=True)]
        covered, benefit = combination_sums(some, self.weights, threads=self.threads, progress=progress)
        if allowed is not None:
            covered, benefit = np.where(allowed, covered, -1), np.where(allowed, benefit, -1)
        most = int(covered.max())
        at = int(np.argmax(np.where(covered == most, benefit, -1)))
        chosen = tuple(int(own[i]) for own, i in zip(rows, digits(at, rows), strict=True))
        return LightPositions(candidates=chosen, covered=most, benefit=int(benefit[at]), exact=True)

    def one_at_a_time(self, rows: Rows) -> LightPositions | None:
        now = first_allowed(self.space, rows)
        if now is None:
            return None
        best: LightPositions | None = None
        moved = True
        while moved:
            moved = False
            for i in range(len(rows)):
                found = self.best_of([own if j == i else np.array([now[j]]) for j, own in enumerate(rows)])
                assert found is not None
                if best is None or (found.covered, found.benefit) > (best.covered, best.benefit):
                    best = replace(found, exact=False)
                    now, moved = list(found.candidates), True
        return best


def first_allowed(space: CombinationSpace, rows: Rows) -> list[int] | None:
    """The first combination without collisions, in the order of the rows; None where there is none."""
    # depth first: with so many combinations, a mask of them all is too large
    chosen: list[int] = []

    def fits(light: int, position: int) -> bool:
        return not any((j == light and space.clashes[i, j][chosen[i], position]) for i, j in space.clashes if i < light)

    def go(light: int) -> bool:
        if light == len(rows):
            return True
        for position in map(int, rows[light]):
            if fits(light, position):
                chosen.append(position)
                if go(light + 1):
                    return True
                chosen.pop()
        return False

    return chosen if go(0) else None


def position_counts_fit(evaluator: ImageEvaluator, candidates: Candidates | None, *, min_images: int) -> bool:
    """Whether memory suffices for the counts of all positions of the lights."""
    positions = 0 if candidates is None else sum(len(some) for some in candidates.panels)
    pairs = len(evaluator.patches) * evaluator.weights.masks.shape[1]
    # those of a posture's images beside the sums
    return positions * (min_images + 1) * pairs * 8 <= MOST_COUNT_BYTES


def position_counts(
    evaluator: ImageEvaluator,
    postures: Sequence[tuple[Posture, tuple[float, ...]]],
    candidates: Candidates,
    *,
    min_images: int,
    progress: Share | None = None,
) -> list[PositionCounts]:
    """What each position of each light shows in postures: counts, of each light of shape (positions, k, p, words).

    Each posture comes with the exposures that an image of it may be taken with; k is `min_images`.
    """
    empty = evaluator.weights.zero_counts(min_images)
    totals = [np.repeat(empty[None], len(some), axis=0) for some in candidates.panels]
    for done, (posture, exposures) in enumerate(postures, start=1):
        images = replace(evaluator, exposures=exposures).flags(posture, candidates.panels)
        for total, layer in zip(totals, images, strict=True):
            for position, flags in enumerate(layer):
                total[position] = add_counts(total[position], counts_of_images([flags], min_images))
        if progress is not None:
            progress(done / len(postures))
    return totals


def best_positions(
    evaluator: ImageEvaluator,
    postures: Sequence[tuple[Posture, tuple[float, ...]]],
    candidates: Candidates,
    *,
    min_images: int,
    limit: int = DEFAULT_LIMIT,
    progress: Share | None = None,
) -> tuple[LightPositions, list[PositionCounts]]:
    """The positions of the lights that show most in postures, and the counts of all positions."""
    counted = len(postures) / (len(postures) + 1)
    counts = position_counts(
        evaluator, postures, candidates, min_images=min_images, progress=part_of(progress, 0.0, counted)
    )
    positions = place_lights(
        counts,
        evaluator.weights,
        candidates.space,
        limit=limit,
        threads=evaluator.threads,
        progress=part_of(progress, counted, 1.0),
    )
    return positions, counts
