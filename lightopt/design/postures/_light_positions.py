"""Positions of lights that stand the same in all postures: the combination of candidates that shows most.

Every combination is tried, a table of so many after the other; where there are too many, lights are moved one at a
time until that gains nothing.

The units of evidence of a position are added up over the postures before
(:mod:`lightopt.design.responses._pairs`), so that a combination adds up one count per light, whatever the number
of postures (:mod:`lightopt.design.objectives._scores_by_units`).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Int64
from lightopt.core.errors import InputError
from lightopt.core.run_context import Share, ignore, part_of
from lightopt.core.transforms import Posture
from lightopt.design._candidates import Candidates
from lightopt.design.objectives._scores_by_units import PositionCounts, combination_sums
from lightopt.design.responses._evidence import UNITS_OF_IMAGE
from lightopt.design.responses._image_evaluator import ImageEvaluator, PatchRow
from lightopt.design.responses._luminance_matrix import select_rows
from lightopt.design.responses._pairs import Packed, PackedCounts, PairWeights, add_units, pack_counts
from lightopt.design.search import _exact_search
from lightopt.design.search._between_steps import CellBound, ProbedCells, cell_flags
from lightopt.lights import PanelLight

Rows = Sequence[Int64]
ExposedPosture = tuple[Posture, tuple[float, ...]]  # with the exposures that an image of it may be taken with

# of the counts of all candidate postures, and of all positions of the lights, that are held at a time
MOST_COUNT_BYTES = 1_500_000_000

POSITIONS_AT_ONCE = 8  # positions of a light that one task of another process counts


@dataclass(frozen=True, kw_only=True)
class LightPositions:
    candidates: tuple[int, ...]  # index of each light's position
    covered: int  # weight of the pairs that are found
    benefit: int  # Σ weight · min(needed, units); decides between positions that cover the same
    exact: bool  # whether all combinations were tried; else lights were moved one at a time until that gained nothing


def place_lights(
    lights: Sequence[PositionCounts],
    weights: PairWeights,
    space: _exact_search.CombinationSpace,
    *,
    needed: int,
    limit: int = _exact_search.DEFAULT_LIMIT,
    table_cells: int = _exact_search.TABLE_CELLS,
    threads: int | None = None,
    progress: Share | None = None,
) -> LightPositions:
    """Positions of lights that stand the same in all postures: most covered, then most benefit, then first in order.

    lights: Of each light, units of each position over all postures, shape (positions, k, p, words).
    needed: Units of a pair that is found.
    limit: With more combinations than that, lights are moved one at a time.
    table_cells: Most combinations to try at once.
    Raises InputError: No combination is allowed.
    """
    exact = sum(math.prod(len(rows) for rows in group) for group in space.groups) <= limit
    boxes = [box for group in space.groups for box in (_boxes(group, table_cells) if exact else [group])]
    search = _Search(lights, weights, space, needed, threads)
    found: list[LightPositions | None] = []
    for done, box in enumerate(boxes):
        report = part_of(progress, done / len(boxes), (done + 1) / len(boxes))
        found.append(search.best_of(box, report) if exact else search.one_at_a_time(box))
    best = max(filter(None, found), key=lambda one: (one.covered, one.benefit), default=None)
    if best is None:
        raise InputError(_exact_search.NO_COMBINATION)
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
    space: _exact_search.CombinationSpace
    needed: int
    threads: int | None

    def best_of(self, rows: Rows, progress: Share | None = None) -> LightPositions | None:
        allowed = _exact_search.allowed_mask(self.space, tuple(rows))
        if allowed is not None and not allowed.any():
            return None
        some = [select_rows(positions, own) for positions, own in zip(self.lights, rows, strict=True)]
        covered, benefit = combination_sums(some, self.weights, self.needed, threads=self.threads, progress=progress)
        if allowed is not None:
            covered, benefit = np.where(allowed, covered, -1), np.where(allowed, benefit, -1)
        most = int(covered.max())
        at = int(np.argmax(np.where(covered == most, benefit, -1)))
        chosen = tuple(int(own[i]) for own, i in zip(rows, _exact_search.digits(at, rows), strict=True))
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
                    now, moved = found.candidates, True
        return best


def first_allowed(
    space: _exact_search.CombinationSpace, rows: Rows, before: tuple[int, ...] = ()
) -> tuple[int, ...] | None:
    """The first combination without collisions, in the order of the rows, that begins so; None where there is none."""
    # depth first: with so many combinations, a mask of them all is too large
    light = len(before)
    if light == len(rows):
        return before
    clashes = [clash[before[i]] for (i, j), clash in space.clashes.items() if j == light]
    free = (position for position in map(int, rows[light]) if not any(clash[position] for clash in clashes))
    found = (first_allowed(space, rows, (*before, position)) for position in free)
    return next((one for one in found if one is not None), None)


def position_counts_fit(evaluator: ImageEvaluator, candidates: Candidates | None) -> bool:
    """Whether memory suffices for the counts of all positions of the lights."""
    positions = 0
    if candidates is not None:
        cells = candidates.cells.of_lights
        positions = max(sum(len(some) for some in candidates.panels), sum(len(own.cells) for own in cells))
    pairs = len(evaluator.patches) * evaluator.weights.masks.shape[1]
    # those of a posture's images beside the sums
    return positions * (evaluator.needed + UNITS_OF_IMAGE) * pairs * 8 <= MOST_COUNT_BYTES


def position_counts(
    evaluator: ImageEvaluator, postures: Sequence[ExposedPosture], candidates: Candidates, progress: Share
) -> list[PositionCounts]:
    """Units of evidence, up to what is needed, by each position of each light in postures: (positions, k, p, words)."""
    panels = candidates.panels
    if evaluator.pool is None:
        return _added_counts(evaluator, postures, panels, progress)
    totals = [_zero_counts(evaluator, len(some)) for some in panels]
    blocks = [
        (light, slice(start, min(start + POSITIONS_AT_ONCE, len(some))))
        for light, some in enumerate(panels)
        for start in range(0, len(some), POSITIONS_AT_ONCE)
    ]

    def keep(number: int, packed: list[Packed]) -> None:
        light, some = blocks[number]
        totals[light][some] = list(PackedCounts(packed, totals[light].shape[1:]))

    rows = [(evaluator.row(posture), exposures) for posture, exposures in postures]
    evaluator.spread(_packed_block, blocks, keep, rows, panels, threads=evaluator.threads, progress=progress)
    return totals


def _packed_block(
    block: tuple[int, slice],
    evaluator: ImageEvaluator,
    rows: Sequence[tuple[PatchRow, tuple[float, ...]]],
    panels: Sequence[Sequence[PanelLight]],
) -> list[Packed]:
    light, some = block
    own, postures = evaluator.of_rows([row for row, _ in rows]), [(row[0], exposures) for row, exposures in rows]
    (total,) = _added_counts(own, postures, [panels[light][some]])
    return [pack_counts(counts) for counts in total]


def _added_counts(
    evaluator: ImageEvaluator,
    postures: Sequence[ExposedPosture],
    panels: Sequence[Sequence[PanelLight]],
    progress: Share = ignore,
    corners: Sequence[Sequence[Int64]] | None = None,
) -> list[PositionCounts]:
    # of each position, or of each cell with corners among them: what the best corner shows, posture by posture
    sizes = map(len, panels if corners is None else corners)
    totals = [_zero_counts(evaluator, size) for size in sizes]
    for done, (posture, exposures) in enumerate(postures, start=1):
        images = replace(evaluator, exposures=exposures).flags(posture, panels)
        for light, (total, layer) in enumerate(zip(totals, images, strict=True)):
            for place in range(len(total)):
                add_units(total[place], layer[place] if corners is None else cell_flags(layer, corners[light][place]))
        progress(done / len(postures))
    return totals


def _zero_counts(evaluator: ImageEvaluator, positions: int) -> PositionCounts:
    return np.repeat(evaluator.weights.zero_counts(evaluator.needed)[None], positions, axis=0)


def bound_between(
    evaluator: ImageEvaluator,
    postures: Sequence[ExposedPosture],
    candidates: Candidates,
    *,
    limit: int = _exact_search.DEFAULT_LIMIT,
    progress: Share | None = None,
) -> CellBound | None:
    """What no combination of cells covers in these postures; None where combinations are too many to try."""
    space, cells = candidates.cells.space, candidates.cells.of_lights
    if sum(math.prod(len(rows) for rows in group) for group in space.groups) > limit:
        return None
    panels = [(*own, *light.beyond) for own, light in zip(candidates.panels, cells, strict=True)]
    corners = [light.corners for light in cells]
    counted = len(postures) / (len(postures) + 1)
    counts = _added_counts(evaluator, postures, panels, part_of(progress, 0.0, counted), corners)
    weights, needed, rest = evaluator.weights, evaluator.needed, part_of(progress, counted, 1.0)
    threads = evaluator.threads
    best = place_lights(counts, weights, space, needed=needed, limit=limit, threads=threads, progress=rest)
    return CellBound(best.covered, best.candidates)


def excess_of_counts(tested: ProbedCells, evaluator: ImageEvaluator, postures: Sequence[ExposedPosture]) -> float:
    """What places inside tested cells add to what is covered in postures, as a share of all pairs."""
    weights = evaluator.weights
    images = [replace(evaluator, exposures=exposures).flags(one, tested.panels) for one, exposures in postures]

    def score(rows: Sequence[Int64]) -> float:
        best = (cell_flags(flags, own) for layers in images for flags, own in zip(layers, rows, strict=True))
        return float(weights.covered(weights.sum_counts(best, evaluator.needed)))

    return tested.excess(score) / max(1, weights.total)


def best_positions(
    evaluator: ImageEvaluator,
    postures: Sequence[ExposedPosture],
    candidates: Candidates,
    *,
    limit: int = _exact_search.DEFAULT_LIMIT,
    progress: Share | None = None,
) -> LightPositions:
    counted = len(postures) / (len(postures) + 1)
    counts = position_counts(evaluator, postures, candidates, part_of(progress, 0.0, counted))
    weights, space, rest = evaluator.weights, candidates.space, part_of(progress, counted, 1.0)
    how = {"needed": evaluator.needed, "limit": limit}
    return place_lights(counts, weights, space, **how, threads=evaluator.threads, progress=rest)
