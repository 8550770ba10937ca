"""Inspecting a part: its images fused into one without highlights, its defects found, measured and judged."""

from lightopt.inspection._batch import InspectedSet, inspect_batch
from lightopt.inspection._files import (
    REPORT_NAME,
    TRUTH_NAME,
    BatchFolder,
    InspectionFolder,
    inspection_provenance,
    set_names,
    truth_text,
)
from lightopt.inspection._grey_picture import GreyPicture, grey_picture
from lightopt.inspection._inspect import inspect_set
from lightopt.inspection._options import FUSIONS, Detector, Fusion, InspectOptions
from lightopt.inspection._random_defect_files import (
    random_defect_provenance,
    random_defects_text,
    write_random_defects,
)
from lightopt.inspection._random_defects import place_random_defects
from lightopt.inspection._results import InspectedPosture, InspectionResult, Verdict, judge
from lightopt.inspection.calibration._calibrate import calibrate, calibrate_registered, require_good_sets
from lightopt.inspection.calibration._calibration import CalibratedPosture, Calibration
from lightopt.inspection.calibration._calibration_file import CalibrationFolder, read_calibration
from lightopt.inspection.calibration._false_alarm_rates import least_rate, sets_needed
from lightopt.inspection.calibration._systematic import subtract_systematic
from lightopt.inspection.detection._coverage import CONTRASTS, PostureCoverage
from lightopt.inspection.detection._defects import KIND_COLOURS, FoundDefect, Kind
from lightopt.inspection.detection._deviation import Deviations, deviations
from lightopt.inspection.detection._regions import find_regions, split_regions
from lightopt.inspection.detection._score import SCALES_PX, score_deviations, threshold
from lightopt.inspection.detection._surface_coverage import (
    REFERENCE_CONTRAST,
    REFERENCE_DEFECT,
    SurfaceCoverage,
)
from lightopt.inspection.detection._template import TEMPLATES, score_posture, score_templates
from lightopt.inspection.evaluation._evaluation import (
    SetEvaluation,
    area_under_roc,
    defect_size,
    evaluate_set,
    region_hits,
    summarise,
)
from lightopt.inspection.evaluation._ground_truth import truth_sources
from lightopt.inspection.evaluation._probability_of_detection import fit_detection_curve
from lightopt.inspection.fusion._pixel_weights import pixel_weights
from lightopt.inspection.fusion._poisson import poisson_grid
from lightopt.inspection.fusion._synthetic_image import SyntheticImage, fuse_images, synthetic_image
from lightopt.inspection.prediction._frames import nominal_pixels
from lightopt.inspection.prediction._posture_view import PostureView, posture_view
from lightopt.inspection.prediction._predict import predict
from lightopt.inspection.prediction._prediction_cache import PredictionCache
from lightopt.inspection.prediction._registered_set import RegisteredSet, nominal_scene, register_part

__all__ = [
    "CONTRASTS",
    "FUSIONS",
    "KIND_COLOURS",
    "REFERENCE_CONTRAST",
    "REFERENCE_DEFECT",
    "REPORT_NAME",
    "SCALES_PX",
    "TEMPLATES",
    "TRUTH_NAME",
    "BatchFolder",
    "CalibratedPosture",
    "Calibration",
    "CalibrationFolder",
    "Detector",
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
    "require_good_sets",
    "score_deviations",
    "score_posture",
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
