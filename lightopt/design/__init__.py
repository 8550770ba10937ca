"""Choice of light positions, postures and exposures; tolerances of the angles; blind spots.

:func:`optimize` is the pipeline, from a rig and a part to a :class:`DesignResult`; :func:`write_design` and
:func:`finish_design` write its files.

Positions are scored on the levels that the camera would deliver at exposure 1. A combination is one candidate position
of each light; the objectives are integers, so that sums are exact in any order and ties are ties.
"""

from ._blind_spots import (
    BLIND_CLASSES,
    BLIND_LIGHTS,
    BLIND_SHARES_OF,
    BlindReason,
    BlindSpots,
    BlindSpotSummary,
    LegendRow,
    blind_class,
    blind_classes,
    blind_colours,
    blind_legend,
    blind_text,
)
from ._candidates import AXES, Curve, find_candidates as find_candidates, place_of, place_text
from ._files import DesignOutput, finish_design as finish_design, write_design as write_design
from ._optimize import design_tolerances, optimize as optimize
from ._problem import (
    CalibratedThreshold,
    OptimizeOptions as OptimizeOptions,
    PlanOptions as PlanOptions,
    check_options as check_options,
)
from ._result import LEFT_OUT_MEANING, DesignResult, ObjectiveResult, PlanResult, SetResult, places_of as places_of
from ._result_json import plan_document
from ._tolerances import DEFAULT_TOLERANCE_TARGET, JointTolerances, Tolerances, WidestTolerance
from .from_images._optimize_from_images import (
    FromImagesOptions,
    FromImagesResult,
    finish_from_images,
    from_images_answer,
    optimize_from_images,
    write_from_images,
)
from .from_images._samples import agreement_text, synthesise
from .objectives import OBJECTIVES
from .objectives._detectability import DetectabilityObjective, deciding_text, finding_text
from .objectives._objective import Objective, area_text, near_meaning, share_text, shares_of
from .responses._evidence import DetectionModel
from .responses._image_evaluator import luminance_matrix as luminance_matrix
from .responses._luminance_matrix import Levels, LevelThresholds, LuminanceMatrix, area_units
from .responses._pairs import PlannedCatalogue, planned_catalogue
from .search._between_steps import BETWEEN_MEANING
from .search._exact_search import search
