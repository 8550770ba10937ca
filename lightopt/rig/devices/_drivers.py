"""Registry of drivers by the name that rig files use, and how one is opened. Add a new driver here."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from lightopt.core.errors import InputError, LightoptError
from lightopt.rig.devices._camera import MachineCamera
from lightopt.rig.devices._camera_aravis import AravisSdk, find_aravis_cameras, load_aravis
from lightopt.rig.devices._camera_genicam import GenicamSdk, find_genicam_cameras, find_producers, load_harvester
from lightopt.rig.devices._camera_sdk import CameraInfo, CameraSdk, CameraSettings
from lightopt.rig.devices._device import Event
from lightopt.rig.devices._light import LightController, LightSettings
from lightopt.rig.devices._light_ccs import CcsController
from lightopt.rig.devices._light_display import CommandController, ScreenController
from lightopt.rig.devices._light_sa import SaController
from lightopt.rig.devices._light_template import TemplateController
from lightopt.rig.devices._serial_link import SerialLink, SerialLog
from lightopt.rig.devices._stage import Axis, Clock, Stage
from lightopt.rig.devices._stage_grbl import GrblDialogue
from lightopt.rig.devices._stage_sigmakoki import GscDialogue, ShotDialogue
from lightopt.rig.devices._stage_zaber import ZaberDialogue

LIGHT_DRIVERS: dict[str, Callable[[LightSettings, SerialLog | None], LightController]] = {
    driver.NAME: driver.open
    for driver in (CcsController, SaController, TemplateController, ScreenController, CommandController)
}
STAGE_DRIVERS = {"shot": ShotDialogue, "gsc": GscDialogue, "grbl": GrblDialogue, "zaber": ZaberDialogue}
CAMERA_DRIVERS: dict[str, Callable[[CameraSettings], CameraSdk]] = {"aravis": AravisSdk, "genicam": GenicamSdk}


def open_stage(
    driver: str,
    *,
    port: str,
    axes: Sequence[Axis],
    baud: int | None = None,  # None: the protocol's usual one
    timeout_s: float = 1.0,
    home_timeout_s: float = 180.0,
    log: SerialLog | None = None,
    clock: Clock | None = None,  # source of time, for tests
) -> Stage:
    """Open a stage; nothing moves. InputError for wrong axes or port, HardwareError when it does not answer."""
    kind = STAGE_DRIVERS[driver]
    kind.check_axes(axes)
    rate = kind.BAUD if baud is None else baud
    link = SerialLink(port, device=f"stage ({driver})", baud=rate, rtscts=kind.RTSCTS, timeout_s=timeout_s, log=log)
    try:
        dialogue = kind(link, axes, home_timeout_s=home_timeout_s)
    except LightoptError:
        link.close()
        raise
    return Stage(driver=driver, dialogue=dialogue, axes=axes, clock=clock)


def open_camera(
    driver: str,
    settings: CameraSettings,
    *,
    on_event: Callable[[Event], None] | None = None,  # called with irregularities, as they happen
    # called before each frame with its exposure time [µs]; returns when it can be requested
    wait_ready: Callable[[float], object] | None = None,
) -> MachineCamera:
    """Open a camera and set it up; no frame is taken. InputError where that cannot be, HardwareError: no answer."""
    return MachineCamera(driver, CAMERA_DRIVERS[driver](settings), settings, on_event=on_event, wait_ready=wait_ready)


def check_camera_driver(driver: str, producer: Path | None) -> None:
    """Check that a camera's software is there, or raise an InputError with how to install it; no camera is opened."""
    if driver == "aravis":
        load_aravis()
    else:
        load_harvester()
        if producer is not None and not producer.is_file():
            raise InputError(f"no GenTL producer {producer}; it is a .cti file of the camera's maker")


def find_cameras(producer: Path | None = None) -> tuple[list[CameraInfo], list[str]]:
    """Cameras that answer, by all software and producers, and what could not be queried; none is opened."""
    producers = {*find_producers(), *([] if producer is None else [producer])}
    cameras: list[CameraInfo] = []
    problems: list[str] = []
    for find in (find_aravis_cameras, *(partial(find_genicam_cameras, path) for path in sorted(producers))):
        try:
            cameras += find()
        except LightoptError as error:  # noqa: PERF203
            problems += error.messages
    return cameras, problems
