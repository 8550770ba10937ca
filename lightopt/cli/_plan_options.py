"""The options of ``lightopt optimize`` that plan postures, exposures and tolerances."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lightopt.cli._options import parse_exposure, parse_share
from lightopt.core.errors import InputError

if TYPE_CHECKING:
    from lightopt.design import PlanOptions


def plan_options(
    *,
    choose_postures: int | None,
    target: str | None,
    posture_step: float | None,
    allow_outside: float | None,
    exposures: str | None,
    exposure_gain: float | None,
    tolerance_deg: float | None,
    pose_tolerance_deg: float | None,
    tolerance_target: str | None,
) -> PlanOptions:
    """What is asked of the plan; an option that does nothing without another is refused alone."""
    no_tolerance = tolerance_deg is None and pose_tolerance_deg is None
    alone = [
        (
            posture_step,
            choose_postures is None and target is None,
            "posture-step",
            "choose-postures or --target",
        ),
        (
            allow_outside,
            choose_postures is None and target is None,
            "allow-outside",
            "choose-postures or --target",
        ),
        (exposure_gain, exposures is None, "exposure-gain", "exposures"),
        (tolerance_target, no_tolerance, "tolerance-target", "tolerance-deg or --pose-tolerance-deg"),
    ]
    problems = [
        f"--{name}: does nothing without --{other}"
        for value, missing, name, other in alone
        if value is not None and missing
    ]
    if problems:
        raise InputError(*problems)
    texts = [] if exposures is None else exposures.split(",")
    offered = tuple(parse_exposure(text, option="--exposures") for text in texts)
    reach, kept = (
        None if text is None else parse_share(text, option=option, expected=f"{of}, such as 0.95")
        for text, option, of in (
            (target, "--target", "of the surface above 0 and up to 1"),
            (tolerance_target, "--tolerance-target", "of the score between 0 and 1"),
        )
    )

    from lightopt.design import (
        DEFAULT_EXPOSURE_GAIN,
        DEFAULT_OUTSIDE_PX,
        DEFAULT_POSTURE_STEP,
        DEFAULT_TOLERANCE_TARGET,
        PlanOptions,
        Tolerances,
    )

    return PlanOptions(
        postures=choose_postures,
        target=reach,
        posture_step_deg=DEFAULT_POSTURE_STEP if posture_step is None else posture_step,
        allow_outside_px=DEFAULT_OUTSIDE_PX if allow_outside is None else allow_outside,
        exposures=offered,
        exposure_gain=DEFAULT_EXPOSURE_GAIN if exposure_gain is None else exposure_gain,
        tolerances=None
        if no_tolerance
        else Tolerances(
            light_deg=tolerance_deg or 0.0,
            pose_deg=pose_tolerance_deg or 0.0,
            target=DEFAULT_TOLERANCE_TARGET if kept is None else kept,
        ),
    )
