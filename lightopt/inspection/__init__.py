"""Inspection of a part: prediction, detection and measurement of defects, verdict, and an image without highlights."""

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
from lightopt.inspection._inspect import InspectedSet, inspect_batch as inspect_batch, inspect_set as inspect_set
from lightopt.inspection._options import InspectOptions as InspectOptions
from lightopt.inspection._random_defects import (
    place_in_image,
    place_random_defects as place_random_defects,
    random_defect_provenance as random_defect_provenance,
    random_defects_text as random_defects_text,
)
from lightopt.inspection._results import (
    BatchRow,
    InspectedPosture,
    InspectionResult,
    Verdict,
    judge as judge,
    rejections,
)
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
from lightopt.inspection.evaluation._evaluation import SetEvaluation, evaluate_set, summarise, truth_sources
from lightopt.inspection.fusion._gradient_fusion import FUSIONS, Fusion
from lightopt.inspection.fusion._synthetic_image import SyntheticImage, synthetic_image
from lightopt.inspection.prediction._posture_view import PostureView, posture_view
from lightopt.inspection.prediction._predict import REFERENCES, predict
from lightopt.inspection.prediction._prediction_cache import PredictionCache
from lightopt.inspection.prediction._template_bank import entry_deviation, expected_deviation
