"""Where the lights go: candidate positions, the luminance matrix, objectives, and the exact search over combinations.

Positions are scored on the levels that the camera would deliver at exposure 1. A combination is one candidate position
of each light; the objectives are integers, so that sums are exact in any order and ties are ties.
"""

from lightopt.optimize._candidates import Candidates, LeftOut, find_candidates
from lightopt.optimize._luminance import luminance_matrix
from lightopt.optimize._matrix import LuminanceMatrix, Thresholds, area_units
from lightopt.optimize._objective import Objective
from lightopt.optimize._objectives import OBJECTIVES, objectives_named
from lightopt.optimize._ranking import Ranked
from lightopt.optimize._search import DEFAULT_LIMIT, Found, search
from lightopt.optimize._space import Space

__all__ = [
    "DEFAULT_LIMIT",
    "OBJECTIVES",
    "Candidates",
    "Found",
    "LeftOut",
    "LuminanceMatrix",
    "Objective",
    "Ranked",
    "Space",
    "Thresholds",
    "area_units",
    "find_candidates",
    "luminance_matrix",
    "objectives_named",
    "search",
]
