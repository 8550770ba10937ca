"""The options of ``lightopt optimize`` that plan postures, exposures and tolerances."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lightopt.cli._options import parse_exposures, parse_share
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
    light_tolerance: float | None,
    pose_tolerance: float | None,
    tolerance_target: str | None,
) -> PlanOptions:
    """Parse the options; one that does nothing without another is refused alone."""
    no_tolerance = light_tolerance is None and pose_tolerance is None
    no_choice = choose_postures is None and target is None
    alone = [
        (posture_step, no_choice, "posture-step", "choose-postures or --target"),
        (allow_outside, no_choice, "allow-outside", "choose-postures or --target"),
        (exposure_gain, exposures is None, "exposure-gain", "exposures"),
        (tolerance_target, no_tolerance, "tolerance-target", "light-tolerance or --pose-tolerance"),
    ]
    problems = [
        f"--{name}: does nothing without --{other}"
        for value, missing, name, other in alone
        if value is not None and missing
    ]
    if problems:
        raise InputError(*problems)
    candidates = () if exposures is None else parse_exposures(exposures)
    shown_share, kept_share = (
        None if text is None else parse_share(text, option=option, expected=f"{of}, such as 0.95")
        for text, option, of in (
            (target, "--target", "of the surface above 0 and up to 1"),
            (tolerance_target, "--tolerance-target", "of the score between 0 and 1"),
        )
    )

    from lightopt.design import PlanOptions, Tolerances

    tolerances = None
    if not no_tolerance:
        tolerances = Tolerances(
            light_deg=light_tolerance or 0.0, pose_deg=pose_tolerance or 0.0, **given(tolerance_target=kept_share)
        )
    return PlanOptions(
        choose_postures=choose_postures,
        target=shown_share,
        exposures=candidates,
        tolerances=tolerances,
        **given(posture_step_deg=posture_step, allow_outside_px=allow_outside, exposure_gain=exposure_gain),
    )


def given(**options: object) -> dict[str, Any]:
    """The options that were given; the others keep their defaults."""
    return {name: value for name, value in options.items() if value is not None}
