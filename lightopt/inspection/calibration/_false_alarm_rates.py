"""The rate of false alarms that so many good sets can hold, whatever the law of their scores: order statistics.

Of `n` good sets let the k-th largest of their greatest scores be the threshold. A further good set exceeds it with a
probability that is distributed as Beta(k, n − k + 1) over all ways to draw the sets, whatever they are drawn from
(Wilks 1941, doi:10.1214/aoms/1177731788): a distribution-free tolerance limit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from scipy import special

from lightopt.core.errors import counted

CONFIDENCE: Final = 0.95
"""That a threshold holds its rate."""


def sets_needed(rate: float) -> int:
    """How many good sets it takes to hold a rate: the least n of 1 − (1 − rate)ⁿ ≥ 95 %."""
    return math.ceil(math.log1p(-CONFIDENCE) / math.log1p(-min(rate, 1.0 - 1e-12)))


def least_rate(sets: int) -> float:
    """The least rate that so many good sets can hold."""
    return 1.0 - (1.0 - CONFIDENCE) ** (1.0 / sets)


def tolerance_limit(peaks: Sequence[float], rate: float) -> float | None:
    """Lowest threshold that at most this share of good sets exceeds, with 95 % confidence; None if there is none."""
    ordered = sorted(peaks, reverse=True)
    limit = None
    for k, peak in enumerate(ordered, start=1):
        if float(special.betainc(k, len(ordered) - k + 1, min(rate, 1.0))) < CONFIDENCE - 1e-9:
            break
        limit = peak
    return limit


def too_few_good_sets(sets: int, rate: float, where: str) -> str:
    """Message: so many good sets cannot hold a rate; `where` names the sets."""
    least = least_rate(sets)
    return (
        f"{where}: {counted(sets, 'good set')} bear a rate of false alarms of {least:.3g} per posture or "
        f"more with {100.0 * CONFIDENCE:.0f} % confidence; {rate:g} takes {sets_needed(rate)}: give more good sets, "
        f"or ask for --false-alarms {math.ceil(least * 1000.0) / 1000.0:g}"
    )
