"""Where the lights go: candidate positions, the luminance matrix, objectives, and the exact search over combinations.

Positions are scored on the levels that the camera would deliver at exposure 1. A combination is one candidate position
of each light; the objectives are integers, so that sums are exact in any order and ties are ties.
"""

from lightopt.optimize._candidates import Candidates, LeftOut, find_candidates
from lightopt.optimize._curves import Curve
from lightopt.optimize._draft import Draft
from lightopt.optimize._luminance import luminance_matrix
from lightopt.optimize._matrix import AREA_UNIT_MM2, Levels, LuminanceMatrix, Thresholds, area_units
from lightopt.optimize._objective import Objective
from lightopt.optimize._objectives import OBJECTIVES, objectives_named
from lightopt.optimize._options import DEFAULT_SHADE_SHARE, OptimizeOptions
from lightopt.optimize._ranking import Ranked
from lightopt.optimize._result import Answer, SetResult, angles_of
from lightopt.optimize._run import Optimum, optimize
from lightopt.optimize._search import DEFAULT_LIMIT, Found, search
from lightopt.optimize._space import Space
from lightopt.optimize._words import gap_text, looked_text, score_text, ties_text

__all__ = [
    "AREA_UNIT_MM2",
    "DEFAULT_LIMIT",
    "DEFAULT_SHADE_SHARE",
    "OBJECTIVES",
    "Answer",
    "Candidates",
    "Curve",
    "Draft",
    "Found",
    "LeftOut",
    "Levels",
    "LuminanceMatrix",
    "Objective",
    "OptimizeOptions",
    "Optimum",
    "Ranked",
    "SetResult",
    "Space",
    "Thresholds",
    "angles_of",
    "area_units",
    "find_candidates",
    "gap_text",
    "looked_text",
    "luminance_matrix",
    "objectives_named",
    "optimize",
    "score_text",
    "search",
    "ties_text",
]
