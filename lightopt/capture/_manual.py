"""What a person at the bench asks of single devices: how they are, a light, a posture, a frame."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from lightopt.capture._devices import Devices
from lightopt.capture._folder_camera import FolderCamera
from lightopt.capture._timing import utc
from lightopt.capture._wiring import Wiring
from lightopt.config import RigConfig
from lightopt.errors import InputError, LightoptError
from lightopt.images import write_png
from lightopt.transforms import Posture

__all__ = ["DeviceRow", "burn", "check_angles", "check_level", "device_rows", "snap"]


@dataclass(frozen=True, kw_only=True)
class DeviceRow:
    """One line of a table of devices: which, what it says, and whether that was a failure."""

    name: str
    says: str
    failed: bool = False


def device_rows(devices: Devices, rig: RigConfig) -> Iterator[DeviceRow]:
    """Ask every device how it is, without changing anything; a failure is told and the others are asked."""
    wiring = devices.wiring
    for name, controller in devices.controllers.items():
        config = wiring.hardware.controllers[name]
        yield _row(
            f"controller {name}",
            lambda controller=controller, config=config: (
                f"{config.driver} on {config.port}"
                + "".join(f", {key} {value}" for key, value in controller.identify().says.items())
            ),
        )
    for light in rig.lights:
        channel = wiring.light(light.name)
        yield _row(
            f"light {light.name}",
            lambda channel=channel: (
                f"{channel.controller} channel {channel.channel}: "
                + _level(devices.controllers[channel.controller].read_level(channel.channel))
            ),
        )
    if devices.stage is not None:
        yield _row("stage", lambda: _stage(devices))


def check_level(wiring: Wiring, rig: RigConfig, name: str, level: int | None) -> int:
    """Level to light a panel at: the rig's unless one is given.

    Raises
    ------
    InputError
        For a light that the rig does not have, or a level above what its channel may have.
    """
    if name not in wiring.hardware.lights:
        raise InputError(
            f'no light "{name}" in {rig.source.path}; it has {", ".join(wiring.hardware.lights)}'
        )
    channel = wiring.light(name)
    asked = channel.level if level is None else level
    top = min(wiring.controller(name).top_level, channel.max_level or wiring.controller(name).top_level)
    if not 1 <= asked <= top:
        where = f" ({rig.source.at('hardware', 'lights', name)})" if wiring.given else ""
        raise InputError(
            f"{name}: expected a level from 1 to {top}{where}, found {asked}; "
            "to switch off, use: lightopt bench off RIG"
        )
    return asked


def check_angles(rig: RigConfig, *, elevation: float | None, rotation: float | None) -> None:
    """Check angles [°] against the stage's range; None is not looked at.

    Raises
    ------
    InputError
        With one message per angle outside the range.
    """
    asked = (
        ("elevation", elevation, rig.stage.elevation_range_deg),
        ("rotation", rotation, rig.stage.rotation_range_deg),
    )
    problems = [
        f"{name} {angle:g}° is outside the stage's range {low:g}° to {high:g}° "
        f"({rig.source.at('stage', f'{name}_range_deg')})"
        for name, angle, (low, high) in asked
        if angle is not None and not low <= angle <= high
    ]
    if problems:
        raise InputError(*problems)


def burn(
    devices: Devices, name: str, level: int, *, seconds: float | None, wait: Callable[[float | None], None]
) -> int | None:
    """Light a panel for a while, never longer than its channel may burn.

    Parameters
    ----------
    devices
        Opened.
    name, level
        Which light, how bright.
    seconds
        How long; None: until `wait` returns.
    wait
        Waits at most so many seconds (None: for ever), or until somebody has seen enough.

    Returns
    -------
    int or None
        Level that the controller held.
    """
    longest = devices.wiring.light(name).max_on_s
    limits = [limit for limit in (seconds, longest) if limit is not None]
    devices.step = f"lighting {name}"
    held = devices.light_on(name, level)
    wait(min(limits) if limits else None)
    devices.light_off(name)
    return held


def snap(
    devices: Devices,
    path: Path,
    *,
    light: str | None,
    exposure: float,
    posture: Posture | None = None,
    overwrite: bool = False,
) -> tuple[int, int, float]:
    """Take one frame, in the dark or under one light, and write it as PNG.

    Parameters
    ----------
    devices
        Opened, with the camera.
    path
        The PNG.
    light
        Lit at its level; None: none.
    exposure
        Relative to the rig's exposure time.
    posture
        What a folder camera replays.
    overwrite
        Whether a file of other content may be replaced.

    Returns
    -------
    tuple
        Lowest and highest level, and the mean.
    """
    timing = devices.wiring.hardware.timing
    camera = devices.camera
    held = camera.set_exposure(exposure * devices.wiring.exposure_us)
    if light is not None:
        devices.step = f"lighting {light}"
        devices.light_on(light)
        time.sleep(timing.light_ms / 1e3)
    devices.step = "taking a frame"
    if isinstance(camera, FolderCamera):
        camera.show(light, posture or Posture(0.0, 0.0), exposure)
    if not camera.triggered:
        for _ in range(timing.discard_frames):
            camera.grab(timeout_s=held / 1e6 + timing.frame_timeout_s)
    frame = camera.grab(timeout_s=held / 1e6 + timing.frame_timeout_s)
    if light is not None:
        devices.light_off(light)
    facts = {"time": utc(), "exposure_us": frame.exposure_us, "light": light, "bit_depth": camera.bit_depth}
    write_png(path, frame.levels, metadata=facts, overwrite=overwrite)
    return int(frame.levels.min()), int(frame.levels.max()), float(frame.levels.mean())


def _row(name: str, ask: Callable[[], str]) -> DeviceRow:
    try:
        return DeviceRow(name=name, says=ask())
    except LightoptError as error:
        return DeviceRow(name=name, says=str(error), failed=True)


def _level(level: int | None) -> str:
    if level is None:
        return "cannot be read back"
    return f"burns at level {level}" if level else "off"


def _stage(devices: Devices) -> str:
    assert devices.stage is not None
    state = devices.stage.state()
    words = [f"at {state.posture}"]
    words += ["moving"] if state.moving else []
    words += {True: [], False: ["not referenced: home it with lightopt bench home RIG"], None: []}[
        state.referenced
    ]
    words += [f"alarm: {state.alarm}"] if state.alarm else []
    return ", ".join(words)
