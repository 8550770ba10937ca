"""Rig and part files: strict YAML, every error at once with its line, frozen results.

Numbers stay in the units of the files (mm, degrees; the keys name them); :mod:`lightopt.scene` turns them
into physics.
"""

from lightopt.config._camera import CameraConfig, DistortionConfig, SensorConfig
from lightopt.config._defects import CatalogueEntryConfig, DefectConfig, PixelPlaceConfig
from lightopt.config._edit import with_list, with_values
from lightopt.config._hardware import (
    AxisConfig,
    CameraDeviceConfig,
    ChannelConfig,
    ControllerConfig,
    HardwareConfig,
    StageDeviceConfig,
    TemplateConfig,
    TimingConfig,
)
from lightopt.config._input_hashes import input_hashes
from lightopt.config._inspection import InspectionConfig
from lightopt.config._lights import LightConfig, LightSourceConfig
from lightopt.config._load import load_part, load_rig
from lightopt.config._load_lights import LightsOnly, load_lights
from lightopt.config._part import MeshConfig, PartConfig, PlacementConfig, ReflectanceConfig
from lightopt.config._points import points_problem
from lightopt.config._posture import PostureConfig
from lightopt.config._relocate import copied_text
from lightopt.config._rig import RigConfig, StageConfig
from lightopt.config._schema import json_schema
from lightopt.config._source import Source

__all__ = [
    "AxisConfig",
    "CameraConfig",
    "CameraDeviceConfig",
    "CatalogueEntryConfig",
    "ChannelConfig",
    "ControllerConfig",
    "DefectConfig",
    "DistortionConfig",
    "HardwareConfig",
    "InspectionConfig",
    "LightConfig",
    "LightSourceConfig",
    "LightsOnly",
    "MeshConfig",
    "PartConfig",
    "PixelPlaceConfig",
    "PlacementConfig",
    "PostureConfig",
    "ReflectanceConfig",
    "RigConfig",
    "SensorConfig",
    "Source",
    "StageConfig",
    "StageDeviceConfig",
    "TemplateConfig",
    "TimingConfig",
    "copied_text",
    "input_hashes",
    "json_schema",
    "load_lights",
    "load_part",
    "load_rig",
    "points_problem",
    "with_list",
    "with_values",
]
