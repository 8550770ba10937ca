"""Where the lights go: candidate positions, the luminance matrix, objectives, and the exact search over combinations.

Positions are scored on the levels that the camera would deliver at exposure 1. A combination is one candidate position
of each light; the objectives are integers, so that sums are exact in any order and ties are ties.
"""

from lightopt.optimize._blind import Blind, BlindSpots, blind_codes, blind_spots, blind_text
from lightopt.optimize._candidates import Candidates, LeftOut, find_candidates
from lightopt.optimize._contrast import DEFAULT_CONTRAST, Contrast
from lightopt.optimize._detectability import Detectability
from lightopt.optimize._inspection import Inspection
from lightopt.optimize._luminance import luminance_matrices, luminance_matrix
from lightopt.optimize._matrix import LuminanceMatrix, Thresholds, area_units
from lightopt.optimize._objective import Objective
from lightopt.optimize._objectives import OBJECTIVES, objectives_named
from lightopt.optimize._options import DEFAULT_SHADE_SHARE, OptimizeOptions
from lightopt.optimize._ranking import Ranked
from lightopt.optimize._result import Answer, SetResult, angles_of
from lightopt.optimize._run import Optimum, optimize
from lightopt.optimize._search import DEFAULT_LIMIT, Found, search
from lightopt.optimize._space import Space
from lightopt.optimize._trials import DIRECTIONS, Trial, unroll
from lightopt.optimize._visibility import Visibility

__all__ = [
    "DEFAULT_CONTRAST",
    "DEFAULT_LIMIT",
    "DEFAULT_SHADE_SHARE",
    "DIRECTIONS",
    "OBJECTIVES",
    "Answer",
    "Blind",
    "BlindSpots",
    "Candidates",
    "Contrast",
    "Detectability",
    "Found",
    "Inspection",
    "LeftOut",
    "LuminanceMatrix",
    "Objective",
    "OptimizeOptions",
    "Optimum",
    "Ranked",
    "SetResult",
    "Space",
    "Thresholds",
    "Trial",
    "Visibility",
    "angles_of",
    "area_units",
    "blind_codes",
    "blind_spots",
    "blind_text",
    "find_candidates",
    "luminance_matrices",
    "luminance_matrix",
    "objectives_named",
    "optimize",
    "search",
    "unroll",
]
