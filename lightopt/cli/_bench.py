from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from lightopt.cli import _common as common
from lightopt.cli._common import HeadedCommand
from lightopt.cli._terminal import echo, echo_warning, show_table
from lightopt.core.errors import HardwareError, InputError, LightoptError
from lightopt.core.run_context import RunContext

if TYPE_CHECKING:
    from lightopt.config import CameraDeviceConfig, RigConfig
    from lightopt.rig.capture import Devices
    from lightopt.rig.devices import CameraInfo


bench = typer.Typer(name="bench", help="Test the devices of a rig one by one.", no_args_is_help=True, **common.PLAIN)


@bench.command(cls=HeadedCommand)
def status(rig: common.RigFile, serial_log: common.SerialLog = None) -> None:
    """Print the state of every device; switch and move nothing."""
    from lightopt.config import load_rig
    from lightopt.rig.capture import device_statuses

    unreachable: dict[str, LightoptError] = {}
    loaded = load_rig(rig)
    with _open(loaded, serial_log, touch_lights=False, unreachable=unreachable) as devices:
        rows = list(device_statuses(devices, loaded, unreachable))
    show_table(("device", "state"), [(name, text) for name, text, _ in rows], numbers_from=2)
    if problems := [f"{name}: {text}" for name, text, failed in rows if failed]:
        raise HardwareError(*problems)


@bench.command(cls=HeadedCommand)
def light(
    rig: common.RigFile,
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the light in RIG.")],
    level: int | None = typer.Argument(None, metavar="LEVEL", help="Intensity level.", show_default="the level in RIG"),
    seconds: float | None = Option(None, metavar="S", min=0.0, help="Time [s].", show_default="until Enter is pressed"),
    serial_log: common.SerialLog = None,
) -> None:
    """Switch a light on, until Enter is pressed or for the time given by --seconds.

    A time above max_on_s of the light is an error.
    """
    from lightopt.config import load_rig
    from lightopt.rig.capture import check_level, check_on_time, hold_light, wiring_of

    if seconds is None and not sys.stdin.isatty():
        raise InputError("--seconds: required, because standard input is not a terminal")
    loaded = load_rig(rig)
    wiring = wiring_of(loaded)
    chosen = check_level(wiring, loaded, name, level)
    if seconds is not None:
        check_on_time(wiring, loaded, name, seconds)
    longest = wiring.light(name).max_on_s
    at_most = "" if longest is None else f", {longest:g} s at most (max_on_s)"
    with _open(loaded, serial_log) as devices:
        duration = f"until Enter is pressed{at_most}" if seconds is None else f"for {seconds:g} s"
        echo(f"{name} is on at level {chosen} {duration}")
        held = hold_light(devices, name, chosen, seconds=seconds, wait=_wait)
    held_text = "its level cannot be read back" if held is None else f"the controller held level {held}"
    echo(f"{name} is off; {held_text}")


@bench.command(cls=HeadedCommand)
def off(rig: common.RigFile, serial_log: common.SerialLog = None) -> None:
    """Switch every channel of every controller off.

    Stage and camera are not used. Of RIG only the controllers must be valid; other errors in it are reported as
    warnings at the end.
    """
    from lightopt.config import load_lights
    from lightopt.rig.capture import switch_off

    lights = load_lights(rig)
    try:
        done = switch_off(lights, serial_log=serial_log, run=RunContext(warn=echo_warning))
    finally:
        for problem in lights.problems:
            echo_warning(problem)
    which, unverified = f"({', '.join(done.controllers)})", ", ".join(done.unverified)
    if unverified:
        echo(f"all lights of {lights.name} were switched off {which}; {unverified} cannot be read back: check by eye")
    else:
        echo(f"all lights of {lights.name} are off {which}")


@bench.command(cls=HeadedCommand)
def home(rig: common.RigFile, serial_log: common.SerialLog = None) -> None:
    """Home the stage."""
    from lightopt.config import load_rig

    with _open(load_rig(rig), serial_log, needs_stage=True) as devices:
        devices.step = "homing the stage"
        devices.home()
        assert devices.stage is not None
        state = devices.stage.state()
    echo(f"the stage is at {state.posture}")


@bench.command(cls=HeadedCommand)
def move(
    rig: common.RigFile,
    elevation: float | None = Option(None, metavar="θ", help="Tilt [deg].", show_default="unchanged"),
    rotation: float | None = Option(None, metavar="φ", help="Rotation [deg].", show_default="unchanged"),
    home: bool = Option(False, "--home", help="Home the stage first."),
    serial_log: common.SerialLog = None,
) -> None:
    """Move the stage and verify its position.

    The virtual bench is always homed first, since it has just been switched on.
    """
    from lightopt.config import load_rig
    from lightopt.core.transforms import Posture
    from lightopt.rig.capture import check_angles

    if elevation is None and rotation is None:
        raise InputError("expected --elevation, --rotation or both")
    loaded = load_rig(rig)
    check_angles(loaded, elevation=elevation, rotation=rotation)
    with _open(loaded, serial_log, needs_stage=True) as devices:
        assert devices.stage is not None
        if home or devices.wiring.stage_is_virtual:
            devices.step = "homing the stage"
            devices.home()
        devices.step = "moving the stage"
        here = devices.stage.state().posture
        tilt = here.elevation_deg if elevation is None else elevation
        turn = here.rotation_deg if rotation is None else rotation
        state = devices.move_to(Posture(tilt, turn))
    echo(f"the stage is at {state.posture}")


@bench.command(cls=HeadedCommand)
def snap(
    rig: common.RigFile,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="PNG file to write.")],
    light: str | None = Option(None, metavar="NAME", help="Light to switch on for the frame.", show_default="no light"),
    exposure: str = Option("1", metavar="X", help="Relative exposure time, such as 1 or 1/16."),
    part: Path | None = Option(None, metavar="PART", help="Part file (YAML); required with the virtual camera only."),
    serial_log: common.SerialLog = None,
    force: common.Force = False,
) -> None:
    """Take one frame at the current stage position."""
    from lightopt.rig import capture

    relative = common.parse_exposure(exposure)
    loaded, loaded_part = common.load_rig_and_maybe_part(rig, part)
    wiring = capture.wiring_of(loaded)
    if wiring.camera_is_virtual and loaded_part is None:
        raise InputError("--part: required with the virtual camera, which renders the part")
    capture.check_snap(wiring, loaded, relative, light)
    run = RunContext(warn=echo_warning)
    with capture.connect_devices(loaded, wiring, part=loaded_part, serial_log=serial_log, run=run) as devices:
        low, high, mean = capture.snap(devices, file, light=light, exposure=relative, overwrite=force)
    echo(f"levels {low} to {high}, mean {mean:.1f}")
    echo(f"{file}")


@bench.command("devices", cls=HeadedCommand)
def list_devices(
    rig: Path | None = typer.Argument(None, metavar="RIG", help="Rig file (YAML): also say which devices are present."),
) -> None:
    """List the serial ports, and the cameras that answer; open no port."""
    from lightopt.rig.devices import serial_ports

    ports = [(port.name, " ".join(filter(None, (port.description, port.usb)))) for port in serial_ports()]
    if ports:
        show_table(("port", "description"), ports, numbers_from=2)
    else:
        echo("no serial ports on this computer")
    if rig is None:
        _show_cameras(None)
        return
    from lightopt.config import load_rig
    from lightopt.rig.capture import controller_place, wiring_of
    from lightopt.rig.devices import port_problem

    loaded = load_rig(rig)
    hardware = wiring_of(loaded).hardware
    producer = hardware.camera.producer
    cameras = _show_cameras(None if producer is None else loaded.source.resolve(producer))

    def port_state(port: str | None) -> str:
        if port == "virtual":
            return "simulated"
        if port is None or "://" in port:  # a display, another computer
            return "not tried"
        problem = port_problem(port)
        return "present, not opened" if problem is None else f"NO: {problem.partition('; ')[0]}"

    rows = [
        (f"controller {name}", config.driver, controller_place(config), port_state(config.port))
        for name, config in hardware.controllers.items()
    ]
    if (stage := hardware.stage) is not None:
        rows.append(("stage", stage.driver, stage.port, port_state(stage.port)))
    camera = hardware.camera
    rows.append(("camera", camera.driver, camera.folder or camera.port or "", _camera_state(camera, cameras)))
    echo("")
    show_table(("device", "driver", "port", "present"), rows, numbers_from=4)


def _show_cameras(producer: Path | None) -> list[CameraInfo]:
    """List the cameras that answer, and print what could not be searched."""
    from lightopt.rig.devices import find_cameras

    cameras, problems = find_cameras(producer)
    echo("")
    if cameras:
        rows = [(camera.model, camera.driver, ", ".join(camera.names)) for camera in cameras]
        show_table(("camera", "driver", "names"), rows, numbers_from=3)
    else:
        echo("no cameras answer")
    for problem in problems:
        echo(f"not searched: {problem}")
    return cameras


def _camera_state(config: CameraDeviceConfig, cameras: list[CameraInfo]) -> str:
    if "virtual" in (config.driver, config.port):
        return "simulated"
    if config.driver == "folder":
        return ""
    named = [camera.names for camera in cameras if camera.driver == config.driver]
    found = [names for names in named if config.port is None or config.port in names]
    return "yes" if len(found) == 1 else f"NO: {len(found)} answer"


def _open(rig: RigConfig, serial_log: Path | None, *, needs_stage: bool = False, **options: Any) -> Devices:
    # without the camera; `options` as of connect_devices
    from lightopt.rig.capture import connect_devices, wiring_of

    wiring = wiring_of(rig)
    if needs_stage and wiring.hardware.stage is None:
        raise InputError(f"{rig.source.at('hardware')}: this rig has no stage")
    run = RunContext(warn=echo_warning)
    return connect_devices(rig, wiring, camera=False, serial_log=serial_log, run=run, **options)


def _wait(seconds: float | None) -> None:
    """Wait for Enter, or for some seconds where there is a limit."""
    import threading
    import time

    if not sys.stdin.isatty():
        time.sleep(seconds or 0.0)
        return
    pressed = threading.Event()
    # a thread, because no platform can wait for Enter and the clock alike
    threading.Thread(target=lambda: (sys.stdin.readline(), pressed.set()), daemon=True).start()
    end = None if seconds is None else time.monotonic() + seconds
    while not pressed.wait(0.1):  # short, so that Ctrl-C is heard on Windows, too
        if end is not None and time.monotonic() >= end:
            return
