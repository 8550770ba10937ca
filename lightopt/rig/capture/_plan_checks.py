"""What of a plan cannot be, in words: postures, exposures and lights against what stage, camera and channels can do."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from lightopt.config import PartConfig, RigConfig
from lightopt.rig.capture._options import CaptureOptions
from lightopt.rig.capture._wiring import VIRTUAL, Wiring
from lightopt.rig.simulated import EXPOSURE_RANGE_US
from lightopt.scene import part_postures


def posture_problems(
    rig: RigConfig, part: PartConfig, wiring: Wiring, options: CaptureOptions
) -> Iterator[str]:
    """Postures beyond the stage's range, or that a stage without one of the axes cannot take."""
    if options.postures is not None:
        named = [(posture, "--posture") for posture in options.postures]
    else:
        named = [(posture, part.source.at("postures", i)) for i, posture in enumerate(part_postures(part))]
    stage = wiring.hardware.stage
    if stage is None and len(named) > 1:
        yield (
            f"{rig.source.at('hardware')}: this rig has no stage, so that one run takes one posture; place the part by "
            f"hand and name it with --posture; found {len(named)} postures"
        )
    for posture, where in named:
        for name, (low, high) in (
            ("elevation", rig.stage.elevation_range_deg),
            ("rotation", rig.stage.rotation_range_deg),
        ):
            angle = getattr(posture, f"{name}_deg")
            if not low <= angle <= high:
                yield (
                    f"{where}: {name} {angle:g}° is outside the stage's range {low:g}° to {high:g}° "
                    f"({rig.source.at('stage', f'{name}_range_deg')})"
                )
            elif stage is not None and getattr(stage, name) is None and angle != 0.0:
                yield (
                    f"{where}: {name} {angle:g}°, but the stage has no {name} axis, which stands at 0° "
                    f"({rig.source.at('hardware', 'stage')})"
                )


def exposure_problems(rig: RigConfig, wiring: Wiring, exposures: tuple[float, ...]) -> Iterator[str]:
    """Exposures that the virtual camera cannot hold."""
    if wiring.hardware.camera.driver != VIRTUAL:
        return  # a folder has the exposures that it has, which is looked up before anything is opened
    low, high = EXPOSURE_RANGE_US
    for exposure in exposures:
        time_us = exposure * wiring.exposure_us
        if not low <= time_us <= high:
            yield (
                f"exposure {exposure:g} is {time_us:g} µs ({rig.source.at('camera', 'exposure_us')}), outside the "
                f"camera's {low:g} to {high:g} µs"
            )


def light_problems(
    rig: RigConfig, wiring: Wiring, lights: Iterable[str], *, burning_s: float, taken: str
) -> Iterator[str]:
    """Lights above their highest level, or that would burn longer at a stretch [s] than they may for what is taken."""
    for name in lights:
        channel, controller = wiring.light(name), wiring.controller(name)
        where = rig.source.at("hardware", "lights", name)
        top = min(controller.top_level, channel.max_level or controller.top_level)
        if channel.level > top:
            yield f"{where}: level {channel.level} is above the highest allowed, {top}"
        if channel.max_on_s is not None and burning_s > channel.max_on_s:
            yield (
                f"{where}: would burn {burning_s:.3g} s at a stretch (settling and {taken}), longer than max_on_s "
                f"{channel.max_on_s:g}; take fewer or shorter exposures"
            )
