"""Positions of lights that stand the same in all postures: the combination of candidates that shows most.

Every combination is tried, a table of so many after the other; where there are too many, lights are moved one at a
time until that gains nothing.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Int64
from lightopt.core.errors import InputError
from lightopt.core.run_context import Share, part_of
from lightopt.core.transforms import Posture
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.candidates._combination_space import CombinationSpace, allowed_mask
from lightopt.design.postures._combinations import PositionCounts, combination_sums
from lightopt.design.postures._counts import PairWeights, add_counts, counts_of_images, zero_counts
from lightopt.design.postures._image_evaluator import ImageEvaluator
from lightopt.design.responses._visibility import select_rows
from lightopt.design.search._exact_search import DEFAULT_LIMIT, TABLE_CELLS

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
    best: LightPositions | None = None
    for done, box in enumerate(boxes):

        def report(share: float, before: int = done) -> None:
            if progress is not None:
                progress((before + share) / len(boxes))

        found = (
            _best_of(lights, weights, space, box, threads, report)
            if exact
            else _one_at_a_time(lights, weights, space, box, threads)
        )
        if found is not None and (best is None or (found.covered, found.benefit) > (best.covered, best.benefit)):
            best = found
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


def _best_of(
    lights: Sequence[PositionCounts],
    weights: PairWeights,
    space: CombinationSpace,
    rows: Rows,
    threads: int | None,
    progress: Share | None,
) -> LightPositions | None:
    allowed = allowed_mask(space, tuple(rows))
    if allowed is not None and not allowed.any():
        return None
    covered, benefit = combination_sums(
        [select_rows(positions, some) for positions, some in zip(lights, rows, strict=True)],
        weights,
        threads=threads,
        progress=progress,
    )
    if allowed is not None:
        covered, benefit = np.where(allowed, covered, -1), np.where(allowed, benefit, -1)
    most = int(covered.max())
    at = int(np.argmax(np.where(covered == most, benefit, -1)))
    value = int(benefit[at])
    chosen: list[int] = []
    for some in reversed(rows):
        at, position = divmod(at, len(some))
        chosen.append(int(some[position]))
    return LightPositions(candidates=tuple(reversed(chosen)), covered=most, benefit=value, exact=True)


def _one_at_a_time(
    lights: Sequence[PositionCounts], weights: PairWeights, space: CombinationSpace, rows: Rows, threads: int | None
) -> LightPositions | None:
    now = first_allowed(space, rows)
    if now is None:
        return None
    best: LightPositions | None = None
    moved = True
    while moved:
        moved = False
        for i in range(len(lights)):
            some = [rows[j] if j == i else np.array([now[j]]) for j in range(len(lights))]
            found = _best_of(lights, weights, space, some, threads, None)
            assert found is not None
            if best is None or (found.covered, found.benefit) > (best.covered, best.benefit):
                best = LightPositions(
                    candidates=found.candidates, covered=found.covered, benefit=found.benefit, exact=False
                )
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
    empty = zero_counts(evaluator.weights, min_images)
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
