"""Rig, part and batch files: strict YAML, every error at once with its line, frozen results.

Numbers stay in the units of the files (mm, degrees; the keys name them); :mod:`lightopt.scene` turns them
into physics.
"""

from ._batch import JobConfig
from ._camera import CameraConfig, CameraDeviceConfig
from ._defects import DefectConfig, PixelPlaceConfig
from ._edit import copied_text, referenced_files, with_list, with_values
from ._fields import MOST_BOUNCES, MOST_POINTS, points_problem
from ._hardware import AxisConfig, ChannelConfig, ControllerConfig, HardwareConfig, PictureConfig, StageDeviceConfig
from ._light import HOUSED, RANGE_KEYS, LightConfig
from ._load import (
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
from ._part import (
    MOST_ACROSS,
    BrushingConfig,
    InspectionConfig,
    PartConfig,
    PlacementConfig,
    ReflectanceConfig,
    RegionConfig,
)
from ._pose import standing_at
from ._ranges import RangesConfig
from ._rig import RigConfig
from ._targets import READING_ERROR_DEG, BoardTargetConfig as BoardTargetConfig, PlateTargetConfig, TargetsConfig
from ._yaml_file import read_opencv_file
