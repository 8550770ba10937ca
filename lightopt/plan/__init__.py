"""Which postures, which exposures, and how exactly the machine must hold its angles.

What is planned for are *pairs* of a patch of the surface and a defect of the part's catalogue, as the objective
detectability counts them. In how many images a pair is seen is counted over all postures and exposures of a plan.
"""

from lightopt.plan._assess import ObjectiveAssessment, PairAssessment, Setup
from lightopt.plan._brackets import Brackets, Shot
from lightopt.plan._choice import Choice, Wanted
from lightopt.plan._choose import choose_postures
from lightopt.plan._combinations import combination_sums
from lightopt.plan._commands import Command, Way, way_through
from lightopt.plan._counts import (
    Counts,
    PairWeights,
    added,
    counts_of_images,
    gain_of,
    gains_of,
    no_counts,
    reached,
    worth,
)
from lightopt.plan._cover import Cover, Step
from lightopt.plan._exchange import exchanged
from lightopt.plan._exposures import DEFAULT_EXPOSURE_GAIN, plan_exposures
from lightopt.plan._greedy_cover import greedy_cover
from lightopt.plan._grid import (
    DEFAULT_OUTSIDE_PX,
    DEFAULT_POSTURE_STEP,
    LeftOutPosture,
    posture_grid,
    usable_postures,
)
from lightopt.plan._offered import choose_with_exposures
from lightopt.plan._options import PlanOptions
from lightopt.plan._place_lights import Places, place_lights
from lightopt.plan._result import SHARES_OF, ChosenPostures, PlanResult, TrustOf
from lightopt.plan._run import Planned, plan
from lightopt.plan._survey import DRAWN_PATCHES, Survey, drawn_patches
from lightopt.plan._tolerances import DEFAULT_TOLERANCE_TARGET, Assess, Offset, Tolerances
from lightopt.plan._trust import Trust, trust_of
from lightopt.plan._unreached import Reach, TargetUnreached
from lightopt.plan._widest import Widest
from lightopt.plan._write import PLANNED_PART_NAME, planned_text

__all__ = [
    "DEFAULT_EXPOSURE_GAIN",
    "DEFAULT_OUTSIDE_PX",
    "DEFAULT_POSTURE_STEP",
    "DEFAULT_TOLERANCE_TARGET",
    "DRAWN_PATCHES",
    "PLANNED_PART_NAME",
    "SHARES_OF",
    "Assess",
    "Brackets",
    "Choice",
    "ChosenPostures",
    "Command",
    "Counts",
    "Cover",
    "LeftOutPosture",
    "ObjectiveAssessment",
    "Offset",
    "PairAssessment",
    "PairWeights",
    "Places",
    "PlanOptions",
    "PlanResult",
    "Planned",
    "Reach",
    "Setup",
    "Shot",
    "Step",
    "Survey",
    "TargetUnreached",
    "Tolerances",
    "Trust",
    "TrustOf",
    "Wanted",
    "Way",
    "Widest",
    "added",
    "choose_postures",
    "choose_with_exposures",
    "combination_sums",
    "counts_of_images",
    "drawn_patches",
    "exchanged",
    "gain_of",
    "gains_of",
    "greedy_cover",
    "no_counts",
    "place_lights",
    "plan",
    "plan_exposures",
    "planned_text",
    "posture_grid",
    "reached",
    "trust_of",
    "usable_postures",
    "way_through",
    "worth",
]
