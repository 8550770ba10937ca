"""Rig and part files: strict YAML, every error at once with its line, frozen results.

Numbers stay in the units of the files (mm, degrees; the keys name them); :mod:`lightopt.scene` turns them
into physics.
"""

from lightopt.config._camera import CameraConfig, CameraDeviceConfig
from lightopt.config._defects import DefectConfig, PixelPlaceConfig
from lightopt.config._edit import copied_text, with_list
from lightopt.config._fields import MOST_POINTS, points_problem
from lightopt.config._hardware import AxisConfig, ChannelConfig, ControllerConfig, HardwareConfig, StageDeviceConfig
from lightopt.config._load import LightsOnly, input_hashes, json_schema, load_lights, load_part, load_rig
from lightopt.config._part import InspectionConfig, PartConfig, PlacementConfig
from lightopt.config._rig import LightConfig, RigConfig
from lightopt.config._source import Source

__all__ = [
    "MOST_POINTS",
    "AxisConfig",
    "CameraConfig",
    "CameraDeviceConfig",
    "ChannelConfig",
    "ControllerConfig",
    "DefectConfig",
    "HardwareConfig",
    "InspectionConfig",
    "LightConfig",
    "LightsOnly",
    "PartConfig",
    "PixelPlaceConfig",
    "PlacementConfig",
    "RigConfig",
    "Source",
    "StageDeviceConfig",
    "copied_text",
    "input_hashes",
    "json_schema",
    "load_lights",
    "load_part",
    "load_rig",
    "points_problem",
    "with_list",
]
