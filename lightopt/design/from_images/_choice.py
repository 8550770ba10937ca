"""The best k of K lights, each in an image of its own: exact search by branch and bound, with a bound where it stops.

The score of a choice is the mean over defects of

    g(x) = 0.9 · min(1, x) + 0.1 · x / (1 + x),   x = E / T²,

so what is found decides, and among choices that find the same, the margin. Lights are added one by one. Each takes what
it explains out of the correlations and contrasts of the others, as a Cholesky factorisation does: a choice costs one
row of it. Below a partial choice S, with λ the least eigenvalue of R,

    E(S ∪ T) ≤ E(S) + Σ_{t ∈ T} |f_t|² / λ,   f_t: contrast of light t that S leaves,

and g is concave, so the gains in score of single lights add up to no less than that of T: the sum of the greatest is a
bound.
"""

import math
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Float64, Index, Int64
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.design.from_images._evidence import Evidence

DEFAULT_LIMIT = 50_000_000  # choices to score before the search stops with a bound

FOUND = 0.9  # share of the score that is for defects that are found
_TIE = 1e-9  # scores that differ by less are the same
_NOISE = 1e-12


@dataclass(frozen=True)
class Choice:
    lights: tuple[int, ...]  # in ascending order
    score: float  # mean of g over the defects
    bound: float  # a score that no choice of as many lights exceeds
    scored: int  # complete choices that were scored
    total: int  # all that there are

    @property
    def proven(self) -> bool:
        return self.bound <= self.score + _TIE


def score(gains: Float64) -> float:
    return float(np.mean(FOUND * np.minimum(1.0, gains) + (1.0 - FOUND) * gains / (1.0 + gains)))


def choose_lights(evidence: Evidence, count: int, *, limit: int = DEFAULT_LIMIT, threads: int | None = None) -> Choice:
    """Find the best `count` lights, the same with any number of threads; of choices that tie, one of them.

    limit: About how many choices to score before the search stops with a bound.
    """
    lights, total = evidence.lights, math.comb(evidence.lights, count)
    factors = evidence.factors / np.sqrt(np.repeat(evidence.thresholds, np.diff(evidence.starts)))
    single = [score(row) for row in _added(evidence.correlation, factors, evidence.starts)]
    order = np.argsort(-np.array(single), kind="stable")
    correlation = np.ascontiguousarray(evidence.correlation[np.ix_(order, order)])
    factors = np.ascontiguousarray(factors[order])
    most = evidence.all_lights() * (1.0 + _TIE)
    least = float(np.linalg.eigvalsh(correlation)[0])
    best, first_score = _exchanged(correlation, factors, evidence.starts, count)

    def search(first: int) -> tuple[float, Int64, float, int]:
        share = math.comb(lights - 1 - first, count - 1) / total
        return _search_below(
            correlation, factors, evidence.starts, most, least, count, first, first_score, int(limit * share) + 1
        )

    results = in_threads(search, range(lights - count + 1), threads)
    found = first_score
    for value, chosen, _, _ in results:
        if value > found + _NOISE:
            found, best = value, tuple(map(int, chosen))
    bound = min(max(found, *(result[2] for result in results)), max(found, score(most)))
    return Choice(
        lights=tuple(sorted(int(order[i]) for i in best)),
        score=found,
        bound=bound,
        scored=sum(result[3] for result in results),
        total=total,
    )


def _added(correlation: Float64, factors: Float64, starts: Index) -> Float64:
    # evidence that each light adds, shape (K, J); none where it adds nothing of its own
    sums = np.cumsum(np.pad(factors**2, ((0, 0), (1, 0))), axis=1)[:, starts]
    rest = np.diag(correlation)[:, None]
    return np.where(rest > _NOISE, np.diff(sums, axis=1) / np.maximum(rest, _NOISE), 0.0)


def _without(correlation: Float64, factors: Float64, light: int) -> tuple[Float64, Float64]:
    # what a light leaves of correlations and contrasts
    share = correlation[:, light] / correlation[light, light]
    left = correlation - np.outer(share, correlation[light])
    left[light, light] = 0.0
    return left, factors - np.outer(share, factors[light])


def _exchanged(correlation: Float64, factors: Float64, starts: Index, count: int) -> tuple[tuple[int, ...], float]:
    # a good choice to begin with: lights added one by one, then exchanged one by one while that helps
    chosen: list[int] = []
    value, turn, idle = -1.0, 0, 0
    while idle < count:
        kept = chosen if len(chosen) < count else [*chosen[:turn], *chosen[turn + 1 :]]
        left, rest, evidence = correlation, factors, np.zeros(len(starts) - 1)
        for light in kept:
            evidence = evidence + _added(left, rest, starts)[light]
            left, rest = _without(left, rest, light)
        scores = [-1.0 if t in kept else score(evidence + row) for t, row in enumerate(_added(left, rest, starts))]
        better = int(np.argmax(scores))
        if len(chosen) < count:
            chosen, value = [*kept, better], scores[better]
            continue
        if scores[better] > value + _NOISE:
            chosen[turn], value, idle = better, scores[better], 0
        else:
            idle += 1
        turn = (turn + 1) % count
    return tuple(chosen), value


@kernel
def _gain(x: float) -> float:
    return FOUND * min(1.0, x) + (1.0 - FOUND) * x / (1.0 + x)


@kernel
def _search_below(
    correlation: Float64,
    factors: Float64,
    starts: Index,
    most: Float64,
    least: float,
    count: int,
    first: int,
    best: float,
    limit: int,
) -> tuple[float, Int64, float, int]:
    """The best choice whose first light is `first`, if it is better than `best`.

    correlation, factors, starts: of the lights, contrasts over T; most: x of each defect with all lights; least: λ
    Returns: its score, its lights, a bound on what was left, the number of choices that were scored.
    """
    lights, columns = factors.shape
    defects = len(starts) - 1
    left = np.empty((count, lights, lights))
    rest = np.empty((count, lights, columns))
    evidence = np.zeros((count, defects))
    bounds = np.full((count, lights), -1.0)
    following = np.zeros(count, np.int64)
    chosen, found = np.zeros(count, np.int64), np.zeros(count, np.int64)
    top = np.empty(count)
    left[0], rest[0] = correlation, factors
    scored, depth, entered = 0, 0, True
    while depth >= 0:
        if entered:
            entered = False
            begin = first if depth == 0 else chosen[depth - 1] + 1
            remaining = count - depth
            following[depth] = begin
            base = 0.0
            for j in range(defects):
                base += _gain(evidence[depth, j])
            for i in range(remaining - 1):
                top[i] = 0.0
            for t in range(lights - 1, begin - 1, -1):
                own = left[depth, t, t]
                value = 0.0
                for j in range(defects):
                    square = 0.0
                    for q in range(starts[j], starts[j + 1]):
                        square += rest[depth, t, q] ** 2
                    if remaining == 1:
                        value += _gain(evidence[depth, j] + square / own)
                    else:
                        x = min(evidence[depth, j] + square / least, most[j])
                        value += _gain(max(x, evidence[depth, j])) - _gain(evidence[depth, j])
                if remaining == 1:
                    if depth == 0 and t != first:
                        continue
                    scored += 1
                    if value / defects > best + _NOISE:
                        best = value / defects
                        found[:depth] = chosen[:depth]
                        found[depth] = t
                    continue
                total = base + value
                for i in range(remaining - 1):
                    total += top[i]
                bounds[depth, t] = total / defects if t <= lights - remaining else -1.0
                for i in range(remaining - 1):
                    if value > top[i]:
                        value, top[i] = top[i], value
            if remaining == 1:
                depth -= 1
                continue
        if scored >= limit:
            break
        t = following[depth]
        end = first + 1 if depth == 0 else lights
        while t < end and bounds[depth, t] <= best + _NOISE:
            t += 1
        if t >= end:
            depth -= 1
            continue
        following[depth] = t + 1
        chosen[depth] = t
        own = left[depth, t, t]
        for j in range(defects):
            square = 0.0
            for q in range(starts[j], starts[j + 1]):
                square += rest[depth, t, q] ** 2
            evidence[depth + 1, j] = evidence[depth, j] + square / own
        last = depth + 2 == count
        for u in range(t + 1, lights):
            share = left[depth, u, t] / own
            for q in range(columns):
                rest[depth + 1, u, q] = rest[depth, u, q] - share * rest[depth, t, q]
            if last:
                left[depth + 1, u, u] = left[depth, u, u] - share * left[depth, t, u]
            else:
                for v in range(t + 1, lights):
                    left[depth + 1, u, v] = left[depth, u, v] - share * left[depth, t, v]
        depth += 1
        entered = True
    bound = best
    while depth >= 0:
        end = first + 1 if depth == 0 else lights
        for t in range(following[depth], end):
            bound = max(bound, bounds[depth, t])
        depth -= 1
    return best, found, bound, scored
