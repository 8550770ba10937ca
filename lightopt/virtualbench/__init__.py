"""A rig that is not there: simulated firmware and a camera that sees what the firmware does."""

from lightopt.virtualbench._camera import EXPOSURE_RANGE_US, AxisWire, CameraSetup, LightWire
from lightopt.virtualbench._camera_client import VirtualCamera
from lightopt.virtualbench._process import BenchProcess
from lightopt.virtualbench._truth import BenchTruth

__all__ = [
    "EXPOSURE_RANGE_US",
    "AxisWire",
    "BenchProcess",
    "BenchTruth",
    "CameraSetup",
    "LightWire",
    "VirtualCamera",
]
