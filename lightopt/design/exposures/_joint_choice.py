"""Postures, lights and exposures together, where exposures are offered.

Two plans are made, one with postures and lights as they would be chosen without the offer, one with those chosen for
what the images show with any of the exposures; to either the exposures are added that pay (:mod:`._exposures`). Of the
two the one is kept that reaches the target with fewer postures, and then the one that shows more, after taking off the
least gain for each further exposure. Each exposure of the first plan adds as much as that at least: so what is kept
shows no less than the plan without the offer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from lightopt.core.transforms import Posture
from lightopt.design._plan_progress import Tell, of_stage, prefixed
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.exposures._brackets import Brackets
from lightopt.design.exposures._exposures import plan_exposures
from lightopt.design.postures._best_set import best_set
from lightopt.design.postures._choice import Choice, Wanted
from lightopt.design.postures._choose import choose_postures
from lightopt.design.postures._common_lights import best_places, holds_places
from lightopt.design.postures._counts import Counts
from lightopt.design.postures._cover import Cover, steps_of
from lightopt.design.postures._greedy_cover import greedy_cover, greedy_order
from lightopt.design.postures._pair_visibility import Survey
from lightopt.scene import PanelLight

MOST_PLACINGS = 2
"""Of the lights for the images as they are planned, at the end."""


def choose_with_exposures(
    whole: Survey,
    drawn: Survey,
    postures: Sequence[Posture],
    start: Sequence[PanelLight],
    candidates: Candidates | None,
    wanted: Wanted,
    *,
    offered: Sequence[float],
    gain_points: float,
    tell: Tell | None = None,
) -> tuple[Choice, Brackets | None]:
    """Choose postures and lights, and which further exposures are planned; figures are of the planned images.

    Parameters
    ----------
    whole, drawn, postures, start, candidates, wanted, tell
        As for :func:`lightopt.design.choose_postures`; surveys of exposure 1.
    offered
        Exposures, 1 among them; with no other the choice is that of exposure 1, and there are no brackets.
    gain_points
        What a further exposure has to add [hundredths of the pairs].

    Returns
    -------
    choice, brackets
        Of the images that are planned; bounds and all candidates' share hold for any of the exposures. Where a target
        cannot be reached, what was chosen for all exposures, and no brackets.

    Raises
    ------
    InputError
        As :func:`lightopt.design.choose_postures` and :func:`lightopt.design.plan_exposures`.
    """
    levels = tuple(dict.fromkeys((1.0, *offered)))
    if len(levels) == 1:
        return choose_postures(whole, drawn, postures, start, candidates, wanted, tell=tell), None

    def chosen_on(every: Survey, some: Survey, stage: str) -> Choice:
        choice = choose_postures(every, some, postures, start, candidates, wanted, tell=prefixed(tell, stage))
        # what the lights' positions show was counted for other images than those that will be planned
        return replace(choice, places=None)

    alone = chosen_on(whole, drawn, "exposure 1")
    every, some = (replace(survey, exposures=levels) for survey in (whole, drawn))
    together = chosen_on(every, some, "all exposures")
    both = [one for one in (alone, together) if wanted.target is None or one.cover.share >= wanted.target]
    if not any(one.postures for one in both):
        return together, None
    offer = _Offer(
        whole=every, candidates=candidates, wanted=wanted, least_gain=gain_points / 100.0, tell=tell
    )
    best = offer.placed(max((offer.planned(one) for one in both if one.postures), key=offer.merit))
    cover = offer.cover(best, postures)
    chosen = tuple(postures[step.candidate] for step in cover.steps)
    return replace(best.choice, postures=chosen, cover=cover, stood=alone.stood), best.brackets


@dataclass(frozen=True, kw_only=True)
class _Plan:
    """Postures and lights, and their exposures."""

    choice: Choice
    brackets: Brackets


@dataclass(frozen=True, eq=False, kw_only=True)
class _Offer:
    """What there is to choose from: the survey's exposures, positions of the lights."""

    whole: Survey
    candidates: Candidates | None
    wanted: Wanted
    least_gain: float
    tell: Tell | None

    def planned(self, choice: Choice) -> _Plan:
        """A choice with the exposures that pay."""
        brackets = plan_exposures(
            self.whole,
            choice.postures,
            [choice.panels] * len(choice.postures),
            self.whole.exposures,
            least=self.wanted.least,
            gain_points=100.0 * self.least_gain,
            target=self.wanted.target,
            tell=of_stage(self.tell, "exposures"),
        )
        return _Plan(choice=choice, brackets=brackets)

    def merit(self, plan: _Plan) -> tuple[float, ...]:
        """What makes one plan better than another; see the module's text."""
        further = sum(shot.planned for shot in plan.brackets.shots)
        count = 0 if self.wanted.target is None else -len(plan.choice.postures)
        return count, plan.brackets.after - self.least_gain * further, -further

    def placed(self, now: _Plan) -> _Plan:
        """The lights where they serve the planned images best, and the exposures that pay there."""
        if self.candidates is None:
            return now
        unsettled = _Plan(choice=replace(now.choice, settled=False), brackets=now.brackets)
        if not holds_places(self.whole, self.candidates, least=self.wanted.least):
            return unsettled
        for _ in range(MOST_PLACINGS):
            choice = now.choice
            places, _ = best_places(
                self.whole,
                [(posture, now.brackets.of(posture)) for posture in choice.postures],
                self.candidates,
                least=self.wanted.least,
                limit=self.wanted.limit,
                tell=of_stage(self.tell, "lights for the planned images"),
            )
            choice = replace(
                choice, settled=places.reached <= self._reached(now), exact=choice.exact and places.exact
            )
            if choice.settled:
                return _Plan(choice=choice, brackets=now.brackets)
            panels = self.candidates.panels_at(places.candidates)
            better = self.planned(
                replace(choice, lights=places.candidates, panels=panels, turns=choice.turns + 1)
            )
            if self.merit(better) <= self.merit(now):
                return _Plan(choice=choice, brackets=now.brackets)
            now = better
        return now

    def cover(self, plan: _Plan, postures: Sequence[Posture]) -> Cover:
        """What the planned images show, posture by posture; bounds are of all postures at any of the exposures."""
        choice, weights = plan.choice, self.whole.weights
        indices = [postures.index(posture) for posture in choice.postures]
        every = [self._counts(choice, posture, self.whole.exposures) for posture in postures]
        free = greedy_cover(every, weights, count=len(indices))
        own = {i: self._counts(choice, postures[i], plan.brackets.of(postures[i])) for i in sorted(indices)}
        cover = replace(
            free,
            steps=steps_of([(i, own[i]) for i in greedy_order(own, weights)], weights),
            dropped=choice.cover.dropped,
            # where fewer show all there is, no more can
            bounds=(*free.bounds, *([free.all_worth] * (len(indices) - len(free.steps)))),
        )
        target = self.wanted.target
        if target is not None:
            return replace(cover, least=cover.fewest(target))
        _, most, sets = best_set(every, weights, free.chosen, len(indices), threads=self.whole.threads)
        return cover.searched(most, sets)

    def _counts(self, choice: Choice, posture: Posture, exposures: tuple[float, ...]) -> Counts:
        survey = replace(self.whole, exposures=exposures)
        return survey.counts(posture, choice.panels, least=self.wanted.least)

    def _reached(self, plan: _Plan) -> int:
        return round(plan.brackets.after * max(1, self.whole.weights.total))
