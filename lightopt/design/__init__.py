"""Choice of light positions, postures and exposures; tolerances of the angles; blind spots.

:func:`optimize` is the pipeline, from a rig and a part to a :class:`DesignResult`; :func:`write_design` and
:func:`finish_design` write its files.

Positions are scored on the levels that the camera would deliver at exposure 1. A combination is one candidate position
of each light; the objectives are integers, so that sums are exact in any order and ties are ties.
"""

from lightopt.design._blind_spots import (
    BLIND_CLASSES as BLIND_CLASSES,
    BLIND_LIGHTS as BLIND_LIGHTS,
    BLIND_SHARES_OF as BLIND_SHARES_OF,
    BlindReason as BlindReason,
    BlindSpots as BlindSpots,
    BlindSpotSummary as BlindSpotSummary,
    LegendRow as LegendRow,
    blind_class as blind_class,
    blind_classes as blind_classes,
    blind_colours as blind_colours,
    blind_legend as blind_legend,
    blind_text as blind_text,
)
from lightopt.design._candidates import (
    AXES as AXES,
    Curve as Curve,
    find_candidates as find_candidates,
    place_of as place_of,
    place_text as place_text,
)
from lightopt.design._files import (
    DesignOutput as DesignOutput,
    finish_design as finish_design,
    write_design as write_design,
)
from lightopt.design._optimize import design_tolerances as design_tolerances, optimize as optimize
from lightopt.design._problem import (
    CalibratedThreshold as CalibratedThreshold,
    OptimizeOptions as OptimizeOptions,
    PlanOptions as PlanOptions,
)
from lightopt.design._result import (
    LEFT_OUT_MEANING as LEFT_OUT_MEANING,
    DesignResult as DesignResult,
    ObjectiveResult as ObjectiveResult,
    PlanResult as PlanResult,
    SetResult as SetResult,
    places_of as places_of,
)
from lightopt.design._result_json import plan_document as plan_document
from lightopt.design._tolerances import (
    DEFAULT_TOLERANCE_TARGET as DEFAULT_TOLERANCE_TARGET,
    JointTolerances as JointTolerances,
    Tolerances as Tolerances,
    WidestTolerance as WidestTolerance,
)
from lightopt.design.from_images._optimize_from_images import (
    FromImagesOptions as FromImagesOptions,
    FromImagesResult as FromImagesResult,
    finish_from_images as finish_from_images,
    from_images_answer as from_images_answer,
    optimize_from_images as optimize_from_images,
    write_from_images as write_from_images,
)
from lightopt.design.from_images._samples import agreement_text as agreement_text, synthesise as synthesise
from lightopt.design.objectives import OBJECTIVES as OBJECTIVES
from lightopt.design.objectives._detectability import (
    DetectabilityObjective as DetectabilityObjective,
    deciding_text as deciding_text,
    finding_text as finding_text,
)
from lightopt.design.objectives._objective import (
    Objective as Objective,
    area_text as area_text,
    near_meaning as near_meaning,
    share_text as share_text,
    shares_of as shares_of,
)
from lightopt.design.responses._evidence import DetectionModel as DetectionModel
from lightopt.design.responses._image_evaluator import luminance_matrix as luminance_matrix
from lightopt.design.responses._luminance_matrix import (
    Levels as Levels,
    LevelThresholds as LevelThresholds,
    LuminanceMatrix as LuminanceMatrix,
    area_units as area_units,
)
from lightopt.design.responses._pairs import (
    PlannedCatalogue as PlannedCatalogue,
    planned_catalogue as planned_catalogue,
)
from lightopt.design.search._exact_search import search as search
