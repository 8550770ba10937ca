"""Local search: exchange one candidate of a cover at a time, for as long as that covers more.

A greedy choice is never revised. Here each chosen candidate is tried against every other one, the best exchange is
made, and so on: the result is a set that no single exchange improves. It is not proven to be the best of its size.
"""

from __future__ import annotations

from collections.abc import Sequence

from lightopt.core.threads import available_processors
from lightopt.design.postures._counts import (
    Counts,
    PairWeights,
    all_marginal_gains,
    covered_weight,
    sum_counts,
    total_benefit,
)

Merit = tuple[int, int]
"""Covered weight, benefit: see :mod:`lightopt.design.postures._counts`."""


def improve_by_exchange(
    candidates: Sequence[Counts], weights: PairWeights, chosen: Sequence[int], *, threads: int | None = None
) -> tuple[int, ...]:
    """As many candidates that cover as much or more, and that no single exchange improves.

    The best exchange is made first; of equals the one that replaces the earliest chosen by the first candidate.
    """
    now = list(chosen)
    if not now:
        return ()
    k = len(candidates[0])
    merit = _merit(sum_counts((candidates[i] for i in now), weights, k), weights)
    while True:
        best: tuple[Merit, int, int] | None = None
        others = [i for i in range(len(candidates)) if i not in now]
        for place in range(len(now)):
            rest = sum_counts((candidates[i] for i in [*now[:place], *now[place + 1 :]]), weights, k)
            covered, benefit = _merit(rest, weights)
            gains = all_marginal_gains(
                rest, [candidates[i] for i in others], weights, threads=threads or available_processors()
            )
            for i, gain in zip(others, gains, strict=True):
                other = covered + gain[0], benefit + gain[1]
                if other > (merit if best is None else best[0]):
                    best = other, place, i
        if best is None:
            return tuple(now)
        merit, place, i = best
        now[place] = i


def _merit(counts: Counts, weights: PairWeights) -> Merit:
    return covered_weight(counts, weights), total_benefit(counts, weights)
