"""The command that a plan was asked for with, as its files say it."""

from __future__ import annotations

import shlex
from pathlib import Path

from lightopt.design._options import OptimizeOptions
from lightopt.design._plan_options import PlanOptions
from lightopt.design._rig_file import degrees_text
from lightopt.design.tolerances._tolerances import Tolerances


def command_text(rig: Path, part: Path, options: OptimizeOptions, wanted: PlanOptions) -> str:
    """The command with every option that differs from its default, but for where the files lie and how it is run.

    Parameters
    ----------
    rig, part
        Files, of which the names are said, so that the text does not depend on the folder.
    options, wanted
        As they were asked for.
    """
    words = ["lightopt", "optimize", rig.name, part.name, *_searched(options), *_planned(wanted)]
    return " ".join(shlex.quote(word) for word in words)


def rendered_words(options: OptimizeOptions) -> list[str]:
    """The options of ``lightopt render`` that make it see what the plan saw, where they differ from its defaults."""
    plain = OptimizeOptions()
    words = _differing(
        ("--points", options.points, plain.points),
        ("--patches", options.patch_budget, plain.patch_budget),
    )
    return [*words, *(() if options.shadows else ("--no-shadows",))]


def _searched(options: OptimizeOptions) -> list[str]:
    plain = OptimizeOptions()
    words = [word for name in options.objectives for word in ("--objective", name)]
    words += _differing(
        ("--step", options.step_deg, plain.step_deg),
        ("--seen-in", options.seen_in, plain.seen_in),
        ("--threshold", options.contrast, plain.contrast),
        ("--shade-below", options.shade_below, plain.shade_below),
        ("--rows", options.rows, plain.rows),
        ("--max-combinations", options.limit, plain.limit),
    )
    words += [
        f"--posture={degrees_text(posture.elevation_deg)},{degrees_text(posture.rotation_deg)}"
        for posture in options.postures or ()
    ]
    flags = (
        ("--common-elevation", options.common_elevation),
        ("--common-lights", options.common_lights),
        ("--no-images", not options.images),
    )
    return [*words, *rendered_words(options), *(flag for flag, given in flags if given)]


def _planned(wanted: PlanOptions) -> list[str]:
    plain = PlanOptions()
    words = _differing(
        ("--choose-postures", wanted.postures, None),
        ("--target", wanted.target, None),
        ("--posture-step", wanted.posture_step_deg, plain.posture_step_deg),
        ("--allow-outside", wanted.allow_outside_px, plain.allow_outside_px),
    )
    if wanted.exposures:
        words += ["--exposures", ",".join(_text(exposure) for exposure in wanted.exposures)]
        words += _differing(("--exposure-gain", wanted.exposure_gain, plain.exposure_gain))
    if wanted.tolerances is not None:
        none = Tolerances(light_deg=0.0, pose_deg=0.0)
        words += _differing(
            ("--tolerance-deg", wanted.tolerances.light_deg, none.light_deg),
            ("--pose-tolerance-deg", wanted.tolerances.pose_deg, none.pose_deg),
            ("--tolerance-target", wanted.tolerances.target, none.target),
        )
    return words


def _differing(*options: tuple[str, object, object]) -> list[str]:
    return [word for name, value, plain in options if value != plain for word in (name, _text(value))]


def _text(value: object) -> str:
    # a float by as many digits as make it the same number again, whole numbers without their point
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)
