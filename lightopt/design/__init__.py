"""Where the lights go, in which postures and at which exposures; how exactly the angles must hold; what stays unseen.

:func:`optimize` is the pipeline, from a rig and a part to a :class:`DesignResult`; :func:`write_design` and
:func:`finish_design` write its files.

Positions are scored on the levels that the camera would deliver at exposure 1. A combination is one candidate position
of each light; the objectives are integers, so that sums are exact in any order and ties are ties.
"""

from lightopt.design._candidates import find_candidates
from lightopt.design._files import DesignOutput, finish_design, write_design
from lightopt.design._optimize import optimize
from lightopt.design._options import OptimizeOptions, PlanOptions
from lightopt.design._result import LEFT_OUT_MEANING, DesignResult, ObjectiveResult, PlanResult, SetResult, angles_of
from lightopt.design._result_json import plan_document
from lightopt.design._tolerances import PairAssessment, Setup, Tolerances, analyse_tolerances
from lightopt.design.blind_spots._blind_spots import (
    BLIND_LIGHTS,
    BLIND_SHARES_OF,
    BlindReason,
    BlindSpots,
    BlindSpotSummary,
    blind_text,
)
from lightopt.design.blind_spots._files import (
    BLIND_CLASSES,
    LegendRow,
    blind_class,
    blind_classes,
    blind_colours,
    blind_legend,
)
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.objectives._objective import Objective, area_text, near_meaning, share_text, shares_of
from lightopt.design.objectives._registry import OBJECTIVES
from lightopt.design.postures._choice import PostureChoice, PostureRequest
from lightopt.design.postures._light_positions import place_lights
from lightopt.design.postures._plan_postures import TargetNotReached
from lightopt.design.postures._posture_search import choose_postures
from lightopt.design.responses._defect_hypotheses import DIRECTIONS, DefectHypothesis, defect_hypotheses
from lightopt.design.responses._detection import Contrast, DetectionModel
from lightopt.design.responses._image_evaluator import DRAWN_PATCHES, ImageEvaluator, drawn_patches, luminance_matrix
from lightopt.design.responses._luminance_matrix import Levels, LevelThresholds, LuminanceMatrix, Visibility, area_units
from lightopt.design.responses._packed_bits import counts_of_images, unpack_flags
from lightopt.design.search._curves import Curve
from lightopt.design.search._exact_search import search

__all__ = [
    "BLIND_CLASSES",
    "BLIND_LIGHTS",
    "BLIND_SHARES_OF",
    "DIRECTIONS",
    "DRAWN_PATCHES",
    "LEFT_OUT_MEANING",
    "OBJECTIVES",
    "BlindReason",
    "BlindSpotSummary",
    "BlindSpots",
    "Contrast",
    "Curve",
    "DefectHypothesis",
    "DesignOutput",
    "DesignResult",
    "DetectabilityObjective",
    "DetectionModel",
    "ImageEvaluator",
    "LegendRow",
    "LevelThresholds",
    "Levels",
    "LuminanceMatrix",
    "Objective",
    "ObjectiveResult",
    "OptimizeOptions",
    "PairAssessment",
    "PlanOptions",
    "PlanResult",
    "PostureChoice",
    "PostureRequest",
    "SetResult",
    "Setup",
    "TargetNotReached",
    "Tolerances",
    "Visibility",
    "analyse_tolerances",
    "angles_of",
    "area_text",
    "area_units",
    "blind_class",
    "blind_classes",
    "blind_colours",
    "blind_legend",
    "blind_text",
    "choose_postures",
    "counts_of_images",
    "defect_hypotheses",
    "drawn_patches",
    "find_candidates",
    "finish_design",
    "luminance_matrix",
    "near_meaning",
    "optimize",
    "place_lights",
    "plan_document",
    "search",
    "share_text",
    "shares_of",
    "unpack_flags",
    "write_design",
]
