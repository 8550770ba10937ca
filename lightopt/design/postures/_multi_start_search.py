"""Few postures and one set of light positions that together show most of the surface.

The lights are mounted once and stand the same in all postures. Postures and lights depend on each other, so they are
searched alternately (:mod:`lightopt.design.postures._alternating_search`), which ends in a local optimum. The search
starts at several light positions: the rig's own, the best for one single posture, and both ends of the ranges. It runs
on drawn patches; the best solution is refined on all patches, and so are gains and bound of the choice.

A target is reached by the fewest postures whose choice by number reaches it, so that a number and a target that takes
as many give the same plan.
"""

from collections.abc import Sequence
from dataclasses import replace

from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.postures._alternating_search import AlternatingSearch, Solution, merit
from lightopt.design.postures._choice import InitialLights, PostureChoice, PostureRequest
from lightopt.design.postures._image_evaluator import ImageEvaluator
from lightopt.design.postures._light_positions import MOST_COUNT_BYTES, first_allowed, position_counts_fit
from lightopt.scene import PanelLight

MOST_ITERATIONS, MOST_FINAL_ITERATIONS = 6, 3  # of the alternating search, on drawn patches and on all
DRAWN_MARGIN = 0.01  # share by which what drawn patches show may fall short of a target and still be tried on all


def choose_postures(
    whole: ImageEvaluator,
    drawn: ImageEvaluator,
    postures: Sequence[Posture],
    start: Sequence[PanelLight],
    candidates: Candidates | None,
    request: PostureRequest,
    *,
    run: RunContext | None = None,
) -> PostureChoice:
    """Choose postures and light positions.

    whole, drawn: All patches, and those that the first iterations use; both of all postures.
    postures: To choose from, at least one.
    start: The lights in their initial positions, world frame.
    candidates: Positions to choose from; None where no light moves.
    Raises InputError: More postures than memory is meant for; lights that collide in every combination.
    """
    size = len(postures) * request.min_images * len(whole.patches) * whole.weights.masks.shape[1] * 8
    if size > MOST_COUNT_BYTES:
        raise InputError(
            f"{len(postures)} postures × {len(whole.patches):,} patches are {size / 1e9:.2f} GB of counts, and there "
            f"is room for {MOST_COUNT_BYTES / 1e9:.2f} GB; raise option 'posture_step_deg' or lower option "
            "'patch_budget'"
        )
    return _MultiStartSearch(whole, drawn, postures, start, candidates, request, run or RunContext()).choice()


class _MultiStartSearch:
    def __init__(
        self,
        whole: ImageEvaluator,
        drawn: ImageEvaluator,
        postures: Sequence[Posture],
        start: Sequence[PanelLight],
        candidates: Candidates | None,
        request: PostureRequest,
        run: RunContext,
    ) -> None:
        self.request, self.postures, self.start = request, postures, tuple(start)
        self.candidates = candidates
        min_images = request.min_images
        self.full_search = AlternatingSearch(
            whole, postures, candidates, min_images=min_images, where="all patches", prove=True, run=run
        )
        self.drawn_search = (
            self.full_search
            if drawn.table is whole.table
            else AlternatingSearch(
                drawn, postures, candidates, min_images=min_images, where="drawn patches", prove=False, run=run
            )
        )
        self.on_all_patches = self.drawn_search is self.full_search or position_counts_fit(
            whole, candidates, min_images=min_images
        )
        self.starts = 1
        self._drawn: dict[int, Solution] = {}

    def choice(self) -> PostureChoice:
        if self.request.target is None:
            solution = self._refine(self._best_on_drawn(self.request.count))
        else:
            solution = self._fewest(self.request.target)
        one = replace(self.request, count=max(1, len(solution.cover.steps)), target=None)
        initial = self.drawn_search.cover(self.start, None, one)
        cover = solution.cover
        if self.request.target is not None:
            cover = replace(cover, min_size=cover.fewest(self.request.target))
        return PostureChoice(
            postures=tuple(self.postures[i] for i in cover.chosen),
            cover=cover,
            lights=solution.lights,
            panels=solution.panels,
            exact=solution.exact,
            iterations=solution.iterations,
            starts=self.starts,
            initial=InitialLights(share=initial.share, postures=len(initial.steps), panels=self.start),
            on_all_patches=self.on_all_patches,
            converged=solution.converged,
            position_counts=self.full_search.position_counts(cover.chosen),
        )

    def _fewest(self, target: float) -> Solution:
        # a rough number first, then the fewest whose choice by number reaches the target on all patches
        rough = self._search_from_all_starts(self.request)
        most = self.request.count or len(self.postures)
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
        request = replace(self.request, count=count or max(1, len(solution.cover.steps)), target=None)
        cover = self.full_search.cover(solution.panels, solution.lights, request, before=solution.cover.chosen)
        solution = replace(solution, cover=cover, converged=self.candidates is None)
        return self.full_search.improve(solution, MOST_FINAL_ITERATIONS, request) if self.on_all_patches else solution

    def _search_from_all_starts(self, request: PostureRequest) -> Solution:
        best: Solution | None = None
        starts = self._starts(request)
        self.starts = len(starts)
        for lights in starts:
            panels = self.start if lights is None else self.drawn_search.panels(lights)
            solution = self.drawn_search.improve(
                self.drawn_search.solution_for(panels, lights, request), MOST_ITERATIONS, request
            )
            if best is None or merit(solution.cover, request) > merit(best.cover, request):
                best = solution
        assert best is not None
        return best

    def _starts(self, request: PostureRequest) -> tuple[tuple[int, ...] | None, ...]:
        # the initial positions; the best for the best single posture; all at the lower, all at the upper ends
        if self.candidates is None:
            return (None,)
        one = self.drawn_search.cover(self.start, None, replace(request, count=1, target=None))
        space = self.candidates.space
        ends = (first_allowed(space, space.groups[0]), first_allowed(space, [rows[::-1] for rows in space.groups[-1]]))
        alone = [self.drawn_search.lights(one.chosen, request).candidates] if one.chosen else []
        return tuple(dict.fromkeys([None, *alone, *(tuple(end) for end in ends if end is not None)]))
