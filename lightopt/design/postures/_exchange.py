"""Candidates of a cover exchanged one at a time, for as long as that shows more.

A greedy choice never takes back what it chose. Here each chosen candidate is tried against every other one, the best
exchange is made, and so on: what is left is a set that no single exchange betters. It is seldom far from the best of
its size; that it is the best is not said.
"""

from __future__ import annotations

from collections.abc import Sequence

from lightopt.core.threads import available_processors, run_all
from lightopt.design.postures._counts import Counts, PairWeights, gains_of, reached, together, worth

Merit = tuple[int, int]
"""Weight reached, worth: see :mod:`lightopt.design.postures._counts`."""


def exchanged(
    candidates: Sequence[Counts], weights: PairWeights, chosen: Sequence[int], *, threads: int | None = None
) -> tuple[int, ...]:
    """As many candidates that show as much or more, none of which is better exchanged for another.

    The best exchange is made first; of equals the one that takes out the earliest chosen for the first candidate.

    Parameters
    ----------
    candidates
        Counts of each, shape (k, p, words), all of one k.
    weights
        Of the pairs.
    chosen
        Indices of those to begin with.
    threads
        All the machine's by default; the answer does not depend on it.
    """
    now = list(chosen)
    if not now:
        return ()
    merit = _merit(_together(candidates, now, weights), weights)
    while True:
        found: tuple[Merit, int, int] | None = None
        for place in range(len(now)):
            rest = _together(candidates, [*now[:place], *now[place + 1 :]], weights)
            merits = _merits(rest, candidates, weights, skip=now, threads=threads)
            for i, other in merits.items():
                if other > (merit if found is None else found[0]):
                    found = other, place, i
        if found is None:
            return tuple(now)
        merit, place, i = found
        now[place] = i


def _merits(
    rest: Counts,
    candidates: Sequence[Counts],
    weights: PairWeights,
    *,
    skip: Sequence[int],
    threads: int | None,
) -> dict[int, Merit]:
    base = _merit(rest, weights)
    gains: dict[int, Merit] = {i: (0, 0) for i in range(len(candidates)) if i not in skip}

    def add(i: int) -> None:
        gains[i] = gains_of(rest, candidates[i], weights)

    run_all(((add, (i,)) for i in list(gains)), threads=threads or available_processors())
    return {i: (base[0] + top, base[1] + whole) for i, (top, whole) in gains.items()}


def _together(candidates: Sequence[Counts], some: Sequence[int], weights: PairWeights) -> Counts:
    return together((candidates[one] for one in some), weights, len(candidates[0]))


def _merit(counts: Counts, weights: PairWeights) -> Merit:
    return reached(counts, weights), worth(counts, weights)
