"""Opening what a plan needs. Only here is chosen between the virtual bench and real devices."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from lightopt.config import PartConfig, RigConfig, StageDeviceConfig
from lightopt.core.errors import InputError, LightoptError
from lightopt.rig.capture._devices import Devices
from lightopt.rig.capture._folder_camera import FolderCamera
from lightopt.rig.capture._lights import open_lights
from lightopt.rig.capture._plan import Plan
from lightopt.rig.capture._signals import EndSignals
from lightopt.rig.capture._simulated_rig import STAGE, start_bench
from lightopt.rig.capture._wiring import CAMERA, VIRTUAL, Wiring
from lightopt.rig.devices import (
    Axis,
    Camera,
    CameraSettings,
    Event,
    SerialLog,
    Stage,
    check_camera_driver,
    check_stage,
    open_camera,
    open_stage,
    port_problem,
)
from lightopt.rig.simulated import BenchProcess, BenchTruth, VirtualCamera


def connect_devices(
    rig: RigConfig,
    wiring: Wiring,
    *,
    part: PartConfig | None = None,
    plan: Plan | None = None,
    camera: bool = True,
    serial_log: Path | None = None,
    truth: BenchTruth | None = None,
    bench: BenchProcess | None = None,
    touch_lights: bool = True,
    warn: Callable[[str], None] | None = None,
    silent: dict[str, LightoptError] | None = None,
) -> Devices:
    """Open lights, stage and camera; nothing is lit or moved.

    Lights are opened first, and each controller goes dark as it opens: after a run that was killed this is the only
    way to darken lights that are on while another device is out of order.

    Parameters
    ----------
    part
        What lies on the virtual bench; needed for its camera.
    plan
        What a folder camera must have.
    serial_log
        File that gets every byte on the wires.
    truth
        How the virtual bench differs from the files.
    bench
        A virtual bench that runs already; it is left running.
    touch_lights
        False to only look at the devices: nothing is switched.
    warn
        Called with irregularities on the wires, as they happen, and if the serial log ends early, which
        ends nothing else.
    silent
        To only look: collects the controllers and the stage that do not answer, with why, and the others are opened all
        the same. None: that is an error.

    Raises
    ------
    InputError
        A port is not there or in use, or a folder lacks images of the plan.
    HardwareError
        A device does not answer. By then every controller that can be reached was darkened, unless `touch_lights`
        is false, and the message names the lights that may still burn.
    """
    replay = check_devices(rig, wiring, plan, camera=camera)
    signals = EndSignals()
    signals.install()
    with ExitStack() as stack:
        stack.callback(signals.restore)
        log = SerialLog(serial_log, warn=warn)
        closing: list[Callable[[], None]] = [log.close]
        stack.callback(log.close)
        if bench is None and wiring.needs_bench:
            bench = start_bench(rig, wiring, part=part if camera else None, truth=truth)
            stack.callback(bench.close)
            closing.append(bench.close)
        ports: Mapping[str, str] = {} if bench is None else bench.ports
        lights = open_lights(
            wiring,
            wiring.hardware.controllers,
            ports={name: ports[name] for name in ports if _virtual(wiring, name)},
            log=log,
            darken=touch_lights,
            opened=lambda controller: stack.callback(controller.close),
        )
        if silent is not None:
            silent |= lights.problems
        elif lights.problems:
            raise lights.raised()
        stage: Stage | None = None
        try:
            stage = _stage(rig, wiring, ports, log)
            if stage is not None:
                stack.callback(stage.close)
        except LightoptError as error:
            if silent is None:
                raise (lights.raised(error) if touch_lights else error) from error
            silent[STAGE] = error
        seen: Camera | None = None
        if camera:
            try:
                seen = opened_camera(rig, wiring, replay=replay, bench=bench, log=log)
            except LightoptError as error:
                raise (lights.raised(error) if touch_lights else error) from error
            stack.callback(seen.close)
        devices = Devices(
            wiring=wiring,
            controllers=lights.controllers,
            stage=stage,
            camera=seen,
            events=lambda: _events([*lights.controllers.values(), stage, seen, log]),
            closing=closing,
            signals=signals,
            touch_lights=touch_lights,
            dark=touch_lights,
        )
        if plan is not None and not plan.home:
            try:
                devices.check_referenced()
            except LightoptError as error:
                raise lights.raised(error) from error
        stack.pop_all()  # from here on the devices close themselves
    return devices


def check_devices(
    rig: RigConfig, wiring: Wiring, plan: Plan | None = None, *, camera: bool = True
) -> FolderCamera | None:
    """Check what can be known of devices before any is opened: ports, axes and speeds, the folder to replay.

    Returns the folder that is replayed, where one is.

    Raises
    ------
    InputError
        With all that is wrong.
    """
    problems: list[str] = []
    replay: FolderCamera | None = None
    try:
        if camera:
            check_camera_software(rig, wiring)
            replay = _folder_camera(rig, wiring, plan)
    except InputError as error:
        problems += error.messages
    try:
        _check_ports(rig, wiring)
    except InputError as error:
        problems += error.messages
    if (stage := wiring.hardware.stage) is not None:
        try:
            check_stage(stage.driver, _axes(rig, stage))
        except InputError as error:
            problems += [f"{rig.source.at('hardware', 'stage')}: {message}" for message in error.messages]
    if problems:
        raise InputError(*problems)
    return replay


def _virtual(wiring: Wiring, name: str) -> bool:
    config = wiring.hardware.controllers.get(name)
    return config is not None and config.port == VIRTUAL


def _folder_camera(rig: RigConfig, wiring: Wiring, plan: Plan | None) -> FolderCamera | None:
    config = wiring.hardware.camera
    if config.driver != "folder":
        return None
    camera = FolderCamera(
        rig.source.resolve(config.folder or ""),
        resolution_px=rig.camera.resolution_px,
        exposure_us=wiring.exposure_us,
    )
    if plan is not None:
        keys = [*plan.keys]
        keys += [(None, task.posture, e) for task in plan.tasks for e in task.dark_exposures]
        if problems := [problem for key in keys if (problem := camera.missing(*key)) is not None]:
            raise InputError(*problems)
    return camera


def _check_ports(rig: RigConfig, wiring: Wiring) -> None:
    """Refuse ports that are not there before any other is opened; a URL is only known when it is opened."""
    hardware = wiring.hardware
    named = [
        (rig.source.at("hardware", "controllers", name, "port"), config.port)
        for name, config in hardware.controllers.items()
    ]
    if hardware.stage is not None:
        named.append((rig.source.at("hardware", "stage", "port"), hardware.stage.port))
    problems = [
        f"{where}: {problem}"
        for where, port in named
        if port != VIRTUAL and (problem := port_problem(port)) is not None
    ]
    if problems:
        raise InputError(*problems)


def _stage(rig: RigConfig, wiring: Wiring, ports: Mapping[str, str], log: SerialLog) -> Stage | None:
    config = wiring.hardware.stage
    if config is None:
        return None
    return open_stage(
        config.driver,
        port=ports[STAGE] if config.port == VIRTUAL else config.port,
        axes=_axes(rig, config),
        baud=config.baud,
        timeout_s=config.timeout_s,
        home_timeout_s=config.home_timeout_s,
        log=log,
    )


def _axes(rig: RigConfig, config: StageDeviceConfig) -> list[Axis]:
    ranges = {"elevation": rig.stage.elevation_range_deg, "rotation": rig.stage.rotation_range_deg}
    return [
        Axis(
            name=name,
            device=axis.axis,
            range_deg=ranges[name],
            steps_per_deg=axis.steps_per_deg,
            zero=axis.zero,
            speed_deg_per_s=axis.speed_deg_per_s,
            home_sense=axis.home_sense,
        )
        for name, axis in (("elevation", config.elevation), ("rotation", config.rotation))
        if axis is not None
    ]


def _events(drivers: list[Any]) -> list[Event]:
    return [event for driver in drivers for event in getattr(driver, "events", ())]


def check_camera_software(rig: RigConfig, wiring: Wiring) -> None:
    """Refuse a camera whose software is not on this computer, before anything is opened."""
    config = wiring.hardware.camera
    if config.driver not in ("aravis", "genicam"):
        return
    try:
        check_camera_driver(config.driver, _producer(rig, wiring))
    except InputError as error:
        where = rig.source.at("hardware", "camera")
        raise InputError(*(f"{where}: {message}" for message in error.messages)) from None


def opened_camera(
    rig: RigConfig,
    wiring: Wiring,
    *,
    replay: FolderCamera | None,
    bench: BenchProcess | None,
    log: SerialLog | None,
) -> Camera:
    """Open the camera with the rig's settings; no frame is taken.

    InputError when it is not there or cannot be set so, HardwareError when it does not answer.
    """
    if replay is not None:
        return replay
    config = wiring.hardware.camera
    ports: Mapping[str, str] = {} if bench is None else bench.ports
    if config.driver == VIRTUAL:
        assert bench is not None
        return VirtualCamera(bench)
    producer = _producer(rig, wiring)
    settings = CameraSettings(
        where=rig.source.at("hardware", "camera"),
        resolution_px=rig.camera.resolution_px,
        bit_depth=rig.camera.sensor.bit_depth,
        port=ports[CAMERA] if wiring.camera_is_gige else config.port,
        producer=None if producer is None else str(producer),
        pixel_format=config.pixel_format,
        offset_px=config.offset_px,
        gain=config.gain,
        trigger=config.trigger,
        fixed_exposure_us=config.fixed_exposure_us,
        packet_size=config.packet_size,
        packet_delay_ns=config.packet_delay_ns,
    )
    return open_camera(
        config.driver,
        settings,
        tell=None if log is None else log.note,
        ready=bench.prepare if bench is not None and wiring.camera_is_gige else None,
    )


def _producer(rig: RigConfig, wiring: Wiring) -> Path | None:
    producer = wiring.hardware.camera.producer
    return None if producer is None else rig.source.resolve(producer)
