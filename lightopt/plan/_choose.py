"""Few postures and one set of light positions that show most of the surface together.

The lights are mounted once and stand the same in all postures. Postures and lights depend on each other, so they take
turns: postures by greedy cover for the lights as they are, then the lights by trying every combination for those
postures, and so on until nothing is gained. The first turns are taken on patches drawn from all, and where these gain
nothing any more, on all patches; so are gains and bound of the last choice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.errors import InputError
from lightopt.optimize import DEFAULT_LIMIT, Candidates
from lightopt.plan._combinations import Places, place_lights
from lightopt.plan._counts import Counts, added, counts_of_images, no_counts
from lightopt.plan._cover import Cover, greedy_cover
from lightopt.plan._survey import Survey
from lightopt.scene import PanelLight
from lightopt.transforms import Posture

__all__ = ["MOST_COUNT_BYTES", "Choice", "Wanted", "choose_postures"]

MOST_COUNT_BYTES = 1_500_000_000
"""Of the counts of all candidate postures, and of all positions of the lights, that are held at a time."""

MOST_TURNS, MOST_LAST_TURNS = 6, 3
"""On drawn patches and on all."""

Tell = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What is asked of the postures.

    Attributes
    ----------
    least
        Images that must show a pair, of all postures together.
    count
        Most postures; as many as the target takes where None.
    target
        Share of the pairs to be shown.
    limit
        Most combinations of the lights' positions that are tried; with more, lights are moved one at a time.
    """

    least: int = 1
    count: int | None = None
    target: float | None = None
    limit: int = DEFAULT_LIMIT


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The postures and lights that were chosen.

    Attributes
    ----------
    postures
        In the order in which they were chosen.
    cover
        Their gains and bound, over all patches and candidate postures, with these lights.
    lights
        Where the lights stand: candidate of each; None where they stay as the rig has them.
    panels
        The lights there, world frame.
    exact
        Whether every combination of the lights was tried for the postures of each turn.
    turns
        How often the lights were placed.
    before
        Share that the candidate postures chosen for the rig's lights as they stood show; of the drawn patches.
    on_all
        Whether the last turns were taken on all patches; not where memory is not meant for so many positions.
    settled
        Whether no combination of the positions that were tried last shows more of all patches in these postures.
    """

    postures: tuple[Posture, ...]
    cover: Cover
    lights: tuple[int, ...] | None
    panels: tuple[PanelLight, ...]
    exact: bool
    turns: int
    before: float
    on_all: bool
    settled: bool


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
        All patches, and those that the turns are taken on; both of all postures.
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
    last = _Turns(whole, postures, candidates, wanted, tell)
    first = last if drawn.table is whole.table else _Turns(drawn, postures, candidates, wanted, tell)
    panels = tuple(start)
    cover = first.postures_for(panels, None, "postures for the lights as they stand")
    before = cover.share
    now = first.settled(
        _State(panels=panels, cover=cover), MOST_TURNS, "all patches" if first is last else "drawn patches"
    )
    on_all = first is last or last.holds_places
    if first is not last:
        now = replace(
            now,
            cover=last.postures_for(now.panels, now.cover.chosen, "postures, all patches"),
            settled=candidates is None,
        )
        if on_all:
            now = last.settled(now, MOST_LAST_TURNS, "all patches")
    return Choice(
        postures=tuple(postures[i] for i in now.cover.chosen),
        cover=now.cover,
        lights=now.lights,
        panels=now.panels,
        exact=now.exact,
        turns=now.turns,
        before=before,
        on_all=on_all,
        settled=now.settled,
    )


def _merit(cover: Cover, wanted: Wanted) -> tuple[float, ...]:
    # reaching the target with few first; without one, more seen
    if wanted.target is not None and cover.share >= wanted.target:
        return (1.0, -len(cover.steps), cover.reached, cover.worth)
    return (0.0, cover.reached, cover.worth)


@dataclass(frozen=True, kw_only=True)
class _State:
    """Lights, and the postures chosen for them; where they stand among the candidates, None as they stood."""

    panels: tuple[PanelLight, ...]
    cover: Cover
    lights: tuple[int, ...] | None = None
    exact: bool = True
    turns: int = 0
    settled: bool = True


class _Turns:
    def __init__(
        self,
        survey: Survey,
        postures: Sequence[Posture],
        candidates: Candidates | None,
        wanted: Wanted,
        tell: Tell | None,
    ) -> None:
        self.survey, self.postures, self.candidates, self.wanted = survey, postures, candidates, wanted
        self.weights = survey.weights
        self._tell = tell

    @property
    def holds_places(self) -> bool:
        """Whether there is room for the counts of all positions of the lights."""
        places = 0 if self.candidates is None else sum(len(some) for some in self.candidates.panels)
        pairs = len(self.survey.patches) * self.weights.masks.shape[1]
        # those of a posture's images beside the sums
        return places * (self.wanted.least + 1) * pairs * 8 <= MOST_COUNT_BYTES

    def settled(self, now: _State, most: int, where: str) -> _State:
        """Lights for the postures, and postures for the lights, until nothing is gained or after so many turns."""
        if self.candidates is None:
            return now
        for turn in range(1, most + 1):
            places = self.lights_for(now.cover.chosen, f"lights, turn {turn}, {where}")
            now = replace(
                now,
                exact=now.exact and places.exact,
                turns=now.turns + 1,
                settled=places.reached <= now.cover.reached,
            )
            if places.candidates == now.lights:
                return now
            panels = tuple(self.candidates.panels[i][k] for i, k in enumerate(places.candidates))
            better = self.postures_for(panels, now.cover.chosen, f"postures, turn {turn}, {where}")
            gained = _merit(better, self.wanted) > _merit(now.cover, self.wanted)
            # positions of the grid are taken before the lights as they stand where they serve as well
            as_good = _merit(better, self.wanted) == _merit(now.cover, self.wanted)
            if not gained and not (as_good and now.lights is None):
                return now
            now = replace(now, panels=panels, cover=better, lights=places.candidates, settled=False)
        return now

    def postures_for(self, panels: Sequence[PanelLight], among: Sequence[int] | None, stage: str) -> Cover:
        """The cover for lights: the greedy one of all postures, or of those of the last turn where that is better."""
        counts: list[Counts] = []
        for i, posture in enumerate(self.postures):
            images = self.survey.flags(posture, [[panel] for panel in panels])
            counts.append(counts_of_images([layer[0] for layer in images], self.wanted.least))
            self._say(stage, (i + 1) / len(self.postures))
        free = greedy_cover(counts, self.weights, count=self.wanted.count, target=self.wanted.target)
        if not among:
            return free
        kept = greedy_cover(
            counts, self.weights, count=self.wanted.count, target=self.wanted.target, among=among
        )
        return kept if _merit(kept, self.wanted) > _merit(free, self.wanted) else free

    def lights_for(self, chosen: Sequence[int], stage: str) -> Places:
        """The best positions of the lights for postures."""
        assert self.candidates is not None
        k = self.wanted.least
        empty = no_counts(self.weights, k)
        totals = [np.repeat(empty[None], len(some), axis=0) for some in self.candidates.panels]
        for done, i in enumerate(chosen):
            images = self.survey.flags(self.postures[i], self.candidates.panels)
            for total, layer in zip(totals, images, strict=True):
                for place, flags in enumerate(layer):
                    total[place] = added(total[place], counts_of_images([flags], k))
            self._say(stage, (done + 1) / (len(chosen) + 1))
        before = len(chosen) / (len(chosen) + 1)
        return place_lights(
            totals,
            self.weights,
            self.candidates.space,
            limit=self.wanted.limit,
            threads=self.survey.threads,
            progress=lambda share: self._say(stage, before + (1.0 - before) * share),
        )

    def _say(self, stage: str, share: float) -> None:
        if self._tell is not None:
            self._tell(stage, share)
