"""How far all lights, or the part, may be off before a design finds clearly fewer defects."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from lightopt.core.run_context import RunContext, Share
from lightopt.design import _tolerances
from lightopt.design._misalignment import PairAssessment, Setup
from lightopt.design._problem import detection_model_of
from lightopt.design._result import DesignResult, places_of
from lightopt.design.responses._image_evaluator import ImageEvaluator, drawn_patches

FEW_RUNGS = (1.0, 2.0, 4.0, 8.0, _tolerances.LARGEST_TOLERANCE)  # tolerances that are tried before bisection [°]
KNOWN_TO = 0.05  # share of a tolerance that it is known to
PATCHES = 2_000  # of all postures together, that represent the others


@dataclass(frozen=True, kw_only=True)
class JointTolerances:
    """How far angles may be off, all at once and in either direction, while the share found is kept."""

    lights: (
        _tolerances.WidestTolerance | None
    )  # of all lights; None where they are too many for all corners to be tried
    part: _tolerances.WidestTolerance  # against its postures


def design_tolerances(
    result: DesignResult, *, target: float = _tolerances.DEFAULT_TOLERANCE_TARGET, run: RunContext | None = None
) -> JointTolerances | None:
    """The tolerances of a design's first lights with which `target` of the share of defects is kept; None for none."""
    run, best = run or RunContext(), result.results[0]
    if result.defects is None or best.answers[0].nothing is not None:
        return None
    plan, postures = result.plan, best.postures
    places = (places_of(result.candidates, best.answers[0].found.best),) * len(postures)
    exposures = tuple(map(plan.exposures_of, postures))
    setup = Setup(result.rig, postures, places, exposures, points=result.options.points)
    if plan.chosen is not None:
        evaluator = plan.chosen.evaluator
    else:
        table = result.patches or result.cut_patches(edges=False, threads=run.threads)
        detection = detection_model_of(result.scene, result.part, result.options)
        shadows = result.options.shadows
        evaluator = ImageEvaluator(result.scene, table, result.caster, detection, shadows=shadows, threads=run.threads)
    drawn = replace(evaluator, table=drawn_patches(evaluator.table, max(1, PATCHES // len(postures))), images=None)
    # as the share is counted
    together = plan.chosen is not None or plan.brackets is not None
    score = PairAssessment(drawn, setup, together=together)
    return joint_tolerances(score, len(setup.bodies), target, progress=run.stage("tolerances"))


def joint_tolerances(
    score: _tolerances.ScoreFunction, bodies: int, target: float, *, progress: Share | None = None
) -> JointTolerances:
    """How far all bodies of lights may be off in both angles at once, and the part in both of its own.

    Known to 0.05° or 5 %. `target` is the share of the score that is kept in every corner.
    """
    exact: list[Sequence[_tolerances.Offset]] = [[_tolerances.EXACT]] * bodies
    least = target * int(score(_tolerances.EXACT, exact)[0])

    def one_by_one(off: Callable[[_tolerances.Offset], int]) -> Callable[[float], bool]:
        # the corner that cost too much is tried first the next time: mostly it does so again
        signs = list(_tolerances.corners(1.0))

        def keeps(degrees: float) -> bool:
            for sign in signs:
                if off((sign[0] * degrees, sign[1] * degrees)) < least:
                    signs.remove(sign)
                    signs.insert(0, sign)
                    return False
            return True

        return keeps

    def found(what: str, keeps: Callable[[float], bool], start: float) -> _tolerances.WidestTolerance:
        degrees, open_ended = _tolerances.widest_kept(keeps, FEW_RUNGS, KNOWN_TO)
        if progress is not None:
            progress(start + 0.5)
        return _tolerances.WidestTolerance(
            what=what, angle="both angles at once", degrees=degrees, open_ended=open_ended
        )

    def all_at_once(degrees: float) -> bool:
        return bool(score(_tolerances.EXACT, [list(_tolerances.corners(degrees))] * bodies).min() >= least)

    of_lights = one_by_one(lambda o: int(score(_tolerances.EXACT, [[o]])[0])) if bodies == 1 else all_at_once
    lights = found("all lights", of_lights, 0.0) if bodies <= _tolerances.MOST_BODIES else None
    return JointTolerances(lights=lights, part=found("part", one_by_one(lambda o: int(score(o, exact)[0])), 0.5))
