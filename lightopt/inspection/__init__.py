"""Inspecting a part: its images fused into one without highlights, its defects found, measured and judged."""

from lightopt.inspection._calibrate import calibrate, calibrate_laid, refuse_too_few
from lightopt.inspection._calibration import CALIBRATION_NAME, CalibratedPosture, Calibration
from lightopt.inspection._calibration_file import CalibrationFolder, read_calibration
from lightopt.inspection._coverage import Coverage, measure_coverage
from lightopt.inspection._deviation import Deviations, deviations
from lightopt.inspection._fusion import FUSIONS, Fusion
from lightopt.inspection._grey import GreyPicture, grey_picture
from lightopt.inspection._inspect import inspect_set
from lightopt.inspection._inspection import InspectedPosture, Inspection
from lightopt.inspection._laid_set import LaidSet, lay_set
from lightopt.inspection._made_for import made_for
from lightopt.inspection._measure import measure_regions
from lightopt.inspection._options import DETECTORS, Detector, InspectOptions
from lightopt.inspection._photometry import Photometry
from lightopt.inspection._pieces import separate_pieces
from lightopt.inspection._pod import DetectionCurve, fit_detection
from lightopt.inspection._poisson import PoissonGrid, poisson_grid
from lightopt.inspection._predict import Prediction, predict
from lightopt.inspection._predictions import Predictions
from lightopt.inspection._rates import CONFIDENCE, held_threshold, least_rate, sets_needed
from lightopt.inspection._regions import find_regions
from lightopt.inspection._register import good_part, lay_over
from lightopt.inspection._score import SCALES_PX, rank_probability, score_deviations, threshold
from lightopt.inspection._shares import CONTRASTS, Reached
from lightopt.inspection._sightings import KIND_COLOURS, FoundDefect, Kind, Sighting, gather
from lightopt.inspection._slopes import Slopes, node_steps, prediction_slopes, shifted
from lightopt.inspection._surface import (
    TOLD_CONTRAST,
    TOLD_DISC,
    SurfaceCoverage,
    SurfaceMap,
    map_surface,
    surface_coverage,
)
from lightopt.inspection._synthetic import SyntheticImage, fuse_images
from lightopt.inspection._template import score_templates, templates
from lightopt.inspection._trust import trust_weights
from lightopt.inspection._truth import (
    KnownDefect,
    TrueSet,
    area_under_roc,
    compare_with_truth,
    defect_size,
    region_hits,
    summarise,
)
from lightopt.inspection._truth_source import TruthSource, truth_source
from lightopt.inspection._verdict import Verdict, judge
from lightopt.inspection._view import PostureView, posture_view
from lightopt.inspection._write import (
    BATCH_NAME,
    DEFECTS_NAME,
    REPORT_NAME,
    TRUTH_NAME,
    BatchFolder,
    InspectionFolder,
    inspection_provenance,
    truth_text,
)

__all__ = [
    "BATCH_NAME",
    "CALIBRATION_NAME",
    "CONFIDENCE",
    "CONTRASTS",
    "DEFECTS_NAME",
    "DETECTORS",
    "FUSIONS",
    "KIND_COLOURS",
    "REPORT_NAME",
    "SCALES_PX",
    "TOLD_CONTRAST",
    "TOLD_DISC",
    "TRUTH_NAME",
    "BatchFolder",
    "CalibratedPosture",
    "Calibration",
    "CalibrationFolder",
    "Coverage",
    "DetectionCurve",
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
    "KnownDefect",
    "LaidSet",
    "Photometry",
    "PoissonGrid",
    "PostureView",
    "Prediction",
    "Predictions",
    "Reached",
    "Sighting",
    "Slopes",
    "SurfaceCoverage",
    "SurfaceMap",
    "SyntheticImage",
    "TrueSet",
    "TruthSource",
    "Verdict",
    "area_under_roc",
    "calibrate",
    "calibrate_laid",
    "compare_with_truth",
    "defect_size",
    "deviations",
    "find_regions",
    "fit_detection",
    "fuse_images",
    "gather",
    "good_part",
    "grey_picture",
    "held_threshold",
    "inspect_set",
    "inspection_provenance",
    "judge",
    "lay_over",
    "lay_set",
    "least_rate",
    "made_for",
    "map_surface",
    "measure_coverage",
    "measure_regions",
    "node_steps",
    "poisson_grid",
    "posture_view",
    "predict",
    "prediction_slopes",
    "rank_probability",
    "read_calibration",
    "refuse_too_few",
    "region_hits",
    "score_deviations",
    "score_templates",
    "separate_pieces",
    "sets_needed",
    "shifted",
    "summarise",
    "surface_coverage",
    "templates",
    "threshold",
    "trust_weights",
    "truth_source",
    "truth_text",
]
