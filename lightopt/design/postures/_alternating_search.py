"""Postures and lights that take turns, until neither shows more for the other.

The lights are placed for the postures by trying every combination of their positions, the postures are chosen for the
lights by greedy cover and exchanges. No turn shows less than the one before, so that they come to an end: a local
optimum, which depends on where it began.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from lightopt.core.transforms import Posture
from lightopt.design._plan_progress import Tell
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.postures._best_set import best_set
from lightopt.design.postures._choice import Wanted
from lightopt.design.postures._combinations import PlaceCounts
from lightopt.design.postures._common_lights import best_places
from lightopt.design.postures._counts import Counts
from lightopt.design.postures._cover import Cover
from lightopt.design.postures._exchange import exchanged
from lightopt.design.postures._greedy_cover import greedy_cover
from lightopt.design.postures._light_positions import Places
from lightopt.design.postures._pair_visibility import Survey
from lightopt.scene import PanelLight

KEPT_BYTES = 400_000_000
"""Of the counts that are kept for lights to which turns may come back, and of those of all places of the last turn."""

Lights = tuple[int, ...] | None
"""Candidate of each light; None where they stand as the rig has them."""


@dataclass(frozen=True, kw_only=True)
class State:
    """Lights, and the postures chosen for them.

    Attributes
    ----------
    panels, lights
        Where the lights stand, world frame, and which of their candidates that is.
    cover
        Postures.
    exact
        Whether every combination of the lights was tried at every turn.
    turns
        How often the lights were placed.
    settled
        Whether the last of these found no positions that show more in these postures.
    """

    panels: tuple[PanelLight, ...]
    cover: Cover
    lights: Lights = None
    exact: bool = True
    turns: int = 0
    settled: bool = True


def merit(cover: Cover, wanted: Wanted) -> tuple[float, ...]:
    """What makes one cover better than another: reaching the target with few first; without one, more seen."""
    if wanted.target is not None and cover.share >= wanted.target:
        return (1.0, -len(cover.steps), cover.reached, cover.worth)
    return (0.0, cover.reached, cover.worth)


class Turns:
    """Turns on the patches of a survey; what was worked out for lights or postures is not worked out again.

    Parameters
    ----------
    survey
        The part, its images taken with the survey's exposures.
    postures
        To choose from.
    candidates
        Positions of the lights to choose from; None where no light moves.
    least
        Images that must show a pair, of all postures together.
    where
        The patches, for people.
    prove
        Whether all sets of postures are gone through where that is little work.
    tell
        Called with what is going on and the share of that which is done.
    """

    def __init__(
        self,
        survey: Survey,
        postures: Sequence[Posture],
        candidates: Candidates | None,
        *,
        least: int,
        where: str,
        prove: bool,
        tell: Tell | None,
    ) -> None:
        self.prove = prove
        self.survey, self.postures, self.candidates, self.least = survey, postures, candidates, least
        self._where, self._tell, self._passes = where, tell, 0
        self._counts: dict[Lights, list[Counts]] = {}
        self._places: dict[tuple[int, ...], Places] = {}
        self._placed: tuple[tuple[int, ...], list[PlaceCounts]] | None = None

    def panels(self, lights: Sequence[int]) -> tuple[PanelLight, ...]:
        """The lights at these of their candidates."""
        assert self.candidates is not None
        return self.candidates.panels_at(lights)

    def begin(self, panels: Sequence[PanelLight], lights: Lights, wanted: Wanted) -> State:
        """The postures for lights."""
        return State(
            panels=tuple(panels), lights=lights, cover=self.cover(panels, lights, wanted), settled=False
        )

    def settled(self, now: State, most: int, wanted: Wanted) -> State:
        """Lights for the postures, and postures for the lights, until nothing is gained or after so many turns."""
        if self.candidates is None:
            return replace(now, settled=True)
        for _ in range(most):
            places = self.lights(now.cover.chosen, wanted)
            now = replace(
                now,
                exact=now.exact and places.exact,
                turns=now.turns + 1,
                settled=places.reached <= now.cover.reached,
            )
            if places.candidates == now.lights:
                return now
            panels = self.panels(places.candidates)
            better = self.cover(panels, places.candidates, wanted, before=now.cover.chosen)
            gained = merit(better, wanted) > merit(now.cover, wanted)
            # positions of the grid are taken before the lights as they stand where they serve as well
            as_good = merit(better, wanted) == merit(now.cover, wanted)
            if not gained and not (as_good and now.lights is None):
                return now
            now = replace(now, panels=panels, cover=better, lights=places.candidates, settled=False)
        return now

    def cover(
        self, panels: Sequence[PanelLight], lights: Lights, wanted: Wanted, before: Sequence[int] = ()
    ) -> Cover:
        """Postures for lights: a greedy choice and those of the turn before, both bettered by exchanges.

        On all patches, the best of all sets of as many, where that takes no more work than is meant for it.
        """
        counts, weights = self._seen(panels, lights), self.survey.weights
        greedy = partial(greedy_cover, counts, weights, count=wanted.count, target=wanted.target)
        covers = [greedy()]
        sets = [covers[0].chosen, tuple(before)]
        if wanted.target is None:
            sets = [exchanged(counts, weights, some, threads=self.survey.threads) for some in sets]
        covers += [greedy(among=some) for some in sets if some and some != covers[0].chosen]
        best = max(covers, key=lambda cover: merit(cover, wanted))
        if self.prove and wanted.target is None and wanted.count is not None:
            size = min(wanted.count, len(counts))
            chosen, most, sets = best_set(counts, weights, best.chosen, size, threads=self.survey.threads)
            if chosen != best.chosen:
                covers.append(greedy(among=chosen))
                best = covers[-1]
            best = best.searched(most, sets)
        same = [cover.bounds for cover in covers if len(cover.bounds) == len(best.bounds)]
        return replace(best, bounds=tuple(min(some) for some in zip(*same, strict=True)))

    def lights(self, chosen: Sequence[int], wanted: Wanted) -> Places:
        """The best positions of the lights for postures."""
        assert self.candidates is not None
        key = tuple(sorted(chosen))
        if key not in self._places:
            self._passes += 1
            self._places[key], counts = best_places(
                self.survey,
                [(self.postures[i], self.survey.exposures) for i in key],
                self.candidates,
                least=self.least,
                limit=wanted.limit,
                tell=lambda share: self._say("lights for postures", share),
            )
            small = sum(some.nbytes for some in counts) <= KEPT_BYTES
            self._placed = (key, counts) if small else None
        return self._places[key]

    def placed(self, chosen: Sequence[int]) -> tuple[PlaceCounts, ...] | None:
        """What each position of each light shows in postures, where the lights were placed for these last."""
        if self._placed is None or self._placed[0] != tuple(sorted(chosen)):
            return None
        return tuple(self._placed[1])

    def _seen(self, panels: Sequence[PanelLight], lights: Lights) -> list[Counts]:
        # what every posture shows under these lights, once for as many as there is room for
        if lights not in self._counts:
            counts: list[Counts] = []
            self._passes += 1
            for i, posture in enumerate(self.postures):
                counts.append(self.survey.counts(posture, panels, least=self.least))
                self._say("postures for lights", (i + 1) / len(self.postures))
            size = sum(some.nbytes for some in counts)
            while self._counts and (len(self._counts) + 1) * size > KEPT_BYTES:
                del self._counts[next(iter(self._counts))]
            self._counts[lights] = counts
        return self._counts[lights]

    def _say(self, stage: str, share: float) -> None:
        if self._tell is not None:
            self._tell(f"{stage}, {self._where}, pass {self._passes}", share)
