"""Limits of stage, camera and lights, checked before any device is opened, lit or moved."""

from collections.abc import Iterable, Iterator, Sequence

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.rig.capture._wiring import VIRTUAL, Wiring
from lightopt.rig.simulated import EXPOSURE_RANGE_US
from lightopt.scene import angle_outside_range, part_postures


def posture_problems(
    rig: RigConfig, part: PartConfig, wiring: Wiring, postures: Sequence[Posture] | None
) -> Iterator[str]:
    """Postures beyond the stage's range, or that a stage without one of the axes cannot take."""
    if postures is not None:
        named = [(posture, "option 'postures'") for posture in postures]
    else:
        named = [(posture, part.source.at("postures", i)) for i, posture in enumerate(part_postures(part))]
    stage = wiring.hardware.stage
    if stage is None and len(named) > 1:
        yield (
            f"{rig.source.at('hardware')}: this rig has no stage, so one run captures one posture; place the part by "
            f"hand and choose that one; found {len(named)} postures"
        )
    for posture, where in named:
        for name, angle in (("elevation", posture.elevation_deg), ("rotation", posture.rotation_deg)):
            if (problem := angle_outside_range(rig, name, angle)) is not None:
                yield f"{where}: {problem}"
            elif stage is not None and getattr(stage, name) is None and angle != 0.0:
                yield (
                    f"{where}: {name} {angle:g}°, but the stage has no {name} axis, which is at 0° "
                    f"({rig.source.at('hardware', 'stage')})"
                )


def exposure_problems(rig: RigConfig, wiring: Wiring, exposures: tuple[float, ...]) -> Iterator[str]:
    if wiring.hardware.camera.driver != VIRTUAL:
        return  # the exposures of a folder are checked when it is read, before anything is opened
    low, high = EXPOSURE_RANGE_US
    for exposure in exposures:
        time_us = exposure * wiring.exposure_us
        if not low <= time_us <= high:
            yield (
                f"exposure {exposure:g} is {time_us:g} µs ({rig.source.at('camera', 'exposure_us')}), outside the "
                f"camera's {low:g} to {high:g} µs"
            )


def light_problems(rig: RigConfig, wiring: Wiring, lights: Iterable[str], *, on_s: float, taken: str) -> Iterator[str]:
    """Lights that would be on longer at a stretch [s] than they may for what is taken."""
    for name in lights:
        channel = wiring.light(name)
        where = rig.source.at("hardware", "lights", name)
        if channel.max_on_s is not None and on_s > channel.max_on_s:
            yield (
                f"{where}: would be on for {on_s:.3g} s without a break (settling and {taken}), longer than max_on_s "
                f"{channel.max_on_s:g}; take fewer or shorter exposures"
            )


def check_level(wiring: Wiring, rig: RigConfig, name: str, level: int | None) -> int:
    """Level to light a panel at, the rig's by default; InputError for no such light, or a level above its limit."""
    if name not in wiring.hardware.lights:
        raise InputError(f'no light "{name}" in {rig.source.path}; it has {", ".join(wiring.hardware.lights)}')
    requested = wiring.light(name).level if level is None else level
    top = wiring.top_level(name)
    if not 1 <= requested <= top:
        where = f" ({rig.source.at('hardware', 'lights', name)})" if wiring.given else ""
        raise InputError(
            f"{name}: expected a level from 1 to {top}{where}, found {requested}; "
            "to switch off, use: lightopt bench off RIG"
        )
    return requested


def check_angles(rig: RigConfig, *, elevation: float | None, rotation: float | None) -> None:
    """Check angles [°] against the stage's range; None is not checked. InputError with one message per angle."""
    requested = (("elevation", elevation), ("rotation", rotation))
    outside = (angle_outside_range(rig, name, angle) for name, angle in requested if angle is not None)
    if problems := [problem for problem in outside if problem is not None]:
        raise InputError(*problems)


def check_on_time(wiring: Wiring, rig: RigConfig, name: str, seconds: float) -> None:
    """Refuse to keep a light on longer [s] than its `max_on_s` (InputError); nothing is opened."""
    longest = wiring.light(name).max_on_s
    if longest is not None and seconds > longest:
        raise InputError(
            f"{name} would be on for {seconds:.3g} s, longer than its max_on_s of {longest:g} s "
            f"({rig.source.at('hardware', 'lights', name)}); nothing was opened"
        )


def check_exposure(wiring: Wiring, rig: RigConfig, exposure: float) -> None:
    """Refuse a relative exposure that the camera is known not to have (InputError); nothing is opened."""
    if problems := tuple(exposure_problems(rig, wiring, (exposure,))):
        raise InputError(*problems)
