"""Devices of a rig behind three small roles, one module per protocol.

The one home of pyserial, of Aravis and of harvesters; the latter two are loaded where a camera is looked for.
"""

from lightopt.rig.devices._camera_sdk import CameraInfo, CameraSettings
from lightopt.rig.devices._drivers import (
    check_camera_driver,
    check_stage,
    find_cameras,
    light_drivers,
    open_camera,
    open_stage,
)
from lightopt.rig.devices._lights import LightSettings, LightsStillOnError, all_off
from lightopt.rig.devices._log import Event, SerialLog
from lightopt.rig.devices._parallel import run_in_parallel
from lightopt.rig.devices._ports import port_problem, serial_ports
from lightopt.rig.devices._retry import frame_limit_s
from lightopt.rig.devices._roles import Camera, Frame, Identity, LightController, Stage, StageState
from lightopt.rig.devices._stage_dialogue import Axis

__all__ = [
    "Axis",
    "Camera",
    "CameraInfo",
    "CameraSettings",
    "Event",
    "Frame",
    "Identity",
    "LightController",
    "LightSettings",
    "LightsStillOnError",
    "SerialLog",
    "Stage",
    "StageState",
    "all_off",
    "check_camera_driver",
    "check_stage",
    "find_cameras",
    "frame_limit_s",
    "light_drivers",
    "open_camera",
    "open_stage",
    "port_problem",
    "run_in_parallel",
    "serial_ports",
]
