"""Choice of light positions, postures and exposures; tolerances of the angles; blind spots.

:func:`optimize` is the pipeline, from a rig and a part to a :class:`DesignResult`; :func:`write_design` and
:func:`finish_design` write its files.

Positions are scored on the levels that the camera would deliver at exposure 1. A combination is one candidate position
of each light; the objectives are integers, so that sums are exact in any order and ties are ties.
"""

from lightopt.design._blind_spots import (
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
from lightopt.design._candidates import AXES, Curve, find_candidates as find_candidates, place_of, place_text
from lightopt.design._files import DesignOutput, finish_design as finish_design, write_design as write_design
from lightopt.design._optimize import design_tolerances, optimize as optimize
from lightopt.design._problem import CalibratedThreshold, OptimizeOptions as OptimizeOptions, PlanOptions as PlanOptions
from lightopt.design._result import (
    LEFT_OUT_MEANING,
    DesignResult,
    ObjectiveResult,
    PlanResult,
    SetResult,
    places_of as places_of,
)
from lightopt.design._result_json import plan_document
from lightopt.design._tolerances import DEFAULT_TOLERANCE_TARGET, JointTolerances, Tolerances, WidestTolerance
from lightopt.design.from_images._optimize_from_images import (
    FromImagesOptions,
    FromImagesResult,
    finish_from_images,
    from_images_answer,
    optimize_from_images,
    write_from_images,
)
from lightopt.design.from_images._samples import agreement_text, synthesise
from lightopt.design.objectives import OBJECTIVES
from lightopt.design.objectives._detectability import DetectabilityObjective, deciding_text, finding_text
from lightopt.design.objectives._objective import Objective, area_text, near_meaning, share_text, shares_of
from lightopt.design.responses._evidence import DetectionModel
from lightopt.design.responses._image_evaluator import luminance_matrix as luminance_matrix
from lightopt.design.responses._luminance_matrix import Levels, LevelThresholds, LuminanceMatrix, area_units
from lightopt.design.responses._pairs import PlannedCatalogue, planned_catalogue
from lightopt.design.search._exact_search import search
