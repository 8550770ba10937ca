"""Commands: the one that requests a plan, and those that carry it out, with the travel of the stage in each."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lightopt.config import RigConfig
from lightopt.core.transforms import Posture
from lightopt.design._previous_result import PLANNED_PART_NAME, RIG_NAME
from lightopt.design._problem import OptimizeOptions, PlanOptions
from lightopt.design._tolerances import Setup, Tolerances
from lightopt.images import posture_folder
from lightopt.scene import travel_order, travel_s

HOME = Posture(0.0, 0.0)  # where the stage's way begins


@dataclass(frozen=True, kw_only=True)
class Way:
    """The travel of the stage through postures, in the order that takes least time from (0°, 0°)."""

    order: tuple[Posture, ...]
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command of a plan, to be run in the folder of its files; `way` is None where it renders."""

    text: str
    way: Way | None = None


def way_through(rig: RigConfig, postures: Sequence[Posture]) -> Way:
    """The fastest way from (0°, 0°) through postures, at the speed of the rig's stage or of the virtual bench's.

    The order of `postures` decides where times are equal.
    """

    def time(start: Posture, end: Posture) -> float:
        if rig.hardware is None:
            return travel_s(None, start, end)
        return 0.0 if rig.hardware.stage is None else travel_s(rig.hardware.stage, start, end)

    order = travel_order(postures, start=HOME, time=time)
    return Way(order=order, seconds=sum(time(a, b) for a, b in zip((HOME, *order), order, strict=False)))


def plan_commands(setup: Setup, options: OptimizeOptions) -> tuple[Command, ...]:
    """Commands that carry a plan out, in the folder of its files: those that capture it, then those that render it.

    One of each kind for all postures of the same rig file and exposures.
    """
    # as the rig files are written: one where all postures have the same lights
    one_rig = len(set(setup.angles)) == 1
    groups: dict[tuple[str, tuple[float, ...]], list[Posture]] = {}
    for posture, exposures in zip(setup.postures, setup.exposures, strict=True):
        file = RIG_NAME if one_rig else f"{posture_folder(posture)}/{RIG_NAME}"
        groups.setdefault((file, exposures), []).append(posture)
    captures: list[Command] = []
    renders: list[Command] = []
    for number, ((file, exposures), postures) in enumerate(groups.items(), start=1):
        end = "" if len(groups) == 1 else f"-{number}"
        chosen = [] if len(groups) == 1 else _posture_words(postures)
        files = [file, PLANNED_PART_NAME, *chosen, f"--exposures {','.join(f'{one:.9g}' for one in exposures)}"]
        way = way_through(setup.rig, postures)
        captures.append(Command(text=" ".join(["lightopt capture", *files, f"-o captured{end}"]), way=way))
        words = ["lightopt render", *files, *_render_words(options), f"-o rendered{end}"]
        renders.append(Command(text=" ".join(words)))
    return (*captures, *renders)


def command_text(rig: Path, part: Path, options: OptimizeOptions, plan: PlanOptions) -> str:
    """The command of a run with every option that differs from its default, but for folders and how it is run.

    Files are named without their folder, so that the text does not depend on it.
    """
    words = ["lightopt", "optimize", rig.name, part.name, *_search_words(options), *_plan_words(plan)]
    return " ".join(shlex.quote(word) for word in words)


def _render_words(options: OptimizeOptions) -> list[str]:
    """The options of ``lightopt render`` that reproduce the plan's images, where they differ from its defaults."""
    default = OptimizeOptions()
    words = _differing(
        ("--points", options.points, default.points), ("--patches", options.patch_budget, default.patch_budget)
    )
    return [*words, *(() if options.shadows else ("--no-shadows",))]


def _search_words(options: OptimizeOptions) -> list[str]:
    default = OptimizeOptions()
    words = [word for name in options.objectives for word in ("--objective", name)]
    words += _differing(
        ("--step", options.step_deg, default.step_deg),
        ("--min-images", options.min_images, default.min_images),
        ("--false-alarms", options.false_alarms, default.false_alarms),
        ("--calibration", None if options.threshold is None else options.threshold.file, None),
        ("--shade-below", options.shade_below, default.shade_below),
        ("--ranking-rows", options.rows, default.rows),
        ("--max-combinations", options.limit, default.limit),
    )
    words += _posture_words(options.postures or ())
    flags = (
        ("--common-elevation", options.common_elevation),
        ("--lights-per-posture", not options.common_lights),
        ("--no-images", not options.images),
    )
    return [*words, *_render_words(options), *(flag for flag, given in flags if given)]


def _plan_words(plan: PlanOptions) -> list[str]:
    default = PlanOptions()
    words = _differing(
        ("--choose-postures", plan.choose_postures, None),
        ("--target", plan.target, None),
        ("--posture-step", plan.posture_step_deg, default.posture_step_deg),
        ("--allow-outside", plan.allow_outside_px, default.allow_outside_px),
    )
    if plan.exposures:
        words += ["--exposures", ",".join(_text(exposure) for exposure in plan.exposures)]
        words += _differing(("--exposure-gain", plan.exposure_gain, default.exposure_gain))
    if plan.tolerances is not None:
        none = Tolerances(light_deg=0.0, pose_deg=0.0)
        words += _differing(
            ("--light-tolerance", plan.tolerances.light_deg, none.light_deg),
            ("--pose-tolerance", plan.tolerances.pose_deg, none.pose_deg),
            ("--tolerance-target", plan.tolerances.tolerance_target, none.tolerance_target),
        )
    return words


def _posture_words(postures: Sequence[Posture]) -> list[str]:
    return [f"--posture={degrees_text(p.elevation_deg)},{degrees_text(p.rotation_deg)}" for p in postures]


def _differing(*options: tuple[str, object, object]) -> list[str]:
    return [word for name, value, default in options if value != default for word in (name, _text(value))]


def _text(value: object) -> str:
    # a float by as many digits as make it the same number again, whole numbers without their point
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)


def degrees_text(angle: float) -> str:
    """An angle for a file: at most nine decimals, which is finer than any stage, and no exponent."""
    return f"{round(angle, 9):.9f}".rstrip("0").rstrip(".")
