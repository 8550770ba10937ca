"""Few postures and one set of light positions that show most of the surface together.

The lights are mounted once and stand the same in all postures. Postures and lights depend on each other, so they take
turns: postures by greedy cover for the lights as they are, then the lights by trying every combination for those
postures, and so on until nothing is gained. That is done on patches drawn from all; the last choice of postures, its
gains and its bound are of all patches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lightopt.errors import InputError
from lightopt.optimize import Candidates
from lightopt.plan._combinations import Places, place_lights
from lightopt.plan._counts import Counts, added, counts_of_images, no_counts
from lightopt.plan._cover import Cover, greedy_cover
from lightopt.plan._survey import Survey
from lightopt.scene import PanelLight
from lightopt.transforms import Posture

__all__ = ["MOST_COUNT_BYTES", "Choice", "Wanted", "choose_postures"]

MOST_COUNT_BYTES = 1_500_000_000
"""Of the counts of all candidate postures that are held at a time."""

MOST_TURNS = 6

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
    """

    least: int = 1
    count: int | None = None
    target: float | None = None


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
    """

    postures: tuple[Posture, ...]
    cover: Cover
    lights: tuple[int, ...] | None
    panels: tuple[PanelLight, ...]
    exact: bool
    turns: int
    before: float


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
    search = _Turns(drawn, postures, candidates, wanted, tell)
    panels, lights = tuple(start), None
    cover = search.postures_for(panels, None, "postures for the lights as they stand")
    before, exact, turns = cover.share, True, 0
    while candidates is not None and turns < MOST_TURNS:
        turns += 1
        places = search.lights_for(cover.chosen, f"lights, turn {turns}")
        exact = exact and places.exact
        moved = tuple(candidates.panels[i][k] for i, k in enumerate(places.candidates))
        better = search.postures_for(moved, cover.chosen, f"postures, turn {turns}")
        gained = _merit(better, wanted) > _merit(cover, wanted)
        # positions of the grid are taken before the lights as they stand where they serve as well
        if not gained and (lights is not None or _merit(better, wanted) < _merit(cover, wanted)):
            break
        panels, lights, cover = moved, places.candidates, better
    final = _Turns(whole, postures, candidates, wanted, tell)
    cover = final.postures_for(panels, cover.chosen, "all patches")
    return Choice(
        postures=tuple(postures[i] for i in cover.chosen),
        cover=cover,
        lights=lights,
        panels=panels,
        exact=exact,
        turns=turns,
        before=before,
    )


def _merit(cover: Cover, wanted: Wanted) -> tuple[float, ...]:
    # reaching the target with few first; without one, more seen
    if wanted.target is not None and cover.share >= wanted.target:
        return (1.0, -len(cover.steps), cover.reached, cover.worth)
    return (0.0, cover.reached, cover.worth)


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
        found = place_lights(totals, self.weights, self.candidates.space, threads=self.survey.threads)
        self._say(stage, 1.0)
        return found

    def _say(self, stage: str, share: float) -> None:
        if self._tell is not None:
            self._tell(stage, share)
