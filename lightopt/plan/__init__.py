"""Which postures, which exposures, and how exactly the machine must hold its angles."""

from lightopt.plan._combinations import Places, combination_sums, place_lights
from lightopt.plan._counts import (
    Counts,
    PairWeights,
    added,
    counts_of_images,
    gain_of,
    no_counts,
    reached,
    worth,
)
from lightopt.plan._cover import Cover, Step, greedy_cover
from lightopt.plan._grid import DEFAULT_POSTURE_STEP, LeftOutPosture, posture_grid, usable_postures
from lightopt.plan._trust import Assess, Offset, Tolerances, Trust, Widest, trust_of

__all__ = [
    "DEFAULT_POSTURE_STEP",
    "Assess",
    "Counts",
    "Cover",
    "LeftOutPosture",
    "Offset",
    "PairWeights",
    "Places",
    "Step",
    "Tolerances",
    "Trust",
    "Widest",
    "added",
    "combination_sums",
    "counts_of_images",
    "gain_of",
    "greedy_cover",
    "no_counts",
    "place_lights",
    "posture_grid",
    "reached",
    "trust_of",
    "usable_postures",
    "worth",
]
