"""Few postures and one set of light positions that together show most of the surface.

The lights are mounted once and stand the same in all postures. Postures and lights depend on each other, so they are
searched alternately, until neither improves the other. The lights are placed for the postures by trying every
combination of their positions; the postures are chosen for the lights by greedy cover and exchanges. No step shows less
than the one before, so that the search ends: in a local optimum, which depends on the start.

The search starts at several light positions: the rig's own, the best for one single posture, and both ends of the
ranges. It runs on drawn patches; the best solution is refined on all patches, and so are gains and bound of the choice.

A target is reached by the fewest postures whose choice by number reaches it, so that a number and a target that takes
as many give the same plan.
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial

import numpy as np

from lightopt.core.run_context import RunContext, Share
from lightopt.core.transforms import Posture
from lightopt.design._candidates import Candidates
from lightopt.design.postures import _light_positions
from lightopt.design.postures._cover_search import Cover, best_set, greedy_cover, improve_by_exchange
from lightopt.design.postures._exposures import Brackets
from lightopt.design.responses._image_evaluator import ImageCache, ImageEvaluator
from lightopt.design.responses._pairs import Counts, packed_bytes, refuse_memory
from lightopt.design.search._exact_search import DEFAULT_LIMIT
from lightopt.lights import PanelLight

MOST_ITERATIONS, MOST_FINAL_ITERATIONS = 6, 3  # of the alternating search, on drawn patches and on all
DRAWN_MARGIN = 0.01  # share by which what drawn patches show may fall short of a target and still be tried on all

# of the counts that are cached for recent lights, and of the images that are
CACHED_BYTES = 400_000_000


Lights = tuple[int, ...] | None  # candidate of each light; None for the rig's own positions


@dataclass(frozen=True, kw_only=True)
class PostureRequest:
    """The share that the postures are to show, and their maximum number."""

    count: int | None = None  # most postures; as many as the target takes where None
    target: float | None = None  # share of the pairs to be shown
    limit: int = DEFAULT_LIMIT  # most combinations to try; with more, lights are moved one at a time


@dataclass(frozen=True, kw_only=True)
class Solution:
    panels: tuple[PanelLight, ...]  # the lights, world frame
    cover: Cover  # the postures, with their gains and bound, over all patches and candidate postures, with these lights
    lights: Lights = None  # index of each one's candidate; None where they keep their initial positions
    exact: bool = True  # whether every combination of the lights was tried in every iteration
    iterations: int = 0  # how often the lights were placed on the way
    converged: bool = True  # whether no combination of the positions tried last shows more in these postures


@dataclass(frozen=True, kw_only=True)
class PostureChoice(Solution):
    postures: tuple[Posture, ...]  # in the order in which they were chosen
    starts: int  # number of starting positions of the search
    # what the rig's lights show in their initial positions, of the drawn patches at exposure 1, in postures that are
    # chosen for them, fewer than the plan's where no other adds anything
    initial: Cover
    initial_panels: tuple[PanelLight, ...] = field(compare=False, repr=False)  # these lights
    on_all_patches: bool  # whether the last iterations used all patches: not where memory is too small
    images: ImageCache | None = field(default=None, compare=False, repr=False)  # of all patches, at those exposures
    brackets: Brackets | None = None  # which further exposures are planned; None where there were none to choose from

    def exposures_of(self, posture: Posture) -> tuple[float, ...]:
        return (1.0,) if self.brackets is None else self.brackets.of(posture)

    @property
    def initial_if_moved(self) -> Cover | None:
        """What the rig's lights show in their initial positions; None where they stay there."""
        same = (
            np.allclose(old.outward, new.outward, rtol=0.0, atol=1e-9)
            for old, new in zip(self.initial_panels, self.panels, strict=True)
        )
        return None if all(same) else self.initial


def merit(cover: Cover, request: PostureRequest) -> tuple[float, ...]:
    """Sort key of a cover: reaching the target with few postures first; without a target, more seen."""
    if request.target is not None and cover.share >= request.target:
        return (1.0, -len(cover.steps), cover.covered, cover.benefit)
    return (0.0, cover.covered, cover.benefit)


@dataclass(eq=False)
class AlternatingSearch:
    """Alternating search on the patches of an evaluator; results for lights or postures are cached."""

    evaluator: ImageEvaluator  # of the postures to choose from
    candidates: Candidates | None  # positions of the lights to choose from; None where no light moves
    _: KW_ONLY
    where: str  # the patches, for progress messages
    prove: bool  # whether all sets of postures are searched where that is little work
    run: RunContext

    def __post_init__(self) -> None:
        self.postures = self.evaluator.table.postures
        self._passes = 0
        self._counts: dict[Lights, Sequence[Counts]] = {}
        self._positions: dict[tuple[int, ...], _light_positions.LightPositions] = {}

    def improve(self, solution: Solution, most: int, request: PostureRequest) -> Solution:
        """Place lights for the postures and choose postures for the lights, while that gains; `most` times at most."""
        if self.candidates is None:
            return replace(solution, converged=True)
        for _ in range(most):
            positions = self.lights(solution.cover.chosen, request)
            exact, converged = solution.exact and positions.exact, positions.covered <= solution.cover.covered
            solution = replace(solution, exact=exact, iterations=solution.iterations + 1, converged=converged)
            if positions.candidates == solution.lights:
                return solution
            panels = self.candidates.panels_at(positions.candidates)
            better = self.cover(panels, positions.candidates, request, before=solution.cover.chosen)
            gained = merit(better, request) > merit(solution.cover, request)
            # positions of the grid are preferred to the rig's own where they are as good
            as_good = merit(better, request) == merit(solution.cover, request)
            if not gained and not (as_good and solution.lights is None):
                return solution
            solution = replace(solution, panels=panels, cover=better, lights=positions.candidates, converged=False)
        return solution

    def cover(
        self, panels: Sequence[PanelLight], lights: Lights, request: PostureRequest, before: Sequence[int] = ()
    ) -> Cover:
        """Postures for lights: a greedy choice and those of the previous iteration, both improved by exchanges.

        With `prove` and a fixed number, the best of all sets of as many, where the search for it completes.
        """
        counts, weights = self._counts_under(panels, lights), self.evaluator.weights
        threads = self.evaluator.threads
        greedy = partial(greedy_cover, counts, weights, count=request.count, target=request.target, threads=threads)
        covers = [greedy()]
        sets = [covers[0].chosen, tuple(before)]
        if request.target is None:
            sets = [improve_by_exchange(counts, weights, one, threads=threads) for one in sets]
        covers += [greedy(among=one) for one in sets if one and one != covers[0].chosen]
        best = max(covers, key=lambda cover: merit(cover, request))
        if self.prove and request.target is None and request.count is not None:
            size = min(request.count, len(counts))
            chosen, max_covered, sets = best_set(counts, weights, best.chosen, size, threads=threads)
            if chosen != best.chosen:
                covers.append(greedy(among=chosen))
                best = covers[-1]
            # unchanged where the search ended without a proof
            best = best if sets is None else replace(best, sets=sets, max_covered=max_covered)
        same = [cover.bounds for cover in covers if len(cover.bounds) == len(best.bounds)]
        return replace(best, bounds=tuple(min(bounds) for bounds in zip(*same, strict=True)))

    def lights(self, chosen: Sequence[int], request: PostureRequest) -> _light_positions.LightPositions:
        assert self.candidates is not None
        key = tuple(sorted(chosen))
        if key not in self._positions:
            self._passes += 1
            # images of all positions of the lights are kept
            evaluator = replace(self.evaluator, keeps_images=True)
            postures, where = [(self.postures[i], evaluator.exposures) for i in key], self._stage("lights for postures")
            found = _light_positions.best_positions(
                evaluator, postures, self.candidates, limit=request.limit, progress=where
            )
            self._positions[key] = found
        return self._positions[key]

    def _counts_under(self, panels: Sequence[PanelLight], lights: Lights) -> Sequence[Counts]:
        # what every posture shows under these lights, once for as many as there is room for
        if lights not in self._counts:
            self._passes += 1
            if (len(self._counts) + 1) * count_bytes(self.evaluator) > CACHED_BYTES:
                # those of the initial positions are needed again at the end
                self._counts = {one: counts for one, counts in self._counts.items() if one is None}
            progress = self._stage("postures for lights")
            self._counts[lights] = self.evaluator.counts_of_postures(panels, progress)
        return self._counts[lights]

    def _stage(self, name: str) -> Share:
        return self.run.stage(f"{name}, {self.where}, pass {self._passes}")


def count_bytes(evaluator: ImageEvaluator) -> int:
    """Most bytes of the counts of all postures under some lights."""
    assert evaluator.detection is not None
    table, defects = evaluator.table, len(evaluator.detection.catalogue.defects)
    seen = sum(int(np.count_nonzero(rows & ~left)) for rows, left in zip(table.visible, table.grazing, strict=True))
    return packed_bytes(seen, evaluator.needed, defects)


def choose_postures(
    whole: ImageEvaluator,
    drawn: ImageEvaluator,
    start: Sequence[PanelLight],
    candidates: Candidates | None,
    request: PostureRequest,
    *,
    run: RunContext | None = None,
) -> PostureChoice:
    """Choose postures and light positions.

    whole, drawn: All patches, and those that the first iterations use; both of the postures to choose from.
    start: The lights in their initial positions, world frame.
    candidates: Positions to choose from; None where no light moves.
    Raises InputError: More postures than memory is meant for; lights that collide in every combination.
    """
    what = f"counts: {len(whole.table.postures)} postures × {len(whole.patches):,} patches"
    room, remedy = _light_positions.MOST_COUNT_BYTES, "raise option 'posture_step_deg'"
    refuse_memory(what, count_bytes(whole), room, remedy)
    search = partial(AlternatingSearch, candidates=candidates, run=run or RunContext())
    # the chosen postures are looked at again when they are found
    full = on_drawn = search(replace(whole, images=ImageCache(CACHED_BYTES)), where="all patches", prove=True)
    if drawn.table is not whole.table:
        # lights and postures come back from pass to pass
        drawn = replace(drawn, images=ImageCache(CACHED_BYTES), keeps_images=True)
        on_drawn = search(drawn, where="drawn patches", prove=False)
    return _MultiStartSearch(full, on_drawn, tuple(start), request).choice()


class _MultiStartSearch:
    def __init__(
        self, full: AlternatingSearch, drawn: AlternatingSearch, start: tuple[PanelLight, ...], request: PostureRequest
    ) -> None:
        self.full_search, self.drawn_search, self.start, self.request = full, drawn, start, request
        self.candidates, self.starts = full.candidates, 1
        self.on_all_patches = drawn is full or _light_positions.position_counts_fit(full.evaluator, full.candidates)
        self._drawn: dict[int, Solution] = {}

    def choice(self) -> PostureChoice:
        if self.request.target is None:
            solution = self._refine(self._best_on_drawn(self.request.count))
        else:
            solution = self._fewest(self.request.target)
        one = replace(self.request, count=max(1, len(solution.cover.steps)), target=None)
        initial = self.drawn_search.cover(self.start, None, one)
        solution = replace(solution, cover=replace(solution.cover, target=self.request.target))
        return PostureChoice(
            **vars(solution),
            postures=tuple(self.full_search.postures[i] for i in solution.cover.chosen),
            starts=self.starts,
            initial=initial,
            initial_panels=self.start,
            on_all_patches=self.on_all_patches,
            images=self.full_search.evaluator.images,
        )

    def _fewest(self, target: float) -> Solution:
        # a rough number first, then the fewest whose choice by number reaches the target on all patches
        rough = self._search_from_all_starts(self.request)
        most = self.request.count or len(self.full_search.postures)
        enough = count = len(rough.cover.steps) if rough.cover.share >= target else most
        if rough.cover.share < target and self.request.count is None:
            # drawn patches may show less than all do: those decide
            solution = self._refine(rough)
            if self.drawn_search is self.full_search or solution.cover.all_covered < target * solution.cover.total:
                return solution
            enough = count = max(1, len(rough.cover.steps))
        while count > 1 and self._best_on_drawn(count - 1).cover.share >= target - DRAWN_MARGIN:
            count -= 1
        failures = 0
        while True:
            solution = self._refine(self._best_on_drawn(count))
            if solution.cover.share < target and len(solution.cover.steps) < count:
                # more than these add nothing on drawn patches, and may on all
                solution = self._refine(self._best_on_drawn(count), count)
            short = solution.cover.share < target and len(solution.cover.steps) == count < most
            # with so many, not even all postures under these lights; those of the next number may show more
            failures += count >= enough and solution.cover.all_covered < target * solution.cover.total
            if not short or failures > 1:
                return solution
            count += 1

    def _best_on_drawn(self, count: int | None) -> Solution:
        # the best of so many postures on drawn patches
        assert count is not None
        if count not in self._drawn:
            self._drawn[count] = self._search_from_all_starts(replace(self.request, count=count, target=None))
        return self._drawn[count]

    def _refine(self, solution: Solution, count: int | None = None) -> Solution:
        # continue on all patches, with the number of chosen postures, or more, instead of the target
        if self.drawn_search is self.full_search:
            return solution
        if self.drawn_search.evaluator.images is not None:
            self.drawn_search.evaluator.images.clear()  # all patches take the memory
        request = replace(self.request, count=count or max(1, len(solution.cover.steps)), target=None)
        cover = self.full_search.cover(solution.panels, solution.lights, request, before=solution.cover.chosen)
        solution = replace(solution, cover=cover, converged=self.candidates is None)
        return self.full_search.improve(solution, MOST_FINAL_ITERATIONS, request) if self.on_all_patches else solution

    def _search_from_all_starts(self, request: PostureRequest) -> Solution:
        found: list[Solution] = []
        for lights in self._starts(request):
            panels = self.start if lights is None or self.candidates is None else self.candidates.panels_at(lights)
            cover = self.drawn_search.cover(panels, lights, request)
            start = Solution(panels=panels, lights=lights, cover=cover, converged=False)
            found.append(self.drawn_search.improve(start, MOST_ITERATIONS, request))
        self.starts = len(found)
        return max(found, key=lambda solution: merit(solution.cover, request))

    def _starts(self, request: PostureRequest) -> tuple[tuple[int, ...] | None, ...]:
        # the initial positions; the best for the best single posture; all at the lower, all at the upper ends
        if self.candidates is None:
            return (None,)
        one = self.drawn_search.cover(self.start, None, replace(request, count=1, target=None))
        space = self.candidates.space
        ends = (
            _light_positions.first_allowed(space, space.groups[0]),
            _light_positions.first_allowed(space, [rows[::-1] for rows in space.groups[-1]]),
        )
        alone = [self.drawn_search.lights(one.chosen, request).candidates] if one.chosen else []
        return tuple(dict.fromkeys([None, *alone, *(end for end in ends if end is not None)]))
