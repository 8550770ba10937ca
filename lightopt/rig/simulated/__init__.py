"""A rig that is not there: simulated firmware and a camera that sees what the firmware does."""

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
