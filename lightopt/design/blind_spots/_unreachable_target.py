"""The error where a target is not reached: the best that can be, and why no more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from lightopt.core.errors import CheckFailed, counted, percent
from lightopt.core.transforms import Posture
from lightopt.design.blind_spots._blind_spots import (
    BlindReason,
    DefectVisibility,
    blind_spots,
    blind_text,
    defect_visibility,
)
from lightopt.design.objectives._objective import share_text
from lightopt.design.postures._choice import PostureChoice
from lightopt.design.postures._image_evaluator import ImageEvaluator
from lightopt.design.responses._luminance_matrix import LevelThresholds

NEAR_SHARE = 0.01
"""The message names how many postures come this near to all of them."""


@dataclass(frozen=True, kw_only=True)
class PostureCountStep:
    """Share of the pairs that a number of postures shows, all with the same lights.

    `posture` is the last of them. Others of as many, or with other lights, may show more; with these lights none show
    more than `bound`.
    """

    posture: Posture
    share: float
    bound: float


class TargetNotReached(CheckFailed):
    """A target that is not reached.

    `steps` say what each number of postures shows at least, `grain` how far shares may be off since a patch counts as
    its middle does.
    """

    def __init__(
        self, *messages: str, target: float, steps: tuple[PostureCountStep, ...], grain: float
    ) -> None:
        super().__init__(*messages)
        self.target, self.steps, self.grain = target, steps, grain


def target_not_reached(
    target: float, choice: PostureChoice, survey: ImageEvaluator, *, least: int
) -> TargetNotReached:
    """What `choice`, which falls short of the target, can reach by how many postures, and why no more.

    `survey` is of all candidate postures; `least` images must show a pair.
    """
    cover = choice.cover
    steps = tuple(
        PostureCountStep(
            posture=posture, share=step.covered / max(1, cover.total), bound=cover.bound_of(number)
        )
        for number, (posture, step) in enumerate(zip(choice.postures, cover.steps, strict=True), start=1)
    )
    return TargetNotReached(
        _text(target, choice, survey, least), target=target, steps=steps, grain=survey.table.grain
    )


def _text(target: float, choice: PostureChoice, survey: ImageEvaluator, least: int) -> str:
    cover, offered = choice.cover, len(survey.table.postures)
    text = partial(share_text, grain=survey.table.grain, short_of=target)
    most = cover.all_covered / max(1, cover.total)
    asked = f"{100.0 * target:.9g} %"
    if most >= target:
        return (
            f"--target: {counted(len(cover.steps), 'posture')} show {text(cover.share)} of the "
            f"surface × defects, and no {len(cover.steps)} of {offered} show more than "
            f"{text(cover.bound_share)} with these lights; {asked} was asked for. "
            "Raise --choose-postures or leave it out"
        )
    lost = _lost(choice, survey, least)
    near = next(
        (i for i, step in enumerate(cover.steps, 1) if step.covered >= (most - NEAR_SHARE) * cover.total),
        len(cover.steps),
    )
    return (
        f"--target: {asked} of the surface × defects is not reached: with {_which(choice)}, all {offered} postures "
        f"together show {text(most)}, and {counted(near, 'posture')} come within "
        f"{100 * NEAR_SHARE:g} point of that. Of what stays unseen, {_reasons(lost, choice)}. {_hint(lost, survey)}Ask "
        "for less, plan --choose-postures, or change what stands in the way"
    )


def _which(choice: PostureChoice) -> str:
    return "the best lights found (others may show more)" if choice.iterations else "the lights as they stand"


def _hint(lost: Mapping[int, float], survey: ImageEvaluator) -> str:
    # more light helps where there is too little of it
    dim = lost.get(BlindReason.CONTRAST, 0.0) + lost.get(BlindReason.SHADOWED, 0.0)
    if max(survey.exposures) > 1.0 or dim <= 0.5 * sum(lost.values()):
        return ""
    return "Longer exposures may show some of it: offer them, such as --exposures 1,4,16. "


def _lost(choice: PostureChoice, survey: ImageEvaluator, least: int) -> dict[int, float]:
    # surface × defects by reason, over all candidate postures, under the chosen lights
    thresholds = LevelThresholds.of_sensor(
        shade_share=0.0,
        max_level=survey.scene.sensor.max_level,
        saturated_from=survey.scene.sensor.saturated_from,
        black_level=survey.scene.sensor.black_level,
    )
    seen: list[DefectVisibility] = []
    for posture in survey.table.postures:
        matrices = survey.matrices(posture, [[panel] for panel in choice.panels], exposures=survey.exposures)
        seen.append(defect_visibility(matrices, thresholds, least=least))
    # the shares are of the surface that the camera sees in one of them
    areas = np.zeros(len(survey.table.patches))
    areas[survey.patches] = survey.table.patches.areas[survey.patches]
    return blind_spots(areas, seen).by_reason()


def _reasons(lost: Mapping[int, float], choice: PostureChoice) -> str:
    whole = max(sum(lost.values()), 1e-12)
    names = [panel.name for panel in choice.panels]
    ordered = sorted(lost.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(
        f"{percent(share / whole, 0)} {blind_text(code, names)}" for code, share in ordered if share > 0.0
    )
