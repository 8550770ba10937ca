"""Open the devices that a plan needs: real ones, or those of the virtual bench."""

import logging
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import LightoptError, collected, refuse
from lightopt.core.run_context import RunContext
from lightopt.rig import devices
from lightopt.rig.capture._capture_plan import CapturePlan
from lightopt.rig.capture._lights_off import open_lights
from lightopt.rig.capture._safe_devices import Devices
from lightopt.rig.capture._signals import EndSignals
from lightopt.rig.capture._software_cameras import FolderCamera, VirtualCamera
from lightopt.rig.capture._wiring import STAGE, VIRTUAL, Wiring, bench_truth, stage_axes, start_bench
from lightopt.rig.simulated import CAMERA, BenchProcess, BenchTruth

_log = logging.getLogger("lightopt.rig")


def connect_devices(
    rig: RigConfig,
    wiring: Wiring,
    *,
    part: PartConfig | None = None,  # on the virtual bench; needed for its camera
    plan: CapturePlan | None = None,  # the images that a folder camera must have
    camera: bool = True,
    serial_log: Path | None = None,  # gets every byte on the wires
    truth: BenchTruth | None = None,  # how the virtual bench differs from the files
    bench: BenchProcess | None = None,  # a virtual bench that runs already; it is left running
    touch_lights: bool = True,  # False to query the devices only: nothing is switched
    unreachable: dict[str, LightoptError] | None = None,  # collects what does not answer, with why; None: an error
    run: RunContext | None = None,  # gets warnings of irregularities on the wires
) -> Devices:
    """Open lights, stage and camera; nothing is lit or moved.

    Lights are opened first, and each controller goes dark as it opens: after a run that was killed this is the only
    way to darken lights that are on while another device is out of order.

    Raises InputError: A port is not there or in use, or a folder lacks images of the plan.
    Raises HardwareError: A device does not answer. By then every controller that can be reached was darkened, unless
        `touch_lights` is false, and the message names the lights that may still be on.
    """
    run = run or RunContext()
    replay = check_devices(rig, wiring, plan, camera=camera)
    with ExitStack() as stack:
        signals = stack.enter_context(EndSignals())
        log = devices.SerialLog(serial_log, warn=run.warn)
        closing: list[Callable[[], None]] = [log.close]
        stack.callback(log.close)
        if bench is None and wiring.needs_bench:
            seed = None if plan is None else plan.options.seed
            bench = start_bench(rig, wiring, part=part if camera else None, truth=truth or bench_truth(rig, seed))
            stack.callback(bench.close)
            closing.append(bench.close)
        ports: Mapping[str, str] = {} if bench is None else bench.ports
        controllers = wiring.hardware.controllers
        lights = open_lights(
            wiring,
            controllers,
            ports={n: p for n, p in ports.items() if n in controllers and controllers[n].port == VIRTUAL},
            log=log,
            darken=touch_lights,
            opened=lambda controller: stack.callback(controller.close),
        )
        if unreachable is not None:
            unreachable |= lights.problems
        elif lights.problems:
            raise lights.error()

        @contextmanager
        def naming_lights(device: str) -> Generator[None]:
            """Errors of a device also say which lights may still be on; or they are collected."""
            try:
                yield
            except LightoptError as error:
                if unreachable is None:
                    raise (lights.error(error) if touch_lights else error) from error
                unreachable[device] = error

        stage: devices.Stage | None = None
        if (config := wiring.hardware.stage) is not None:
            with naming_lights(STAGE):
                stage = devices.open_stage(
                    config.driver,
                    port=ports[STAGE] if config.port == VIRTUAL else config.port,
                    axes=stage_axes(rig, config),
                    log=log,
                    **config.model_dump(include={"baud", "timeout_s", "home_timeout_s"}),
                )
                stack.callback(stage.close)
        opened_camera: devices.Camera | None = None
        if camera:
            with naming_lights("camera"):
                opened_camera = _open_rig_camera(rig, wiring, replay=replay, bench=bench, log=log)
                stack.callback(opened_camera.close)
        others = {STAGE: stage, "camera": opened_camera}
        opened = {**lights.controllers, **{name: device for name, device in others.items() if device is not None}}
        _log.info("opened %s", ", ".join(opened))
        sources = [*opened.values(), log]
        connected = Devices(
            wiring=wiring,
            controllers=lights.controllers,
            stage=stage,
            camera=opened_camera,
            events=lambda: [event for source in sources for event in getattr(source, "events", ())],
            closing=closing,
            signals=signals,
            touch_lights=touch_lights,
            dark=touch_lights,
        )
        if plan is not None and not plan.home:
            with naming_lights(STAGE):
                connected.check_referenced()
        stack.pop_all()  # from here on the devices close themselves
    return connected


def check_devices(
    rig: RigConfig, wiring: Wiring, plan: CapturePlan | None = None, *, camera: bool = True
) -> FolderCamera | None:
    """Check what is known before any device is opened (InputError); returns the folder that is replayed, if any."""
    problems: list[str] = []
    replay: FolderCamera | None = None
    driver = wiring.hardware.camera.driver
    if camera and driver in ("aravis", "genicam"):  # is its software installed?
        with collected(problems, where=rig.source.at("hardware", "camera")):
            devices.check_camera_driver(driver, _producer(rig, wiring))
    if camera and driver == "folder":
        with collected(problems):
            folder = rig.source.resolve(wiring.hardware.camera.folder or "")
            replay = FolderCamera(folder, resolution_px=rig.camera.resolution_px, exposure_us=wiring.exposure_us)
            if plan is not None:
                darks = [(None, posture, exposure) for posture in plan.postures for exposure in plan.dark_exposures]
                missing = (replay.missing(*key) for key in (*plan.keys, *darks))
                problems += [problem for problem in missing if problem is not None]
    stage = wiring.hardware.stage
    named = [(("controllers", name), device.port) for name, device in wiring.hardware.controllers.items()]
    for place, port in (*named, *([] if stage is None else [(("stage",), stage.port)])):
        # a URL is only tried when it is opened
        if port not in (None, VIRTUAL) and (problem := devices.port_problem(port)) is not None:
            problems.append(f"{rig.source.at('hardware', *place, 'port')}: {problem}")
    for name, device in wiring.hardware.controllers.items():
        with collected(problems, where=rig.source.at("hardware", "controllers", name)):
            if device.picture is not None and device.port is None:
                devices.check_display(device.command, wiring.folder)
    if stage is not None:
        with collected(problems, where=rig.source.at("hardware", "stage")):
            devices.STAGE_DRIVERS[stage.driver].check_axes(stage_axes(rig, stage))
    refuse(problems)
    return replay


def _open_rig_camera(
    rig: RigConfig, wiring: Wiring, *, replay: FolderCamera | None, bench: BenchProcess | None, log: devices.SerialLog
) -> devices.Camera:
    if replay is not None:
        return replay
    config = wiring.hardware.camera
    if config.driver == VIRTUAL:
        assert bench is not None
        return VirtualCamera(bench)
    gige = bench if wiring.camera_is_gige else None
    producer = _producer(rig, wiring)
    settings = devices.CameraSettings(
        where=rig.source.at("hardware", "camera"),
        resolution_px=rig.camera.resolution_px,
        bit_depth=rig.camera.sensor.bit_depth,
        port=config.port if gige is None else gige.ports[CAMERA],
        producer=None if producer is None else str(producer),
        **config.model_dump(exclude={"driver", "folder", "port", "producer"}),
    )
    wait_ready = None if gige is None else gige.prepare
    return devices.open_camera(config.driver, settings, on_event=log.note, wait_ready=wait_ready)


def _producer(rig: RigConfig, wiring: Wiring) -> Path | None:
    producer = wiring.hardware.camera.producer
    return None if producer is None else rig.source.resolve(producer)
