"""Manual control of single devices: their state, a light, a posture, a frame; checked before any is opened."""

import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path

from lightopt.config import ChannelConfig, ControllerConfig, RigConfig
from lightopt.core.errors import InputError, LightoptError, refuse
from lightopt.core.transforms import Posture
from lightopt.images import write_png
from lightopt.rig.capture._capture_plan import exposure_problems
from lightopt.rig.capture._safe_devices import Devices
from lightopt.rig.capture._software_cameras import FolderCamera
from lightopt.rig.capture._wiring import STAGE, Wiring
from lightopt.rig.devices import now
from lightopt.scene import angle_outside_range

_DARKENING_S = 0.3  # a light is switched off so long before it reaches its `max_on_s`


DeviceStatus = tuple[str, str, bool]  # name, state in words, and whether it failed


def device_statuses(
    devices: Devices, rig: RigConfig, unreachable: Mapping[str, LightoptError] | None = None
) -> Iterator[DeviceStatus]:
    """Query the state of every device and change nothing; `unreachable` are those that could not be opened."""
    wiring = devices.wiring
    unreachable = unreachable or {}
    for name in wiring.hardware.controllers:
        yield _status(f"controller {name}", partial(_controller_state, devices, name), unreachable.get(name))
    for light in rig.channels:
        channel = wiring.light(light.name)
        if channel.controller in unreachable:
            text = f"{channel.controller} channel {channel.channel}: its controller does not answer"
            yield f"light {light.name}", text, False
        else:
            yield _status(f"light {light.name}", partial(_light_state, devices, channel))
    if devices.stage is not None or STAGE in unreachable:
        yield _status(STAGE, partial(_stage_state, devices), unreachable.get(STAGE))


def check_level(wiring: Wiring, rig: RigConfig, name: str, level: int | None) -> int:
    """Level to light a panel at, the rig's by default; InputError for no such light, or a level above its limit."""
    if name not in wiring.hardware.lights:
        raise InputError(f'no light "{name}" in {rig.source.path}; it has {", ".join(wiring.hardware.lights)}')
    requested = wiring.light(name).level if level is None else level
    top = wiring.top_level(name)
    if not 1 <= requested <= top:
        where = f" ({rig.source.at('hardware', 'lights', name)})" if wiring.given else ""
        expected = f"{name}: expected a level from 1 to {top}{where}, found {requested}"
        raise InputError(f"{expected}; to switch off, use: lightopt bench off RIG")
    return requested


def check_angles(rig: RigConfig, *, elevation: float | None, rotation: float | None) -> None:
    """Check angles [°] against the stage's range; None is not checked. InputError with one message per angle."""
    requested = (("elevation", elevation), ("rotation", rotation))
    outside = (angle_outside_range(rig, name, angle) for name, angle in requested if angle is not None)
    refuse([problem for problem in outside if problem is not None])


def check_on_time(wiring: Wiring, rig: RigConfig, name: str, seconds: float) -> None:
    """Refuse to keep a light on longer [s] than its `max_on_s` (InputError); nothing is opened."""
    longest = wiring.light(name).max_on_s
    if longest is not None and seconds > longest:
        longer = f"longer than its max_on_s of {longest:g} s ({rig.source.at('hardware', 'lights', name)})"
        raise InputError(f"{name} would be on for {seconds:.3g} s, {longer}; nothing was opened")


def check_snap(wiring: Wiring, rig: RigConfig, exposure: float, light: str | None) -> None:
    """Refuse a frame that camera or light are known not to allow (InputError); nothing is opened."""
    refuse(exposure_problems(rig, wiring, (exposure,)))
    if light is not None:
        check_level(wiring, rig, light, None)
        timing = wiring.hardware.timing
        frames_s = (1 + timing.discard_frames) * exposure * wiring.exposure_us / 1e6
        check_on_time(wiring, rig, light, timing.light_ms / 1e3 + frames_s)


def hold_light(
    devices: Devices, name: str, level: int, *, seconds: float | None, wait: Callable[[float | None], None]
) -> int | None:
    """Light a panel until `wait` returns, never longer than its channel may; returns the level that it held."""
    devices.step = f"lighting {name}"
    held = devices.light_on(name, level)
    left_s = devices.remaining_on_s(name)
    longest_s = None if left_s is None else max(0.0, left_s - min(_DARKENING_S, 0.1 * left_s))
    limits = [limit for limit in (seconds, longest_s) if limit is not None]
    wait(min(limits) if limits else None)
    devices.light_off(name)
    return held


def snap(
    devices: Devices, path: Path, *, light: str | None, exposure: float, overwrite: bool = False
) -> tuple[int, int, float]:
    """Take one frame at a relative exposure and write it as PNG; returns lowest, highest and mean level."""
    timing = devices.wiring.hardware.timing
    camera = devices.camera
    held = camera.set_exposure(exposure * devices.wiring.exposure_us)
    if light is not None:
        devices.step = f"lighting {light}"
        devices.light_on(light)
        time.sleep(timing.light_ms / 1e3)
    devices.step = "capturing a frame"
    if isinstance(camera, FolderCamera):
        camera.show(light, Posture(0.0, 0.0), exposure)
    if not camera.triggered:
        for _ in range(timing.discard_frames):
            devices.grab(held, light)
    frame = devices.grab(held, light)
    if light is not None:
        devices.light_off(light)
    facts = {"time": now(), "exposure_us": frame.exposure_us, "light": light, "bit_depth": camera.bit_depth}
    write_png(path, frame.levels, metadata=facts, overwrite=overwrite)
    return int(frame.levels.min()), int(frame.levels.max()), float(frame.levels.mean())


def _status(name: str, query: Callable[[], str], problem: LightoptError | None = None) -> DeviceStatus:
    try:
        if problem is not None:
            raise problem
        return name, query(), False
    except LightoptError as error:
        return name, str(error), True


def _controller_state(devices: Devices, name: str) -> str:
    config = devices.wiring.hardware.controllers[name]
    _, _, *details = devices.controllers[name].identify().items()  # after driver and port
    return ", ".join([f"{config.driver} on {controller_place(config)}", *map(" ".join, details)])


def controller_place(config: ControllerConfig) -> str:
    return config.port or (f"monitor {config.monitor}" if config.command is None else config.command[0])


def _light_state(devices: Devices, channel: ChannelConfig) -> str:
    level = devices.controllers[channel.controller].read_level(channel.channel)
    state = "cannot be read back" if level is None else f"on at level {level}" if level else "off"
    return f"{channel.controller} channel {channel.channel}: {state}"


def _stage_state(devices: Devices) -> str:
    assert devices.stage is not None
    state = devices.stage.state()
    words = [f"at {state.posture}"]
    if state.moving:
        words.append("moving")
    if state.referenced is False:
        words.append("not referenced: home it with lightopt bench home RIG")
    if state.alarm:
        words.append(f"alarm: {state.alarm}")
    return ", ".join(words)
