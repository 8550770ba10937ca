"""Commands: the one that requests a plan, and those that carry it out, with the travel of the stage in each."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lightopt.config import RigConfig
from lightopt.core.transforms import Posture
from lightopt.design._misalignment import Setup
from lightopt.design._problem import OptimizeOptions, PlanOptions
from lightopt.design._tolerances import Tolerances
from lightopt.images import posture_folder
from lightopt.scene import travel_order, travel_s

RIG_NAME, PLANNED_PART_NAME = "rig.optimized.yaml", "part.planned.yaml"

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
    one_rig = len(set(setup.places)) == 1
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
    words = _differing(options, {"--points": "points", "--patches": "patch_budget"})
    return [*words, *(() if options.shadows else ("--no-shadows",))]


def _search_words(options: OptimizeOptions) -> list[str]:
    words = [word for name in options.objectives for word in ("--objective", name)]
    words += _differing(options, {"--step": "step_deg", "--min-images": "min_images", "--false-alarms": "false_alarms"})
    words += () if options.threshold is None else ("--calibration", options.threshold.file)
    words += _differing(
        options, {"--shade-below": "shade_below", "--ranking-rows": "rows", "--max-combinations": "limit"}
    )
    words += _posture_words(options.postures or ())
    flags = (
        ("--common-elevation", options.common_elevation),
        ("--lights-per-posture", not options.common_lights),
        ("--no-images", not options.images),
    )
    return [*words, *_render_words(options), *(flag for flag, given in flags if given)]


def _plan_words(plan: PlanOptions) -> list[str]:
    names = {"--choose-postures": "choose_postures", "--target": "target", "--posture-step": "posture_step_deg"}
    words = _differing(plan, {**names, "--allow-outside": "allow_outside_px"})
    if plan.exposures:
        words += ["--exposures", ",".join(_text(exposure) for exposure in plan.exposures)]
        words += _differing(plan, {"--exposure-gain": "exposure_gain"})
    if plan.tolerances is not None:
        names = {"--light-tolerance": "light_deg", "--pose-tolerance": "pose_deg"}
        words += _differing(plan.tolerances, {**names, "--tolerance-target": "tolerance_target"})
    return words


def _posture_words(postures: Sequence[Posture]) -> list[str]:
    return [f"--posture={decimal_text(p.elevation_deg)},{decimal_text(p.rotation_deg)}" for p in postures]


def _differing(options: OptimizeOptions | PlanOptions | Tolerances, names: dict[str, str]) -> list[str]:
    # the options of these names whose values differ from the defaults
    default = type(options)()
    some = [(option, getattr(options, name), getattr(default, name)) for option, name in names.items()]
    return [word for option, value, unset in some if value != unset for word in (option, _text(value))]


def _text(value: object) -> str:
    # a float by as many digits as make it the same number again, whole numbers without their point
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)


def decimal_text(value: float) -> str:
    """An angle or a length for a file: at most nine decimals, which is finer than any stage, and no exponent."""
    return f"{round(value, 9):.9f}".rstrip("0").rstrip(".")
