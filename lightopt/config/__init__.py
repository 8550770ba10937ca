"""Rig, part and batch files: strict YAML, every error at once with its line, frozen results.

Numbers stay in the units of the files (mm, degrees; the keys name them); :mod:`lightopt.scene` turns them
into physics.
"""

from lightopt.config._batch import BatchConfig, JobConfig
from lightopt.config._camera import CameraConfig, CameraDeviceConfig
from lightopt.config._defects import DefectConfig, PixelPlaceConfig
from lightopt.config._edit import copied_text, referenced_files, with_list, with_values
from lightopt.config._fields import MOST_BOUNCES, MOST_POINTS, points_problem
from lightopt.config._hardware import AxisConfig, ChannelConfig, ControllerConfig, HardwareConfig, StageDeviceConfig
from lightopt.config._light import RANGE_KEYS
from lightopt.config._load import (
    FileKind,
    LightsOnly,
    input_files,
    input_hashes,
    json_schema,
    load_batch,
    load_lights,
    load_part,
    load_ranges,
    load_rig,
    load_targets,
)
from lightopt.config._part import (
    MOST_ACROSS,
    InspectionConfig,
    PartConfig,
    PlacementConfig,
    ReflectanceConfig,
    RegionConfig,
)
from lightopt.config._pose import standing_at
from lightopt.config._ranges import RangesConfig
from lightopt.config._rig import LightConfig, RigConfig
from lightopt.config._targets import BoardTargetConfig as BoardTargetConfig, PlateTargetConfig, TargetsConfig
from lightopt.config._yaml_file import read_opencv_file
