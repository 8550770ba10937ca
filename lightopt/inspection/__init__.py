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
from lightopt.inspection._options import DETECTORS, InspectOptions
from lightopt.inspection._random_defects import (
    place_random_defects,
    random_defect_provenance,
    random_defects_text,
    write_random_defects,
)
from lightopt.inspection._results import BatchRow, InspectedPosture, InspectionResult, Verdict, judge, rejections
from lightopt.inspection.calibration._calibrate import calibrate, calibrate_registered, require_good_sets
from lightopt.inspection.calibration._calibration import (
    CalibratedPosture,
    Calibration,
    CalibrationFolder,
    least_rate,
    read_calibration,
    sets_needed,
)
from lightopt.inspection.calibration._systematic import subtract_systematic
from lightopt.inspection.detection._coverage import (
    CONTRASTS,
    REFERENCE_CONTRAST,
    REFERENCE_DEFECT,
    PostureCoverage,
    SurfaceCoverage,
)
from lightopt.inspection.detection._defects import KIND_COLOURS, FoundDefect, Kind
from lightopt.inspection.detection._deviation import Deviations, deviations
from lightopt.inspection.detection._matched_filter import TEMPLATES, score_templates
from lightopt.inspection.detection._regions import find_regions, split_regions
from lightopt.inspection.detection._residual_score import SCALES_PX, score_deviations, threshold
from lightopt.inspection.evaluation._evaluation import (
    SetEvaluation,
    area_under_roc,
    defect_size,
    evaluate_set,
    fit_detection_curve,
    region_hits,
    summarise,
)
from lightopt.inspection.evaluation._ground_truth import truth_sources
from lightopt.inspection.fusion._gradient_fusion import FUSIONS, Fusion, pixel_weights
from lightopt.inspection.fusion._poisson import poisson_grid
from lightopt.inspection.fusion._synthetic_image import SyntheticImage, fuse_images, synthetic_image
from lightopt.inspection.prediction._posture_view import PostureView, posture_view
from lightopt.inspection.prediction._predict import predict
from lightopt.inspection.prediction._prediction_cache import PredictionCache
from lightopt.inspection.prediction._registered_set import RegisteredSet, nominal_pixels, nominal_scene, register_part

__all__ = [
    "CONTRASTS",
    "DETECTORS",
    "FUSIONS",
    "KIND_COLOURS",
    "REFERENCE_CONTRAST",
    "REFERENCE_DEFECT",
    "REPORT_NAME",
    "SCALES_PX",
    "TEMPLATES",
    "TRUTH_NAME",
    "BatchFolder",
    "BatchRow",
    "CalibratedPosture",
    "Calibration",
    "CalibrationFolder",
    "Deviations",
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
    "PostureView",
    "PredictionCache",
    "RegisteredSet",
    "SetEvaluation",
    "SurfaceCoverage",
    "SyntheticImage",
    "Verdict",
    "area_under_roc",
    "calibrate",
    "calibrate_registered",
    "defect_size",
    "deviations",
    "evaluate_set",
    "find_regions",
    "fit_detection_curve",
    "fuse_images",
    "grey_picture",
    "inspect_batch",
    "inspect_set",
    "inspection_provenance",
    "judge",
    "least_rate",
    "nominal_pixels",
    "nominal_scene",
    "pixel_weights",
    "place_random_defects",
    "poisson_grid",
    "posture_view",
    "predict",
    "random_defect_provenance",
    "random_defects_text",
    "read_calibration",
    "region_hits",
    "register_part",
    "rejections",
    "require_good_sets",
    "score_deviations",
    "score_templates",
    "set_names",
    "sets_needed",
    "split_regions",
    "subtract_systematic",
    "summarise",
    "synthetic_image",
    "threshold",
    "truth_sources",
    "truth_text",
    "write_random_defects",
]
