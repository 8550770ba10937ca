"""Choose the postures of a plan, or report why a target is not reached; then score the plan by all of its images.

Postures, lights and exposures are chosen together. Two plans are made, one with postures and lights as chosen for
exposure 1 alone, one with those chosen for what the images show with any of the exposures; to either the exposures with
enough gain are added (:mod:`._exposures`). The plan is kept that reaches the target with fewer postures, and then the
one that shows more, after deducting the least gain for each further exposure. Each exposure of the first plan adds as
much as that at least: so what is kept shows no less than the plan without further exposures.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import CheckFailed, counted, percent
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.design import _blind_spots, _problem
from lightopt.design._candidates import Candidates, Curve, place_of, score_curves
from lightopt.design._result import SHARES_OF, ChosenPostures, ObjectiveResult, SetResult, places_of, way_through
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.objectives._objective import share_text
from lightopt.design.postures._cover_search import Cover, best_set, cover_steps, greedy_cover, greedy_order
from lightopt.design.postures._exposures import plan_exposures
from lightopt.design.postures._light_positions import (
    best_positions,
    bound_between,
    excess_of_counts,
    position_counts,
    position_counts_fit,
)
from lightopt.design.postures._posture_search import CACHED_BYTES, PostureChoice, PostureRequest, choose_postures
from lightopt.design.responses._image_evaluator import (
    DRAWN_PATCHES,
    ImageCache,
    ImageEvaluator,
    PatchRow,
    drawn_patches,
)
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.design.responses._pairs import Counts, unpack_flags
from lightopt.design.search._between_steps import BetweenSteps, ProbedCells, tested_patches
from lightopt.design.search._exact_search import Ranked
from lightopt.lights import PanelLight
from lightopt.rendering import build_patches, cast_rays_at
from lightopt.scene import build_lights, build_scene, pace_text

MOST_ITERATIONS = 2  # of the lights for the images as they are planned, at the end

# postures × drawn patches of an iteration, at most, and patches that are always drawn
DRAWN_PAIRS, LEAST_DRAWN = 8_000_000, 2_000


def choose_with_exposures(
    whole: ImageEvaluator,
    drawn: ImageEvaluator,
    start: Sequence[PanelLight],
    candidates: Candidates | None,
    request: PostureRequest,
    exposures: Sequence[float],  # 1 among them; with no other the choice is that of exposure 1, without brackets
    gain_points: float,  # what a further exposure has to add [hundredths of the pairs]
    run: RunContext,
) -> PostureChoice:
    """Choose postures and lights, and which further exposures are planned; figures are of the planned images.

    whole, drawn, start, candidates, request, run: As for :func:`choose_postures`; evaluators of exposure 1.
    Returns the choice of the planned images; bounds and all candidates' share hold for any of the exposures. Where a
    target cannot be reached, what was chosen for all exposures, without brackets.
    """
    levels = tuple(dict.fromkeys((1.0, *exposures)))
    if len(levels) == 1:
        return choose_postures(whole, drawn, start, candidates, request, run=run)

    def chosen_on(every: ImageEvaluator, some: ImageEvaluator, stage: str) -> PostureChoice:
        choice = choose_postures(every, some, start, candidates, request, run=run.within(stage))
        return replace(choice, images=None)  # they are of other exposures than those that will be planned

    single = chosen_on(whole, drawn, "exposure 1")
    every, some = (replace(evaluator, exposures=levels) for evaluator in (whole, drawn))
    together = chosen_on(every, some, "all exposures")
    both = [one for one in (single, together) if request.target is None or one.cover.share >= request.target]
    if not any(one.postures for one in both):
        return together
    planner = _JointPlanner(every, candidates, request, gain_points / 100.0, run)
    best = max((planner.add_exposures(one) for one in both if one.postures), key=planner.merit)
    best = planner.place_lights(best)
    cover = planner.cover(best)
    chosen = tuple(whole.table.postures[step.candidate] for step in cover.steps)
    return replace(best, postures=chosen, cover=cover, initial=single.initial)


@dataclass(frozen=True, eq=False)
class _JointPlanner:
    """The evaluator's exposures and the positions of the lights to choose from."""

    whole: ImageEvaluator
    candidates: Candidates | None
    request: PostureRequest
    least_gain: float
    run: RunContext

    def add_exposures(self, choice: PostureChoice) -> PostureChoice:
        panels, progress = [choice.panels] * len(choice.postures), self.run.stage("exposures")
        request = self.whole.exposures, 100.0 * self.least_gain, self.request.target
        return replace(choice, brackets=plan_exposures(self.whole, choice.postures, panels, *request, progress))

    def merit(self, plan: PostureChoice) -> tuple[float, ...]:
        """Sort key of a plan; see the module's text."""
        assert plan.brackets is not None
        further = sum(exposure.reason is not None for exposure in plan.brackets.further)
        count = 0 if self.request.target is None else -len(plan.postures)
        return count, plan.brackets.after - self.least_gain * further, -further

    def place_lights(self, plan: PostureChoice) -> PostureChoice:
        """The lights where they serve the planned images best, and the exposures with enough gain there."""
        if self.candidates is None:
            return plan
        if not position_counts_fit(self.whole, self.candidates):
            return replace(plan, converged=False)
        for _ in range(MOST_ITERATIONS):
            postures = [(posture, plan.exposures_of(posture)) for posture in plan.postures]
            progress, limit = self.run.stage("lights for the planned images"), self.request.limit
            positions = best_positions(self.whole, postures, self.candidates, limit=limit, progress=progress)
            assert plan.brackets is not None
            covered = round(plan.brackets.after * max(1, self.whole.weights.total))
            plan = replace(plan, converged=positions.covered <= covered, exact=plan.exact and positions.exact)
            if plan.converged:
                return plan
            lights, panels = positions.candidates, self.candidates.panels_at(positions.candidates)
            better = self.add_exposures(replace(plan, lights=lights, panels=panels, iterations=plan.iterations + 1))
            if self.merit(better) <= self.merit(plan):
                return plan
            plan = better
        return plan

    def cover(self, plan: PostureChoice) -> Cover:
        """What the planned images show, posture by posture; bounds are of all postures at any of the exposures."""
        weights, postures = self.whole.weights, self.whole.table.postures
        indices = [postures.index(posture) for posture in plan.postures]
        every = self.whole.counts_of_postures(plan.panels, self.run.stage("all postures at all exposures"))
        free = greedy_cover(every, weights, count=len(indices), threads=self.whole.threads)
        own = {i: self._counts(plan, postures[i], plan.exposures_of(postures[i])) for i in sorted(indices)}
        cover = replace(
            free,
            steps=cover_steps([(i, own[i]) for i in greedy_order(own, weights, self.whole.needed)], weights),
            # where fewer postures show everything, more cannot add to it
            bounds=(*free.bounds, *([free.all_benefit] * (len(indices) - len(free.steps)))),
        )
        if self.request.target is not None:
            return replace(cover, target=self.request.target)
        _, most, sets = best_set(every, weights, free.chosen, len(indices), threads=self.whole.threads)
        return cover if sets is None else replace(cover, sets=sets, max_covered=most)

    def _counts(self, plan: PostureChoice, posture: Posture, exposures: tuple[float, ...]) -> Counts:
        return replace(self.whole, exposures=exposures).counts(posture, plan.panels)


# among what the lights of a plan are the best, or not known to be
PROVEN_OF = "positions of the lights in these postures at these exposures; for the postures see chosen_postures"

# among what another objective's lights are the best where its own positions could not be searched
PROVEN_OF_ONE = "the positions that the first objective chose, the only ones that were scored"


def planned_answers(
    result: SetResult,
    chosen: ChosenPostures,
    rig: RigConfig,
    candidates: Candidates,
    free: Candidates | None,
    options: _problem.OptimizeOptions,
    run: RunContext,
) -> SetResult:
    """The best lights of each objective, scored for defects by what they show in the plan's postures and exposures.

    result: Of the chosen postures; the first objective is detectability.
    candidates: Positions of the lights that the result is of.
    free: All positions to choose from: the curves go through them, where the chosen ones are among them; None where
        no light moves.
    """
    first = result.answers[0].objective
    assert isinstance(first, DetectabilityObjective)
    area = int(chosen.evaluator.weights.areas.sum())
    # of all planned images together, as a share of what the camera sees in any candidate posture
    goal = replace(first, share_of=SHARES_OF, area=area)
    answers = tuple(_planned(answer, goal, chosen, candidates, free is not None) for answer in result.answers)
    # the images of all positions are looked at twice; other processes make their own
    images = chosen.choice.images or ImageCache(CACHED_BYTES)
    own = replace(chosen.evaluator, images=images, keeps_images=run.pool is None)
    score = answers[0].found.best.score
    first = replace(answers[0], between=_between_steps(score, chosen, own, rig, free, options, run))
    curves = _curves(first.found.best, chosen, own, candidates, free, run)
    return replace(result, answers=(first, *answers[1:]), curves=curves)


def _between_steps(
    score: int,
    chosen: ChosenPostures,
    evaluator: ImageEvaluator,
    rig: RigConfig,
    free: Candidates | None,
    options: _problem.OptimizeOptions,
    run: RunContext,
) -> BetweenSteps | None:
    # of the lights in the chosen postures, at the exposures that are planned
    choice = chosen.choice
    if free is None or not free.cells.moves or not position_counts_fit(evaluator, free):
        return None
    shots = [(posture, choice.exposures_of(posture)) for posture in chosen.way.order]
    found = bound_between(evaluator, shots, free, limit=options.limit, progress=run.stage("between the steps"))
    if found is None:
        return None
    tested = ProbedCells.around(rig, free, options, choice.lights, found.cells)
    excess = excess_of_counts(tested, tested_patches(evaluator, len(shots)), shots)
    # the lights of the rig file, where they stay, are no candidates
    best = score if choice.lights is not None else min(score, found.score)
    whole = evaluator.weights.total
    between = BetweenSteps.of(found.score, excess, full=whole, best=best, postures=chosen.way.order)
    run.warn(*between.warnings(chosen.way.order))
    return between if between.bound >= score else None


def _curves(
    best: Ranked,
    chosen: ChosenPostures,
    evaluator: ImageEvaluator,
    candidates: Candidates,
    free: Candidates | None,
    run: RunContext,
) -> tuple[Curve, ...]:
    progress, at = run.stage("the score along each angle"), places_of(candidates, best)
    weights = evaluator.weights
    among = free is not None and all(place in some for place, some in zip(at, free.places, strict=True))
    if free is None or not among or not position_counts_fit(evaluator, free):
        return ()
    postures = [(posture, chosen.choice.exposures_of(posture)) for posture in chosen.way.order]
    lights = position_counts(replace(evaluator, pool=run.pool), postures, free, progress)

    def score(combination: tuple[int, ...]) -> int:
        shown = (places[k] for places, k in zip(lights, combination, strict=True))
        return weights.covered(weights.sum_counts(shown, evaluator.needed))

    here = tuple(some.index(place) for place, some in zip(at, free.places, strict=True))
    return score_curves(free, replace(best, candidates=here), score)


def _planned(
    answer: ObjectiveResult, goal: DetectabilityObjective, chosen: ChosenPostures, candidates: Candidates, moves: bool
) -> ObjectiveResult:
    best, choice, evaluator = answer.found.best, chosen.choice, replace(chosen.evaluator, images=chosen.choice.images)
    panels, shots = candidates.panels_at(best.candidates), ((one, choice.exposures_of(one)) for one in chosen.way.order)
    images = (replace(evaluator, exposures=exposures).counts(posture, panels) for posture, exposures in shots)
    counts = evaluator.weights.sum_counts(images, evaluator.needed)
    score = evaluator.weights.covered(counts)
    scores = {**answer.scores, goal.name: score}
    if answer.objective.name != goal.name:
        searched = not moves or any(len(some) > 1 for some in candidates.places)
        return replace(answer, scores=scores, proven_of=None if searched else PROVEN_OF_ONE)
    # where no other positions show more in these postures; else no bound is known but all there is to see
    best_there = choice.exact and choice.converged
    bound = score if best_there else evaluator.weights.total
    seen = evaluator.weights.areas @ unpack_flags(counts[-1], len(goal.defects))
    return replace(
        answer,
        objective=goal,
        found=replace(answer.found, ranking=(replace(best, score=score),), bound=bound),
        scores=scores,
        details=goal.facts(seen, int(evaluator.weights.areas.sum())),
        nothing=None,
        proven_of=PROVEN_OF,
    )


NEAR_SHARE = 0.01  # the message names how many postures come this near to all of them


def target_not_reached(target: float, choice: PostureChoice, evaluator: ImageEvaluator, *, least: int) -> CheckFailed:
    """What `choice`, which falls short of the target, can reach by how many postures, and why no more.

    `evaluator` is of all candidate postures; `least` images must show a pair.
    """
    cover, available = choice.cover, len(evaluator.table.postures)
    text = partial(share_text, grain=evaluator.table.grain, short_of=target)
    shown = ", ".join(
        f"{number}: {text(step.covered / max(1, cover.total))} (at most {text(cover.bound_of(number))})"
        for number, step in enumerate(cover.steps, start=1)
    )
    steps = f"of postures chosen one after the other, all with the same lights: {shown}"
    most = cover.all_covered / max(1, cover.total)
    required = f"{100.0 * target:.9g} %"
    if most >= target:
        return CheckFailed(
            f"option 'target': {counted(len(cover.steps), 'posture')} show {text(cover.share)} of the "
            f"surface × defects, and no {len(cover.steps)} of {available} show more than "
            f"{text(cover.bound_share)} with these lights; {required} are required. "
            "Raise option 'choose_postures' or leave it out",
            steps,
        )
    lost = _lost(choice, evaluator, least)
    # more light helps where there is too little of it
    dim = lost.get(_blind_spots.BlindReason.CONTRAST, 0.0) + lost.get(_blind_spots.BlindReason.SHADOWED, 0.0)
    longer = max(evaluator.exposures) <= 1.0 and dim > 0.5 * sum(lost.values())
    hint = "Longer exposures may show some of it: add them, such as option 'exposures' 1,4,16. " * longer
    lights = "the best lights found (others may show more)" if choice.iterations else "the present light positions"
    near = next(
        (i for i, step in enumerate(cover.steps, 1) if step.covered >= (most - NEAR_SHARE) * cover.total),
        len(cover.steps),
    )
    return CheckFailed(
        f"option 'target': {required} of the surface × defects is not reached: with {lights}, all {available} "
        f"postures together show {text(most)}, and {counted(near, 'posture')} come within "
        f"{100 * NEAR_SHARE:g} point of that. Of the unseen share, {_reasons(lost, choice)}. "
        f"{hint}Lower the target, use option 'choose_postures', or remove these causes",
        steps,
    )


def _lost(choice: PostureChoice, evaluator: ImageEvaluator, least: int) -> dict[int, float]:
    # surface × defects by reason, over all candidate postures, under the chosen lights
    thresholds = LevelThresholds.of_sensor(evaluator.scene.sensor, shade_share=0.0)
    rows = [evaluator.row(posture) for posture in evaluator.table.postures]
    found: dict[int, _blind_spots.DefectVisibility] = {}
    evaluator.spread(_visibility_of_row, rows, found.__setitem__, choice.panels, thresholds, least, threads=1)
    seen = [found[place] for place in range(len(rows))]
    # the shares are of the surface that the camera sees in one of them
    areas = np.zeros(len(evaluator.table.patches))
    areas[evaluator.patches] = evaluator.table.patches.areas[evaluator.patches]
    return _blind_spots.blind_spots(areas, seen).by_reason()


def _visibility_of_row(
    row: PatchRow, evaluator: ImageEvaluator, panels: Sequence[PanelLight], thresholds: LevelThresholds, least: int
) -> _blind_spots.DefectVisibility:
    own = evaluator.of_rows([row])
    matrices = own.matrices(row[0], [[panel] for panel in panels], exposures=own.exposures)
    return _blind_spots.defect_visibility(_blind_spots.by_light(matrices), thresholds, least=least)


def _reasons(lost: Mapping[int, float], choice: PostureChoice) -> str:
    whole = max(sum(lost.values()), 1e-12)
    names = [panel.name for panel in choice.panels]
    ordered = sorted(lost.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(
        f"{percent(share / whole, 0)} {_blind_spots.blind_text(code, names)}" for code, share in ordered if share > 0.0
    )


def _drawn_count(postures: int) -> int:
    """How many patches the first iterations use: fewer where there are many postures, which each iteration tries."""
    return max(LEAST_DRAWN, min(DRAWN_PATCHES, DRAWN_PAIRS // max(1, postures)))


def plan_postures(
    rig: RigConfig, part: PartConfig, options: _problem.OptimizeOptions, plan: _problem.PlanOptions, run: RunContext
) -> ChosenPostures:
    candidates = _problem.candidates_of(rig, options)
    scene = build_scene(rig, part, points=options.points, defects=False, bounces=part.inspection.bounces)
    scene = replace(scene, camera=replace(scene.camera, obstructions=None))
    grid = _problem.posture_grid(rig, part, step_deg=plan.posture_step_deg)
    caster = cast_rays_at(scene)
    lights = build_lights(rig, None, options.points)
    positions = lights if candidates is None else tuple(p for some in candidates.panels for p in some)
    everywhere = replace(scene, postures=grid)
    postures, left_out = _problem.usable_postures(everywhere, positions, allow_outside_px=plan.allow_outside_px)
    few = plan.choose_postures is not None and len(postures) < plan.choose_postures
    shortfall = f", fewer than the {plan.choose_postures} requested" if few else ""
    run.inform(
        f"{counted(len(postures), 'posture')} to choose from{shortfall}, {len(left_out)} left out; patches are cut "
        "for all of them"
    )
    scene = replace(scene, postures=postures)
    threads, pool, budget = run.threads, run.pool, options.patch_budget
    table = build_patches(scene, caster=caster, budget=budget, edges=False, threads=threads, pool=pool)
    detection = _problem.detection_model_of(scene, part, options)
    whole = ImageEvaluator(scene, table, caster, detection, shadows=options.shadows, threads=threads, pool=pool)
    drawn = replace(whole, table=drawn_patches(table, _drawn_count(len(postures))))
    request = PostureRequest(count=plan.choose_postures, target=plan.target, limit=options.limit)
    further = plan.all_exposures, plan.exposure_gain
    choice = choose_with_exposures(whole, drawn, lights, candidates, request, *further, run)
    if plan.target is not None and choice.cover.share < plan.target:
        all_exposures = replace(drawn, exposures=plan.all_exposures)
        raise target_not_reached(plan.target, choice, all_exposures, least=options.min_images)
    if not choice.postures:
        shown = f"{part.source.path}'s catalogue in {counted(options.min_images, 'image')} or more"
        raise CheckFailed(
            f"no posture of {len(postures)} shows any defect of {shown}: raise option 'false_alarms', lower option "
            "'min_images', or change the lights"
        )
    travel = way_through(rig, choice.postures), pace_text(rig)
    whole = replace(whole, pool=None)  # what is done with the result may come after these processes
    return ChosenPostures(choice, whole, len(drawn.patches), left_out, *travel, plan)


def with_chosen(options: _problem.OptimizeOptions, rig: RigConfig, chosen: ChosenPostures) -> _problem.OptimizeOptions:
    """The options with chosen postures and the light positions that go with them."""
    places = tuple(place_of(light) for light in rig.lights)
    if chosen.choice.lights is not None:
        free = _problem.candidates_of(rig, options)
        assert free is not None
        places = tuple(some[k] for some, k in zip(free.places, chosen.choice.lights, strict=True))
    objectives, postures = options.objectives or (_problem.DEFECT_OBJECTIVE,), chosen.way.order
    return replace(options, objectives=objectives, postures=postures, common_lights=True, places=places)
