"""Few postures and one set of light positions that show most of the surface together.

The lights are mounted once and stand the same in all postures. Postures and lights depend on each other, so they take
turns (:mod:`lightopt.design.postures._alternating_search`), which end in a local optimum. They begin at several
places, the lights as they stand, where they serve one posture best, and at both ends of their ranges, on patches
drawn from all; the best of what they come to is carried on on all patches, and so are gains and bound of the choice.

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
from lightopt.design.postures._alternating_search import State, Turns, merit
from lightopt.design.postures._choice import Choice, Stood, Wanted
from lightopt.design.postures._common_lights import MOST_COUNT_BYTES, holds_places
from lightopt.design.postures._light_positions import first_allowed
from lightopt.design.postures._pair_visibility import Survey
from lightopt.scene import PanelLight

MOST_TURNS, MOST_LAST_TURNS = 6, 3
"""On drawn patches and on all."""

DRAWN_MARGIN = 0.01
"""Share by which what drawn patches show may fall short of a target and still be tried on all."""


def choose_postures(
    whole: Survey,
    drawn: Survey,
    postures: Sequence[Posture],
    start: Sequence[PanelLight],
    candidates: Candidates | None,
    wanted: Wanted,
    *,
    tell: Tell | None = None,
) -> Choice:
    """Choose postures and light positions.

    Parameters
    ----------
    whole, drawn
        All patches, and those that the first turns are taken on; both of all postures.
    postures
        To choose from, at least one.
    start
        The lights as they stand, world frame.
    candidates
        Positions to choose from; None where no light moves.
    wanted
        How much is to be seen, by how many.
    tell
        Called with what is going on and the share of that which is done.

    Raises
    ------
    InputError
        More postures than memory is meant for; lights that collide in every combination.
    """
    size = len(postures) * wanted.least * len(whole.patches) * whole.weights.masks.shape[1] * 8
    if size > MOST_COUNT_BYTES:
        raise InputError(
            f"{len(postures)} postures × {len(whole.patches):,} patches are {size / 1e9:.2f} GB of counts, and there "
            f"is room for {MOST_COUNT_BYTES / 1e9:.2f} GB; take a larger --posture-step or fewer --patches"
        )
    return _Chooser(whole, drawn, postures, start, candidates, wanted, tell).choice()


class _Chooser:
    def __init__(
        self,
        whole: Survey,
        drawn: Survey,
        postures: Sequence[Posture],
        start: Sequence[PanelLight],
        candidates: Candidates | None,
        wanted: Wanted,
        tell: Tell | None,
    ) -> None:
        self.wanted, self.postures, self.start = wanted, postures, tuple(start)
        self.candidates = candidates
        least = wanted.least
        self.last = Turns(
            whole, postures, candidates, least=least, where="all patches", prove=True, tell=tell
        )
        self.first = (
            self.last
            if drawn.table is whole.table
            else Turns(
                drawn, postures, candidates, least=least, where="drawn patches", prove=False, tell=tell
            )
        )
        self.on_all = self.first is self.last or holds_places(whole, candidates, least=least)
        self.starts = 1
        self._drawn: dict[int, State] = {}

    def choice(self) -> Choice:
        if self.wanted.target is None:
            now = self._on_all(self._of_drawn(self.wanted.count))
        else:
            now = self._fewest(self.wanted.target)
        one = replace(self.wanted, count=max(1, len(now.cover.steps)), target=None)
        stood = self.first.cover(self.start, None, one)
        cover = now.cover
        if self.wanted.target is not None:
            cover = replace(cover, least=cover.fewest(self.wanted.target))
        return Choice(
            postures=tuple(self.postures[i] for i in cover.chosen),
            cover=cover,
            lights=now.lights,
            panels=now.panels,
            exact=now.exact,
            turns=now.turns,
            starts=self.starts,
            stood=Stood(share=stood.share, postures=len(stood.steps), panels=self.start),
            on_all=self.on_all,
            settled=now.settled,
            places=self.last.placed(cover.chosen),
        )

    def _fewest(self, target: float) -> State:
        # how many it takes about, then the fewest whose choice by number reaches the target on all patches
        rough = self._from_all_starts(self.wanted)
        most = self.wanted.count or len(self.postures)
        enough = count = len(rough.cover.steps) if rough.cover.share >= target else most
        if rough.cover.share < target and self.wanted.count is None:
            # drawn patches may show less than all do: those decide
            now = self._on_all(rough)
            if self.first is self.last or now.cover.all_reached < target * now.cover.total:
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
            hopeless += count >= enough and now.cover.all_reached < target * now.cover.total
            if not short or hopeless > 1:
                return now
            count += 1

    def _of_drawn(self, count: int | None) -> State:
        # the best of so many postures on drawn patches
        assert count is not None
        if count not in self._drawn:
            self._drawn[count] = self._from_all_starts(replace(self.wanted, count=count, target=None))
        return self._drawn[count]

    def _on_all(self, now: State, count: int | None = None) -> State:
        # carried on on all patches, where the number is what was chosen, or more, not the target
        if self.first is self.last:
            return now
        wanted = replace(self.wanted, count=count or max(1, len(now.cover.steps)), target=None)
        cover = self.last.cover(now.panels, now.lights, wanted, before=now.cover.chosen)
        now = replace(now, cover=cover, settled=self.candidates is None)
        return self.last.settled(now, MOST_LAST_TURNS, wanted) if self.on_all else now

    def _from_all_starts(self, wanted: Wanted) -> State:
        best: State | None = None
        starts = self._starts(wanted)
        self.starts = len(starts)
        for lights in starts:
            panels = self.start if lights is None else self.first.panels(lights)
            now = self.first.settled(self.first.begin(panels, lights, wanted), MOST_TURNS, wanted)
            if best is None or merit(now.cover, wanted) > merit(best.cover, wanted):
                best = now
        assert best is not None
        return best

    def _starts(self, wanted: Wanted) -> tuple[tuple[int, ...] | None, ...]:
        # as they stand; where they serve the best single posture; all at the lower, all at the upper ends
        if self.candidates is None:
            return (None,)
        one = self.first.cover(self.start, None, replace(wanted, count=1, target=None))
        space = self.candidates.space
        ends = (
            first_allowed(space, space.groups[0]),
            first_allowed(space, [rows[::-1] for rows in space.groups[-1]]),
        )
        alone = [self.first.lights(one.chosen, wanted).candidates] if one.chosen else []
        return tuple(dict.fromkeys([None, *alone, *(tuple(end) for end in ends if end is not None)]))
