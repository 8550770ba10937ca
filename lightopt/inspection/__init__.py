"""Inspecting a part: its images fused into one without highlights, its defects found, measured and judged."""

from lightopt.inspection._aligned_set import LaidSet
from lightopt.inspection._calibrate import calibrate, calibrate_laid, refuse_too_few
from lightopt.inspection._calibration import CalibratedPosture, Calibration
from lightopt.inspection._calibration_file import CalibrationFolder, read_calibration
from lightopt.inspection._coverage import Coverage
from lightopt.inspection._defect_merging import KIND_COLOURS, FoundDefect, Kind
from lightopt.inspection._detection_score import SCALES_PX, score_deviations, threshold
from lightopt.inspection._deviation import Deviations, deviations
from lightopt.inspection._evaluation import (
    TrueSet,
    area_under_roc,
    compare_with_truth,
    defect_size,
    region_hits,
    summarise,
)
from lightopt.inspection._false_alarm_rates import least_rate, sets_needed
from lightopt.inspection._files import (
    REPORT_NAME,
    TRUTH_NAME,
    BatchFolder,
    InspectionFolder,
    inspection_provenance,
    truth_text,
)
from lightopt.inspection._fusion import FUSIONS, Fusion
from lightopt.inspection._grey import GreyPicture, grey_picture
from lightopt.inspection._ground_truth import TruthSource, truth_source
from lightopt.inspection._inspect import inspect_set
from lightopt.inspection._options import Detector, InspectOptions
from lightopt.inspection._part_registration import good_part, lay_over
from lightopt.inspection._pixel_weights import trust_weights
from lightopt.inspection._poisson import poisson_grid
from lightopt.inspection._posture_view import PostureView, posture_view
from lightopt.inspection._predict import predict
from lightopt.inspection._prediction_cache import Predictions
from lightopt.inspection._probability_of_detection import fit_detection
from lightopt.inspection._random_defect_files import defects_text, scatter_provenance, write_defects
from lightopt.inspection._random_defects import scatter_defects
from lightopt.inspection._region_splitting import separate_pieces
from lightopt.inspection._regions import find_regions
from lightopt.inspection._results import InspectedPosture, Inspection
from lightopt.inspection._surface import TOLD_CONTRAST, TOLD_DISC, SurfaceCoverage
from lightopt.inspection._surface_classes import CONTRASTS
from lightopt.inspection._synthetic import SyntheticImage, fuse_images
from lightopt.inspection._systematic import nominal_pixels, without_systematic
from lightopt.inspection._template import TEMPLATES, score_templates
from lightopt.inspection._template_scores import score_posture, synthetic_image
from lightopt.inspection._verdict import Verdict, judge

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
