"""Inspection of a part: prediction, detection and measurement of defects, verdict, and an image without highlights."""

from ._files import (
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
from ._inspect import InspectedSet, inspect_batch as inspect_batch, inspect_set as inspect_set
from ._options import InspectOptions as InspectOptions
from ._random_defects import (
    place_in_image,
    place_random_defects as place_random_defects,
    random_defect_provenance as random_defect_provenance,
    random_defects_text as random_defects_text,
)
from ._results import BatchRow, InspectedPosture, InspectionResult, Verdict, judge as judge, rejections
from .calibration._calibrate import calibrate, require_good_sets
from .calibration._calibration import Calibration, CalibrationFolder, least_rate, read_calibration
from .detection._coverage import CONTRASTS, REFERENCE_CONTRAST, REFERENCE_DEFECT, PostureCoverage, SurfaceCoverage
from .detection._defects import KIND_COLOURS, FoundDefect, Kind
from .evaluation._evaluation import SetEvaluation, evaluate_set, summarise, truth_sources
from .fusion._gradient_fusion import FUSIONS, Fusion
from .fusion._synthetic_image import SyntheticImage, synthetic_image
from .prediction._posture_view import PostureView, posture_view
from .prediction._predict import REFERENCES, predict
from .prediction._prediction_cache import PredictionCache
from .prediction._template_bank import entry_deviation, expected_deviation
