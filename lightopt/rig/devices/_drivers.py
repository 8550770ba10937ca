"""Registry of drivers by the name that rig files use, and how one is opened. Add a new driver here.

Lights: `light_drivers`; stages: `stage_drivers`; cameras: `camera_drivers`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from lightopt.core.errors import InputError, LightoptError
from lightopt.rig.devices._camera import MachineCamera
from lightopt.rig.devices._camera_aravis import AravisSdk, aravis_cameras, load_aravis
from lightopt.rig.devices._camera_genicam import GenicamSdk, genicam_cameras, load_harvester, producers_here
from lightopt.rig.devices._camera_sdk import CameraHere, CameraSdk, CameraSettings
from lightopt.rig.devices._light_ccs import open_ccs
from lightopt.rig.devices._light_sa import open_sa
from lightopt.rig.devices._light_template import open_template
from lightopt.rig.devices._lights import LightSettings
from lightopt.rig.devices._link import SerialLink
from lightopt.rig.devices._log import Event, SerialLog
from lightopt.rig.devices._roles import LightController
from lightopt.rig.devices._stage import Clock, MovingStage
from lightopt.rig.devices._stage_dialogue import Axis, Dialogue
from lightopt.rig.devices._stage_grbl import GrblDialogue, check_grbl
from lightopt.rig.devices._stage_sigmakoki import GscDialogue, ShotDialogue, check_gsc, check_shot
from lightopt.rig.devices._stage_zaber import ZaberDialogue, check_zaber


def light_drivers() -> dict[str, Callable[[LightSettings, SerialLog | None], LightController]]:
    """What opens a light controller, by the name of its protocol."""
    return {"ccs": open_ccs, "sa": open_sa, "template": open_template}


_Speak = Callable[[SerialLink, Sequence[Axis], float], Dialogue]


@dataclass(frozen=True)
class StageDriver:
    """A language that stages speak.

    name: Its name in a rig file.
    baud: The protocol's usual baud rate.
    rtscts: Whether the device paces the line.
    check: Refuses axes and speeds that it cannot have, as far as that is known without the device.
    speak: Makes the language's dialogue from link, axes, and the longest time [s] that homing may take.
    """

    name: str
    baud: int
    rtscts: bool
    check: Callable[[Sequence[Axis]], None]
    speak: _Speak


def stage_drivers() -> dict[str, StageDriver]:
    """The stage drivers by name."""
    drivers = (
        StageDriver("shot", 9600, True, check_shot, lambda link, axes, _: ShotDialogue(link, axes)),
        StageDriver("gsc", 9600, False, check_gsc, lambda link, axes, _: GscDialogue(link, axes)),
        StageDriver(
            "grbl",
            115200,
            False,
            check_grbl,
            lambda link, axes, s: GrblDialogue(link, axes, home_timeout_s=s),
        ),
        StageDriver("zaber", 115200, False, check_zaber, lambda link, axes, _: ZaberDialogue(link, axes)),
    )
    return {driver.name: driver for driver in drivers}


def check_stage(driver: str, axes: Sequence[Axis]) -> None:
    """Check what a stage is asked to be against what its driver can say; nothing is opened.

    Raises InputError for an unknown driver, or axes or speeds that it cannot have.
    """
    known = stage_drivers()
    if driver not in known:
        raise InputError(f"unknown stage driver {driver}; there are: {', '.join(known)}")
    if not axes:
        raise InputError("the stage has no axis: hardware.stage needs elevation, rotation, or both")
    known[driver].check(axes)


def open_stage(
    driver: str,
    *,
    port: str,
    axes: Sequence[Axis],
    baud: int | None = None,
    timeout_s: float = 1.0,
    home_timeout_s: float = 180.0,
    log: SerialLog | None = None,
    clock: Clock | None = None,
) -> MovingStage:
    """Open a stage; nothing moves.

    axes: The axes that the device moves, at least one.
    baud: Baud rate; the protocol's usual one if None.

    Raises InputError for an unknown driver, axes that it cannot have, or a port that is not there or in use.
    Raises HardwareError when the device does not answer where the protocol has it speak first.
    """
    check_stage(driver, axes)
    kind = stage_drivers()[driver]
    link = SerialLink(
        port,
        device=f"stage ({driver})",
        baud=kind.baud if baud is None else baud,
        rtscts=kind.rtscts,
        timeout_s=timeout_s,
        log=log,
    )
    try:
        dialogue = kind.speak(link, axes, home_timeout_s)
    except LightoptError:
        link.close()
        raise
    return MovingStage(
        driver=driver, dialogue=dialogue, axes=axes, home_timeout_s=home_timeout_s, clock=clock
    )


def camera_drivers() -> dict[str, Callable[[CameraSettings], CameraSdk]]:
    """What opens a camera, by the name of the driver."""
    return {"aravis": AravisSdk, "genicam": GenicamSdk}


def open_camera(
    driver: str,
    settings: CameraSettings,
    *,
    tell: Callable[[Event], None] | None = None,
    ready: Callable[[], object] | None = None,
) -> MachineCamera:
    """Open a camera and set it as the rig wants it; no frame is taken.

    ready: Called before each frame is asked for; returns when one can be.

    Raises InputError when software or camera are not there, or it cannot be as the rig wants it.
    Raises HardwareError when it does not answer.
    """
    return MachineCamera(driver, camera_drivers()[driver](settings), settings, tell=tell, ready=ready)


def check_camera_driver(driver: str, producer: Path | None) -> None:
    """Check that a camera's software is there; no camera is looked for.

    Raises InputError when it is not, with how to install it.
    """
    if driver == "aravis":
        load_aravis()
    else:
        load_harvester()
        if producer is not None and not producer.is_file():
            raise InputError(f"no GenTL producer {producer}; it is a .cti file of the camera's maker")


def cameras_here(producer: Path | None = None) -> tuple[list[CameraHere], list[str]]:
    """Cameras that answer, through whatever software is there; none is opened.

    producer: GenTL producer to ask beside those that installers have named.

    Returns: The cameras, and in words what could not be asked.
    """
    producers = {*producers_here(), *([] if producer is None else [producer])}
    asked = [_asked(aravis_cameras), *(_asked(partial(genicam_cameras, path)) for path in sorted(producers))]
    return [camera for cameras, _ in asked for camera in cameras], [
        text for _, texts in asked for text in texts
    ]


def _asked(ask: Callable[[], list[CameraHere]]) -> tuple[list[CameraHere], tuple[str, ...]]:
    try:
        return ask(), ()
    except LightoptError as error:
        return [], error.messages
