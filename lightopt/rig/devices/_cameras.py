"""Cameras by the names that rig files use, and those that are there."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from lightopt.core.errors import InputError, LightoptError
from lightopt.rig.devices._aravis import AravisSdk, aravis_cameras, load_aravis
from lightopt.rig.devices._camera_sdk import CameraSdk
from lightopt.rig.devices._camera_settings import CameraHere, CameraSettings
from lightopt.rig.devices._genicam import GenicamSdk, genicam_cameras, load_harvester, producers_here
from lightopt.rig.devices._log import Event
from lightopt.rig.devices._machine_camera import MachineCamera


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

    Parameters
    ----------
    driver
        Its name.
    settings
        Which camera, and how it is to be.
    tell
        Called with what is out of the ordinary, as it happens.
    ready
        Called before each frame is asked for; returns when one can be.

    Raises
    ------
    InputError
        When software or camera are not there, or it cannot be as the rig wants it.
    HardwareError
        When it does not answer.
    """
    return MachineCamera(driver, camera_drivers()[driver](settings), settings, tell=tell, ready=ready)


def check_camera_driver(driver: str, producer: Path | None) -> None:
    """Check that a camera's software is there; no camera is looked for.

    Raises
    ------
    InputError
        When it is not, with how to install it.
    """
    if driver == "aravis":
        load_aravis()
    else:
        load_harvester()
        if producer is not None and not producer.is_file():
            raise InputError(f"no GenTL producer {producer}; it is a .cti file of the camera's maker")


def cameras_here(producer: Path | None = None) -> tuple[list[CameraHere], list[str]]:
    """Cameras that answer, through whatever software is there; none is opened.

    Parameters
    ----------
    producer
        GenTL producer to ask beside those that installers have named.

    Returns
    -------
    tuple
        The cameras, and in words what could not be asked.
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
