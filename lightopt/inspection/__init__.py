"""Inspection of a part: prediction, detection and measurement of defects, verdict, and an image without highlights."""

from lightopt.inspection._files import (
    REPORT_NAME as REPORT_NAME,
    TRUTH_NAME as TRUTH_NAME,
    BatchFolder as BatchFolder,
    GreyPicture as GreyPicture,
    InspectionFolder as InspectionFolder,
    grey_picture as grey_picture,
    inspection_provenance as inspection_provenance,
    set_names as set_names,
    truth_text as truth_text,
)
from lightopt.inspection._inspect import (
    InspectedSet as InspectedSet,
    inspect_batch as inspect_batch,
    inspect_set as inspect_set,
)
from lightopt.inspection._options import InspectOptions as InspectOptions
from lightopt.inspection._random_defects import (
    place_in_image as place_in_image,
    place_random_defects as place_random_defects,
    random_defect_provenance as random_defect_provenance,
    random_defects_text as random_defects_text,
)
from lightopt.inspection._results import (
    BatchRow as BatchRow,
    InspectedPosture as InspectedPosture,
    InspectionResult as InspectionResult,
    Verdict as Verdict,
    judge as judge,
    rejections as rejections,
)
from lightopt.inspection.calibration._calibrate import calibrate as calibrate, require_good_sets as require_good_sets
from lightopt.inspection.calibration._calibration import (
    Calibration as Calibration,
    CalibrationFolder as CalibrationFolder,
    least_rate as least_rate,
    read_calibration as read_calibration,
)
from lightopt.inspection.detection._coverage import (
    CONTRASTS as CONTRASTS,
    REFERENCE_CONTRAST as REFERENCE_CONTRAST,
    REFERENCE_DEFECT as REFERENCE_DEFECT,
    PostureCoverage as PostureCoverage,
    SurfaceCoverage as SurfaceCoverage,
)
from lightopt.inspection.detection._defects import (
    KIND_COLOURS as KIND_COLOURS,
    FoundDefect as FoundDefect,
    Kind as Kind,
)
from lightopt.inspection.evaluation._evaluation import (
    SetEvaluation as SetEvaluation,
    evaluate_set as evaluate_set,
    summarise as summarise,
    truth_sources as truth_sources,
)
from lightopt.inspection.fusion._gradient_fusion import FUSIONS as FUSIONS, Fusion as Fusion
from lightopt.inspection.fusion._synthetic_image import (
    SyntheticImage as SyntheticImage,
    synthetic_image as synthetic_image,
)
from lightopt.inspection.prediction._posture_view import PostureView as PostureView, posture_view as posture_view
from lightopt.inspection.prediction._predict import REFERENCES as REFERENCES, predict as predict
from lightopt.inspection.prediction._prediction_cache import PredictionCache as PredictionCache
from lightopt.inspection.prediction._template_bank import (
    entry_deviation as entry_deviation,
    expected_deviation as expected_deviation,
)
