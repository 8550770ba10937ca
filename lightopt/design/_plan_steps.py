"""Exposures and tolerances of the lights and postures that were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from lightopt.config import PartConfig, RigConfig
from lightopt.core.transforms import Posture
from lightopt.design._additions import Outcome
from lightopt.design._command_line import rendered_words
from lightopt.design._commands import commands
from lightopt.design._options import OptimizeOptions
from lightopt.design._part_file import PLANNED_PART_NAME
from lightopt.design._plan_options import OBJECTIVE, PlanOptions
from lightopt.design._plan_progress import Tell, of_stage
from lightopt.design._plan_result import ChosenPostures, PlanResult, TrustOf
from lightopt.design._previous_result import RIG_NAME
from lightopt.design._result import angles_of
from lightopt.design.blind_spots._plan_blind_spots import looked_at
from lightopt.design.blind_spots._summary import Looked
from lightopt.design.exposures._brackets import Brackets
from lightopt.design.exposures._plan_exposures import plan_exposures
from lightopt.design.postures._image_evaluator import DRAWN_PATCHES, ImageEvaluator, drawn_patches
from lightopt.design.postures._plan_postures import candidates_of, detection_model_of
from lightopt.design.tolerances._analysis import analyse_tolerances
from lightopt.design.tolerances._assessments import ObjectiveAssessment, PairAssessment, Setup
from lightopt.design.tolerances._tolerances import Tolerances
from lightopt.images import posture_folder

Angles = tuple[tuple[float, float], ...]


def appraised(
    rig: RigConfig,
    part: PartConfig,
    outcome: Outcome,
    options: OptimizeOptions,
    wanted: PlanOptions,
    chosen: ChosenPostures | None,
    survey: ImageEvaluator | None,
    searching: Tell | None,
) -> tuple[PlanResult, tuple[Looked, ...]]:
    """The whole plan, with what is asked of it beside postures and lights; and what its images show.

    The latter posture by posture, the planned exposures among them; beside what the lights could do, wherever they may
    stand, at all exposures that were offered. Empty where the optimisation's own images are all there is.

    Parameters
    ----------
    rig, part, options, wanted
        What is planned.
    outcome
        Of the optimisation.
    chosen
        Postures; None for the part's own.
    survey
        The part that they were chosen on, so that all shares are of the same surface; None for the part's own.
    searching
        Called with what is going on and the share of that which is done.
    """
    if any(result.answers[0].nothing is not None for result in outcome.results):
        return PlanResult(chosen=chosen), ()
    angles = {
        posture: angles_of(outcome.candidates, result.answers[0].found.best)
        for result in outcome.results
        for posture in result.postures
    }
    brackets = None if chosen is None else chosen.brackets
    trust: tuple[TrustOf, ...] = ()
    if wanted.exposures or wanted.tolerances is not None:
        survey = survey or _own_survey(outcome, part, options)
        asked = _Asked(
            rig=rig, outcome=outcome, options=options, survey=survey, angles=angles, tell=searching
        )
        if wanted.exposures and chosen is None:
            brackets = asked.brackets(wanted)
        if wanted.tolerances is not None:
            trust = asked.trust(wanted.tolerances, brackets)
    if chosen is None and brackets is None:
        return PlanResult(trust=trust), ()
    files = {posture: _rig_file(posture, angles) for posture in angles}
    result = PlanResult(
        chosen=chosen,
        brackets=brackets,
        trust=trust,
        commands=commands(rig, files, PLANNED_PART_NAME, brackets, rendered_words(options)),
    )
    if OBJECTIVE not in (answer.objective.name for found in outcome.results for answer in found.answers):
        return result, ()
    return result, looked_at(
        _own_survey(outcome, part, options),
        rig,
        angles,
        outcome.candidates if chosen is None else candidates_of(rig, options),
        exposures={posture: brackets.of(posture) if brackets else (1.0,) for posture in angles},
        offered=wanted.all_exposures,
        thresholds=outcome.thresholds,
        least=options.seen_in,
        points=options.points,
        tell=of_stage(searching, "blind spots"),
    )


def _own_survey(outcome: Outcome, part: PartConfig, options: OptimizeOptions) -> ImageEvaluator:
    """The part as the optimisation looked at it."""
    return ImageEvaluator(
        scene=outcome.scene,
        table=outcome.table(),
        caster=outcome.caster,
        detection=detection_model_of(outcome.scene, part, options),
        shadows=options.shadows,
        threads=options.threads,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Asked:
    """Lights and postures, and what they are looked at on; angles of the lights by posture [°]."""

    rig: RigConfig
    outcome: Outcome
    options: OptimizeOptions
    survey: ImageEvaluator
    angles: Mapping[Posture, Angles]
    tell: Tell | None

    def brackets(self, wanted: PlanOptions) -> Brackets:
        """Further exposures."""
        postures = tuple(self.angles)
        setup = self._setup(postures, None)
        lights = range(len(self.rig.lights))
        return plan_exposures(
            self.survey,
            postures,
            [[setup.panel(i, light, (0.0, 0.0)) for light in lights] for i in range(len(postures))],
            wanted.exposures,
            seen_in=self.options.seen_in,
            gain_points=wanted.exposure_gain,
            target=wanted.target,
            progress=of_stage(self.tell, "exposures"),
        )

    def trust(self, tolerances: Tolerances, brackets: Brackets | None) -> tuple[TrustOf, ...]:
        """How far the score falls, of each posture and of all together."""
        drawn = replace(self.survey, table=drawn_patches(self.survey.table, DRAWN_PATCHES))
        postures = tuple(self.angles)
        # of one posture alone nothing is seen where its lights are fewer than the images that must show it
        single = len(self.rig.lights) >= self.options.seen_in or len(postures) == 1
        groups = [(posture,) for posture in postures if single] + ([postures] if len(postures) > 1 else [])
        return tuple(
            TrustOf(
                postures=group,
                trust=analyse_tolerances(
                    self._assessment(drawn, self._setup(group, brackets)),
                    [light.name for light in self.rig.lights],
                    tolerances,
                    progress=of_stage(self.tell, f"tolerances, {', '.join(map(str, group))}"),
                ),
                unit=self.outcome.results[0].answers[0].objective.unit,
                patches=len(drawn.patches),
                grain=drawn.table.grain,
            )
            for group in groups
        )

    def _assessment(self, drawn: ImageEvaluator, setup: Setup) -> PairAssessment | ObjectiveAssessment:
        objective = self.outcome.results[0].answers[0].objective
        if objective.name == OBJECTIVE:
            return PairAssessment(drawn, setup, seen_in=self.options.seen_in)
        # an objective of levels knows exposure 1 only
        return ObjectiveAssessment(
            replace(drawn, detection=None),
            replace(setup, exposures=((1.0,),) * len(setup.postures)),
            objective=objective,
            thresholds=self.outcome.thresholds,
        )

    def _setup(self, postures: Sequence[Posture], brackets: Brackets | None) -> Setup:
        return Setup(
            rig=self.rig,
            postures=tuple(postures),
            angles=tuple(self.angles[posture] for posture in postures),
            exposures=tuple(brackets.of(posture) if brackets else (1.0,) for posture in postures),
            points=self.options.points,
        )


def _rig_file(posture: Posture, angles: Mapping[Posture, Angles]) -> str:
    # as the optimisation writes them: one rig where all postures have the same lights
    return RIG_NAME if len(set(angles.values())) == 1 else f"{posture_folder(posture)}/{RIG_NAME}"
