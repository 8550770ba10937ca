"""The camera of a rig: replayed, rendered by the virtual bench, or opened."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from lightopt.config import RigConfig
from lightopt.core.errors import InputError
from lightopt.rig.capture._folder_camera import FolderCamera
from lightopt.rig.capture._wiring import CAMERA, VIRTUAL, Wiring
from lightopt.rig.devices import Camera, CameraSettings, SerialLog, check_camera_driver, open_camera
from lightopt.rig.simulated import BenchProcess, VirtualCamera


def check_camera_software(rig: RigConfig, wiring: Wiring) -> None:
    """Refuse a camera whose software is not on this computer, before anything is opened.

    Raises
    ------
    InputError
        With how to install it.
    """
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
    """Open the camera and set it as the rig wants it; no frame is taken.

    Parameters
    ----------
    rig, wiring
        The rig and its devices.
    replay
        The folder that is replayed, where one is.
    bench
        The virtual bench, where one runs.
    log
        Told of what is out of the ordinary.

    Raises
    ------
    InputError
        When the camera is not there, or cannot be as the rig wants it.
    HardwareError
        When it does not answer.
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
        on_event=None if log is None else log.note,
        wait_ready=bench.prepare if bench is not None and wiring.camera_is_gige else None,
    )


def _producer(rig: RigConfig, wiring: Wiring) -> Path | None:
    producer = wiring.hardware.camera.producer
    return None if producer is None else rig.source.resolve(producer)
