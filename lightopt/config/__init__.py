"""Rig, part and batch files: strict YAML, every error at once with its line, frozen results.

Numbers stay in the units of the files (mm, degrees; the keys name them); :mod:`lightopt.scene` turns them
into physics.
"""

from lightopt.config._batch import BatchConfig as BatchConfig, JobConfig as JobConfig
from lightopt.config._camera import CameraConfig as CameraConfig, CameraDeviceConfig as CameraDeviceConfig
from lightopt.config._defects import DefectConfig as DefectConfig, PixelPlaceConfig as PixelPlaceConfig
from lightopt.config._edit import (
    copied_text as copied_text,
    referenced_files as referenced_files,
    with_list as with_list,
    with_values as with_values,
)
from lightopt.config._fields import (
    MOST_BOUNCES as MOST_BOUNCES,
    MOST_POINTS as MOST_POINTS,
    points_problem as points_problem,
)
from lightopt.config._hardware import (
    AxisConfig as AxisConfig,
    ChannelConfig as ChannelConfig,
    ControllerConfig as ControllerConfig,
    HardwareConfig as HardwareConfig,
    StageDeviceConfig as StageDeviceConfig,
)
from lightopt.config._light import RANGE_KEYS as RANGE_KEYS
from lightopt.config._load import (
    FileKind as FileKind,
    LightsOnly as LightsOnly,
    input_files as input_files,
    input_hashes as input_hashes,
    json_schema as json_schema,
    load_batch as load_batch,
    load_lights as load_lights,
    load_part as load_part,
    load_ranges as load_ranges,
    load_rig as load_rig,
    load_targets as load_targets,
)
from lightopt.config._part import (
    MOST_ACROSS as MOST_ACROSS,
    InspectionConfig as InspectionConfig,
    PartConfig as PartConfig,
    PlacementConfig as PlacementConfig,
    ReflectanceConfig as ReflectanceConfig,
    RegionConfig as RegionConfig,
)
from lightopt.config._pose import standing_at as standing_at
from lightopt.config._ranges import RangesConfig as RangesConfig
from lightopt.config._rig import LightConfig as LightConfig, RigConfig as RigConfig
from lightopt.config._targets import (
    BoardTargetConfig as BoardTargetConfig,
    PlateTargetConfig as PlateTargetConfig,
    TargetsConfig as TargetsConfig,
)
from lightopt.config._yaml_file import read_opencv_file as read_opencv_file
