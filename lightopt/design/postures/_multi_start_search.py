"""Few postures and one set of light positions that together show most of the surface.

The lights are mounted once and stand the same in all postures. Postures and lights depend on each other, so they are
searched alternately (:mod:`lightopt.design.postures._alternating_search`), which ends in a local optimum. The search
starts at several light positions: the rig's own, the best for one single posture, and both ends of the ranges. It runs
on drawn patches; the best solution is refined on all patches, and so are gains and bound of the choice.

A target is reached by the fewest postures whose choice by number reaches it, so that a number and a target that takes
as many give the same plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.design._plan_progress import Tell
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.postures._alternating_search import AlternatingSearch, Solution, merit
from lightopt.design.postures._choice import InitialLights, PostureChoice, PostureRequest
from lightopt.design.postures._image_evaluator import ImageEvaluator
from lightopt.design.postures._light_positions import MOST_COUNT_BYTES, first_allowed, position_counts_fit
from lightopt.scene import PanelLight

MOST_TURNS, MOST_LAST_TURNS = 6, 3
"""On drawn patches and on all."""

DRAWN_MARGIN = 0.01
"""Share by which what drawn patches show may fall short of a target and still be tried on all."""


def choose_postures(
    whole: ImageEvaluator,
    drawn: ImageEvaluator,
    postures: Sequence[Posture],
    start: Sequence[PanelLight],
    candidates: Candidates | None,
    request: PostureRequest,
    *,
    progress: Tell | None = None,
) -> PostureChoice:
    """Choose postures and light positions.

    whole, drawn: All patches, and those that the first iterations use; both of all postures.
    postures: To choose from, at least one.
    start: The lights in their initial positions, world frame.
    candidates: Positions to choose from; None where no light moves.
    Raises InputError: More postures than memory is meant for; lights that collide in every combination.
    """
    size = len(postures) * request.seen_in * len(whole.patches) * whole.weights.masks.shape[1] * 8
    if size > MOST_COUNT_BYTES:
        raise InputError(
            f"{len(postures)} postures × {len(whole.patches):,} patches are {size / 1e9:.2f} GB of counts, and there "
            f"is room for {MOST_COUNT_BYTES / 1e9:.2f} GB; take a larger --posture-step or fewer --patches"
        )
    return _Chooser(whole, drawn, postures, start, candidates, request, progress).choice()


class _Chooser:
    def __init__(
        self,
        whole: ImageEvaluator,
        drawn: ImageEvaluator,
        postures: Sequence[Posture],
        start: Sequence[PanelLight],
        candidates: Candidates | None,
        request: PostureRequest,
        progress: Tell | None,
    ) -> None:
        self.request, self.postures, self.start = request, postures, tuple(start)
        self.candidates = candidates
        seen_in = request.seen_in
        self.last = AlternatingSearch(
            whole, postures, candidates, seen_in=seen_in, where="all patches", prove=True, progress=progress
        )
        self.first = (
            self.last
            if drawn.table is whole.table
            else AlternatingSearch(
                drawn,
                postures,
                candidates,
                seen_in=seen_in,
                where="drawn patches",
                prove=False,
                progress=progress,
            )
        )
        self.on_all_patches = self.first is self.last or position_counts_fit(
            whole, candidates, seen_in=seen_in
        )
        self.starts = 1
        self._drawn: dict[int, Solution] = {}

    def choice(self) -> PostureChoice:
        if self.request.target is None:
            now = self._on_all(self._of_drawn(self.request.count))
        else:
            now = self._fewest(self.request.target)
        one = replace(self.request, count=max(1, len(now.cover.steps)), target=None)
        stood = self.first.cover(self.start, None, one)
        cover = now.cover
        if self.request.target is not None:
            cover = replace(cover, min_size=cover.fewest(self.request.target))
        return PostureChoice(
            postures=tuple(self.postures[i] for i in cover.chosen),
            cover=cover,
            lights=now.lights,
            panels=now.panels,
            exact=now.exact,
            iterations=now.iterations,
            starts=self.starts,
            initial=InitialLights(share=stood.share, postures=len(stood.steps), panels=self.start),
            on_all_patches=self.on_all_patches,
            converged=now.converged,
            position_counts=self.last.position_counts(cover.chosen),
        )

    def _fewest(self, target: float) -> Solution:
        # how many it takes about, then the fewest whose choice by number reaches the target on all patches
        rough = self._from_all_starts(self.request)
        most = self.request.count or len(self.postures)
        enough = count = len(rough.cover.steps) if rough.cover.share >= target else most
        if rough.cover.share < target and self.request.count is None:
            # drawn patches may show less than all do: those decide
            now = self._on_all(rough)
            if self.first is self.last or now.cover.all_covered < target * now.cover.total:
                return now
            enough = count = max(1, len(rough.cover.steps))
        while count > 1 and self._of_drawn(count - 1).cover.share >= target - DRAWN_MARGIN:
            count -= 1
        hopeless = 0
        while True:
            now = self._on_all(self._of_drawn(count))
            if now.cover.share < target and len(now.cover.steps) < count:
                # more than these add nothing on drawn patches, and may on all
                now = self._on_all(self._of_drawn(count), count)
            short = now.cover.share < target and len(now.cover.steps) == count < most
            # with so many, not even all postures under these lights; those of the next number may show more
            hopeless += count >= enough and now.cover.all_covered < target * now.cover.total
            if not short or hopeless > 1:
                return now
            count += 1

    def _of_drawn(self, count: int | None) -> Solution:
        # the best of so many postures on drawn patches
        assert count is not None
        if count not in self._drawn:
            self._drawn[count] = self._from_all_starts(replace(self.request, count=count, target=None))
        return self._drawn[count]

    def _on_all(self, now: Solution, count: int | None = None) -> Solution:
        # carried on on all patches, where the number is what was chosen, or more, not the target
        if self.first is self.last:
            return now
        request = replace(self.request, count=count or max(1, len(now.cover.steps)), target=None)
        cover = self.last.cover(now.panels, now.lights, request, before=now.cover.chosen)
        now = replace(now, cover=cover, converged=self.candidates is None)
        return self.last.improve(now, MOST_LAST_TURNS, request) if self.on_all_patches else now

    def _from_all_starts(self, request: PostureRequest) -> Solution:
        best: Solution | None = None
        starts = self._starts(request)
        self.starts = len(starts)
        for lights in starts:
            panels = self.start if lights is None else self.first.panels(lights)
            now = self.first.improve(self.first.solution_for(panels, lights, request), MOST_TURNS, request)
            if best is None or merit(now.cover, request) > merit(best.cover, request):
                best = now
        assert best is not None
        return best

    def _starts(self, request: PostureRequest) -> tuple[tuple[int, ...] | None, ...]:
        # as they stand; where they serve the best single posture; all at the lower, all at the upper ends
        if self.candidates is None:
            return (None,)
        one = self.first.cover(self.start, None, replace(request, count=1, target=None))
        space = self.candidates.space
        ends = (
            first_allowed(space, space.groups[0]),
            first_allowed(space, [rows[::-1] for rows in space.groups[-1]]),
        )
        alone = [self.first.lights(one.chosen, request).candidates] if one.chosen else []
        return tuple(dict.fromkeys([None, *alone, *(tuple(end) for end in ends if end is not None)]))
