"""Inspecting a part: its images fused into one without highlights, its defects found, measured and judged."""

from lightopt.inspection._files import (
    REPORT_NAME,
    TRUTH_NAME,
    BatchFolder,
    InspectionFolder,
    inspection_provenance,
    truth_text,
)
from lightopt.inspection._grey_picture import GreyPicture, grey_picture
from lightopt.inspection._inspect import inspect_set
from lightopt.inspection._options import Detector, InspectOptions
from lightopt.inspection._random_defect_files import defects_text, scatter_provenance, write_defects
from lightopt.inspection._random_defects import scatter_defects
from lightopt.inspection._results import InspectedPosture, Inspection, Verdict, judge
from lightopt.inspection.calibration._calibrate import calibrate, calibrate_laid, refuse_too_few
from lightopt.inspection.calibration._calibration import CalibratedPosture, Calibration
from lightopt.inspection.calibration._calibration_file import CalibrationFolder, read_calibration
from lightopt.inspection.calibration._false_alarm_rates import least_rate, sets_needed
from lightopt.inspection.calibration._systematic import without_systematic
from lightopt.inspection.detection._coverage import CONTRASTS, Coverage
from lightopt.inspection.detection._defects import KIND_COLOURS, FoundDefect, Kind
from lightopt.inspection.detection._deviation import Deviations, deviations
from lightopt.inspection.detection._regions import find_regions, separate_pieces
from lightopt.inspection.detection._score import SCALES_PX, score_deviations, threshold
from lightopt.inspection.detection._surface_coverage import TOLD_CONTRAST, TOLD_DISC, SurfaceCoverage
from lightopt.inspection.detection._template import TEMPLATES, score_posture, score_templates
from lightopt.inspection.evaluation._evaluation import (
    TrueSet,
    area_under_roc,
    compare_with_truth,
    defect_size,
    region_hits,
    summarise,
)
from lightopt.inspection.evaluation._ground_truth import TruthSource, truth_source
from lightopt.inspection.evaluation._probability_of_detection import fit_detection
from lightopt.inspection.fusion._gradient_fusion import FUSIONS, Fusion
from lightopt.inspection.fusion._pixel_weights import trust_weights
from lightopt.inspection.fusion._poisson import poisson_grid
from lightopt.inspection.fusion._synthetic_image import SyntheticImage, fuse_images, synthetic_image
from lightopt.inspection.prediction._frames import nominal_pixels
from lightopt.inspection.prediction._posture_view import PostureView, posture_view
from lightopt.inspection.prediction._predict import predict
from lightopt.inspection.prediction._prediction_cache import Predictions
from lightopt.inspection.prediction._registered_set import LaidSet, good_part, lay_over

__all__ = [
    "CONTRASTS",
    "FUSIONS",
    "KIND_COLOURS",
    "REPORT_NAME",
    "SCALES_PX",
    "TEMPLATES",
    "TOLD_CONTRAST",
    "TOLD_DISC",
    "TRUTH_NAME",
    "BatchFolder",
    "CalibratedPosture",
    "Calibration",
    "CalibrationFolder",
    "Coverage",
    "Detector",
    "Deviations",
    "FoundDefect",
    "Fusion",
    "GreyPicture",
    "InspectOptions",
    "InspectedPosture",
    "Inspection",
    "InspectionFolder",
    "Kind",
    "LaidSet",
    "PostureView",
    "Predictions",
    "SurfaceCoverage",
    "SyntheticImage",
    "TrueSet",
    "TruthSource",
    "Verdict",
    "area_under_roc",
    "calibrate",
    "calibrate_laid",
    "compare_with_truth",
    "defect_size",
    "defects_text",
    "deviations",
    "find_regions",
    "fit_detection",
    "fuse_images",
    "good_part",
    "grey_picture",
    "inspect_set",
    "inspection_provenance",
    "judge",
    "lay_over",
    "least_rate",
    "nominal_pixels",
    "poisson_grid",
    "posture_view",
    "predict",
    "read_calibration",
    "refuse_too_few",
    "region_hits",
    "scatter_defects",
    "scatter_provenance",
    "score_deviations",
    "score_posture",
    "score_templates",
    "separate_pieces",
    "sets_needed",
    "summarise",
    "synthetic_image",
    "threshold",
    "trust_weights",
    "truth_source",
    "truth_text",
    "without_systematic",
    "write_defects",
]
