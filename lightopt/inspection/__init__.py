"""Inspecting a part: its images fused into one without highlights, its defects found, measured and judged."""

from lightopt.inspection._files import (
    REPORT_NAME,
    TRUTH_NAME,
    BatchFolder,
    GreyPicture,
    InspectionFolder,
    grey_picture,
    inspection_provenance,
    set_names,
    truth_text,
)
from lightopt.inspection._inspect import InspectedSet, inspect_batch, inspect_set
from lightopt.inspection._options import InspectOptions
from lightopt.inspection._random_defects import (
    place_random_defects,
    random_defect_provenance,
    random_defects_text,
    write_random_defects,
)
from lightopt.inspection._results import BatchRow, InspectedPosture, InspectionResult, Verdict, judge, rejections
from lightopt.inspection.calibration._calibrate import calibrate, require_good_sets
from lightopt.inspection.calibration._calibration import Calibration, CalibrationFolder, least_rate, read_calibration
from lightopt.inspection.detection._coverage import (
    CONTRASTS,
    REFERENCE_CONTRAST,
    REFERENCE_DEFECT,
    PostureCoverage,
    SurfaceCoverage,
)
from lightopt.inspection.detection._defects import KIND_COLOURS, FoundDefect, Kind
from lightopt.inspection.evaluation._evaluation import SetEvaluation, summarise
from lightopt.inspection.evaluation._ground_truth import truth_sources
from lightopt.inspection.fusion._gradient_fusion import Fusion

__all__ = [
    "CONTRASTS",
    "KIND_COLOURS",
    "REFERENCE_CONTRAST",
    "REFERENCE_DEFECT",
    "REPORT_NAME",
    "TRUTH_NAME",
    "BatchFolder",
    "BatchRow",
    "Calibration",
    "CalibrationFolder",
    "FoundDefect",
    "Fusion",
    "GreyPicture",
    "InspectOptions",
    "InspectedPosture",
    "InspectedSet",
    "InspectionFolder",
    "InspectionResult",
    "Kind",
    "PostureCoverage",
    "SetEvaluation",
    "SurfaceCoverage",
    "Verdict",
    "calibrate",
    "grey_picture",
    "inspect_batch",
    "inspect_set",
    "inspection_provenance",
    "judge",
    "least_rate",
    "place_random_defects",
    "random_defect_provenance",
    "random_defects_text",
    "read_calibration",
    "rejections",
    "require_good_sets",
    "set_names",
    "summarise",
    "truth_sources",
    "truth_text",
    "write_random_defects",
]
