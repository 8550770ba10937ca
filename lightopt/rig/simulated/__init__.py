"""The virtual bench: simulated firmware on wires, and a camera that sees what the firmware does.

A new device is a module ``_light_NAME.py`` or ``_stage_NAME.py`` as ``_firmware.py`` says, and a line there. It must
not import the driver, nor the driver it: the two meet on the wire only.

``BenchProcess`` (``_process.py``) is the bench from outside; in its process ``_host.py`` serves the devices
(``_devices.py``) on their wires and the control socket (``_control.py``).
"""

from lightopt.rig.simulated._camera_client import VirtualCamera
from lightopt.rig.simulated._camera_setup import (
    EXPOSURE_RANGE_US,
    AxisWire,
    BenchTruth,
    CameraSetup,
    LightWire,
)
from lightopt.rig.simulated._gige import GigeCamera
from lightopt.rig.simulated._process import BenchProcess

__all__ = [
    "EXPOSURE_RANGE_US",
    "AxisWire",
    "BenchProcess",
    "BenchTruth",
    "CameraSetup",
    "GigeCamera",
    "LightWire",
    "VirtualCamera",
]
