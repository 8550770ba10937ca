"""Devices of a rig behind three small roles, one module per protocol.

The one home of pyserial, of Aravis and of harvesters; the latter two are loaded where a camera is looked for.
"""

from lightopt.hardware._axes import Axis
from lightopt.hardware._camera_settings import CameraHere, CameraSettings
from lightopt.hardware._cameras import camera_drivers, cameras_here, check_camera_driver, open_camera
from lightopt.hardware._drivers import light_drivers
from lightopt.hardware._errors import LinkLostError, RefusedError, ReplyError
from lightopt.hardware._lights import LightSettings, LightsStillOnError, all_off
from lightopt.hardware._link import SerialLink
from lightopt.hardware._log import Event, SerialLog
from lightopt.hardware._ports import Port, port_problem, serial_ports
from lightopt.hardware._retry import frame_limit_s
from lightopt.hardware._roles import Camera, Frame, Identity, LightController, Stage, StageState
from lightopt.hardware._side_by_side import side_by_side
from lightopt.hardware._stages import StageDriver, check_stage, open_stage, stage_drivers

__all__ = [
    "Axis",
    "Camera",
    "CameraHere",
    "CameraSettings",
    "Event",
    "Frame",
    "Identity",
    "LightController",
    "LightSettings",
    "LightsStillOnError",
    "LinkLostError",
    "Port",
    "RefusedError",
    "ReplyError",
    "SerialLink",
    "SerialLog",
    "Stage",
    "StageDriver",
    "StageState",
    "all_off",
    "camera_drivers",
    "cameras_here",
    "check_camera_driver",
    "check_stage",
    "frame_limit_s",
    "light_drivers",
    "open_camera",
    "open_stage",
    "port_problem",
    "serial_ports",
    "side_by_side",
    "stage_drivers",
]
