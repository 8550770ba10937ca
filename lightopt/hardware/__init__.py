"""Devices of a rig behind three small roles, one module per protocol. The one home of pyserial."""

from lightopt.hardware._errors import LinkLostError, ReplyError
from lightopt.hardware._link import SerialLink
from lightopt.hardware._log import Event, SerialLog
from lightopt.hardware._ports import Port, serial_ports
from lightopt.hardware._roles import Camera, Frame, Identity, LightController, Stage, StageState

__all__ = [
    "Camera",
    "Event",
    "Frame",
    "Identity",
    "LightController",
    "LinkLostError",
    "Port",
    "ReplyError",
    "SerialLink",
    "SerialLog",
    "Stage",
    "StageState",
    "serial_ports",
]
