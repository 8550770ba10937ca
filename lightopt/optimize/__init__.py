"""Where the lights go: candidate positions, the luminance matrix, objectives, and the exact search over combinations.

Positions are scored on the levels that the camera would deliver at exposure 1. A combination is one candidate position
of each light; the objectives are integers, so that sums are exact in any order and ties are ties.
"""

from lightopt.optimize._appendix import APPENDED_NAMES, Appendix, Appraise, Outcome
from lightopt.optimize._bit_runs import flags_of
from lightopt.optimize._blind import (
    Blind,
    BlindSpots,
    Shown,
    blind_spots,
    blind_text,
    shown_by,
    shown_together,
)
from lightopt.optimize._blind_classes import (
    BLIND_CLASSES,
    BlindClass,
    Legend,
    LegendRow,
    blind_class,
    blind_classes,
    blind_legend,
)
from lightopt.optimize._blind_report import BLIND_LIGHTS, BLIND_SHARES_OF, BlindReport, Looked
from lightopt.optimize._candidates import Candidates, LeftOut, find_candidates
from lightopt.optimize._contrast import DEFAULT_CONTRAST, Contrast
from lightopt.optimize._count_runs import at_least, count_run_sums, up_to
from lightopt.optimize._curves import Curve, score_curves
from lightopt.optimize._detectability import Detectability
from lightopt.optimize._draft import Draft
from lightopt.optimize._earlier import RIG_NAME, refuse_other_result
from lightopt.optimize._inspection import Inspection
from lightopt.optimize._luminance import MOST_BYTES, luminance_matrices, luminance_matrix, matrix_bytes
from lightopt.optimize._matrix import AREA_UNIT_MM2, Levels, LuminanceMatrix, Thresholds, area_units
from lightopt.optimize._objective import NEAR_PER_MILLE, Objective, area_text, share_of_whole, share_text
from lightopt.optimize._objectives import OBJECTIVES, objectives_named
from lightopt.optimize._options import DEFAULT_SHADE_SHARE, OptimizeOptions, check_options
from lightopt.optimize._packed import add_image, added, word_weight
from lightopt.optimize._ranking import Ranked
from lightopt.optimize._result import Answer, SetResult, angles_of
from lightopt.optimize._rig_text import degrees_text
from lightopt.optimize._run import Optimum, optimize
from lightopt.optimize._search import DEFAULT_LIMIT, TABLE_CELLS, Found, search
from lightopt.optimize._space import Space, allowed_mask
from lightopt.optimize._trials import DIRECTIONS, Trial, unroll
from lightopt.optimize._visibility import Visibility, taken_rows, trial_planes
from lightopt.optimize._words import (
    LEFT_OUT_MEANING,
    gap_text,
    left_out_text,
    looked_text,
    near_meaning,
    near_text,
    patches_text,
    score_text,
    shown_text,
    ties_text,
)

__all__ = [
    "APPENDED_NAMES",
    "AREA_UNIT_MM2",
    "BLIND_CLASSES",
    "BLIND_LIGHTS",
    "BLIND_SHARES_OF",
    "DEFAULT_CONTRAST",
    "DEFAULT_LIMIT",
    "DEFAULT_SHADE_SHARE",
    "DIRECTIONS",
    "LEFT_OUT_MEANING",
    "MOST_BYTES",
    "NEAR_PER_MILLE",
    "OBJECTIVES",
    "RIG_NAME",
    "TABLE_CELLS",
    "Answer",
    "Appendix",
    "Appraise",
    "Blind",
    "BlindClass",
    "BlindReport",
    "BlindSpots",
    "Candidates",
    "Contrast",
    "Curve",
    "Detectability",
    "Draft",
    "Found",
    "Inspection",
    "LeftOut",
    "Legend",
    "LegendRow",
    "Levels",
    "Looked",
    "LuminanceMatrix",
    "Objective",
    "OptimizeOptions",
    "Optimum",
    "Outcome",
    "Ranked",
    "SetResult",
    "Shown",
    "Space",
    "Thresholds",
    "Trial",
    "Visibility",
    "add_image",
    "added",
    "allowed_mask",
    "angles_of",
    "area_text",
    "area_units",
    "at_least",
    "blind_class",
    "blind_classes",
    "blind_legend",
    "blind_spots",
    "blind_text",
    "check_options",
    "count_run_sums",
    "degrees_text",
    "find_candidates",
    "flags_of",
    "gap_text",
    "left_out_text",
    "looked_text",
    "luminance_matrices",
    "luminance_matrix",
    "matrix_bytes",
    "near_meaning",
    "near_text",
    "objectives_named",
    "optimize",
    "patches_text",
    "refuse_other_result",
    "score_curves",
    "score_text",
    "search",
    "share_of_whole",
    "share_text",
    "shown_by",
    "shown_text",
    "shown_together",
    "taken_rows",
    "ties_text",
    "trial_planes",
    "unroll",
    "up_to",
    "word_weight",
]
