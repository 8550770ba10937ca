"""What a person at the bench asks of single devices: how they are, a light, a posture, a frame."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from lightopt.config import RigConfig
from lightopt.core.errors import InputError, LightoptError
from lightopt.core.transforms import Posture
from lightopt.images import write_png
from lightopt.rig.capture._devices import Devices
from lightopt.rig.capture._folder_camera import FolderCamera
from lightopt.rig.capture._plan_checks import exposure_problems
from lightopt.rig.capture._simulated_rig import STAGE
from lightopt.rig.capture._timing import utc
from lightopt.rig.capture._wiring import Wiring
from lightopt.rig.devices import Frame, frame_limit_s

_DARKENING_S = 0.3
"""A light that may not burn longer is told to be off so long before."""


@dataclass(frozen=True, kw_only=True)
class DeviceRow:
    """One line of a table of devices: which, what it says, and whether that was a failure."""

    name: str
    says: str
    failed: bool = False


def device_rows(
    devices: Devices, rig: RigConfig, silent: Mapping[str, LightoptError] | None = None
) -> Iterator[DeviceRow]:
    """Ask every device how it is, without changing anything; a failure is told and the others are asked.

    Parameters
    ----------
    devices
        Those that could be opened.
    rig
        The rig.
    silent
        Why others could not, by name.
    """
    wiring = devices.wiring
    unopened = silent or {}
    for name, config in wiring.hardware.controllers.items():
        if name in unopened:
            yield DeviceRow(name=f"controller {name}", says=str(unopened[name]), failed=True)
            continue
        controller = devices.controllers[name]
        yield _row(
            f"controller {name}",
            lambda controller=controller, config=config: (
                f"{config.driver} on {config.port}"
                + "".join(f", {key} {value}" for key, value in controller.identify().details.items())
            ),
        )
    for light in rig.lights:
        channel = wiring.light(light.name)
        place = f"{channel.controller} channel {channel.channel}"
        if channel.controller in unopened:
            yield DeviceRow(name=f"light {light.name}", says=f"{place}: its controller does not answer")
            continue
        yield _row(
            f"light {light.name}",
            lambda channel=channel, place=place: (
                f"{place}: {_level(devices.controllers[channel.controller].read_level(channel.channel))}"
            ),
        )
    if STAGE in unopened:
        yield DeviceRow(name=STAGE, says=str(unopened[STAGE]), failed=True)
    elif devices.stage is not None:
        yield _row(STAGE, lambda: _stage(devices))


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


def check_burning(wiring: Wiring, rig: RigConfig, name: str, seconds: float) -> None:
    """Refuse to let a light burn longer [s] than its `max_on_s`; nothing is opened.

    Raises
    ------
    InputError
        When it would.
    """
    longest = wiring.light(name).max_on_s
    if longest is not None and seconds > longest:
        raise InputError(
            f"{name} would burn {seconds:.3g} s, longer than its max_on_s of {longest:g} s "
            f"({rig.source.at('hardware', 'lights', name)}); nothing was opened"
        )


def check_exposure(wiring: Wiring, rig: RigConfig, exposure: float) -> None:
    """Refuse a relative exposure that the camera is known not to have; nothing is opened.

    Raises
    ------
    InputError
        With the camera's range.
    """
    if problems := tuple(exposure_problems(rig, wiring, (exposure,))):
        raise InputError(*problems)


def snap_s(wiring: Wiring, exposure: float) -> float:
    """How long a light burns for one frame at a relative exposure [s]: settling, and the frames' exposures."""
    timing = wiring.hardware.timing
    return timing.light_ms / 1e3 + (1 + timing.discard_frames) * exposure * wiring.exposure_us / 1e6


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
    devices.step = f"lighting {name}"
    held = devices.light_on(name, level)
    left_s = devices.may_burn_s(name)
    longest_s = None if left_s is None else max(0.0, left_s - min(_DARKENING_S, 0.1 * left_s))
    limits = [limit for limit in (seconds, longest_s) if limit is not None]
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
            _grab(devices, held, light)
    frame = _grab(devices, held, light)
    if light is not None:
        devices.light_off(light)
    facts = {"time": utc(), "exposure_us": frame.exposure_us, "light": light, "bit_depth": camera.bit_depth}
    write_png(path, frame.levels, metadata=facts, overwrite=overwrite)
    return int(frame.levels.min()), int(frame.levels.max()), float(frame.levels.mean())


def _grab(devices: Devices, exposure_us: float, light: str | None) -> Frame:
    """Wait for a frame no longer than the light may burn."""
    limit_s = frame_limit_s(exposure_us, devices.wiring.hardware.timing.frame_timeout_s)
    left_s = None if light is None else devices.may_burn_s(light)
    frame = devices.camera.grab(timeout_s=limit_s if left_s is None else max(0.0, min(limit_s, left_s)))
    if light is not None:
        devices.check_burning(light)
    return frame


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
