"""Which postures, which exposures, and how exactly the machine must hold its angles."""

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

__all__ = [
    "Counts",
    "Cover",
    "PairWeights",
    "Step",
    "added",
    "counts_of_images",
    "gain_of",
    "greedy_cover",
    "no_counts",
    "reached",
    "worth",
]
