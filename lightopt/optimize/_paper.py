"""Objective ``paper``: the sum of the middle levels that are neither shaded nor specular (paper, section 5.2).

Of each patch's levels under the n lights the highest and the lowest are dropped (step 3); of the n − 2 that remain,
those below the shade threshold and those at saturation count as zero (step 4); the sum over all patches is the score
(step 5). What is summed is light: the part of a level above the sensor's black level (the paper's camera has none).

All combinations at once, by algebra. Let ``x_1 ≤ … ≤ x_n`` be a patch's levels above black, h(x) the usable level (x, or
0 where it is not usable), and E_m the sum of h(min) over all sets of m lights. The least of a set of m is x_j in C(n − j, m − 1)
of the sets, so that

    E_m = Σ_j C(n − j, m − 1) · h(x_j),    and    h(x_2) + … + h(x_{n−1}) = Σ_m c_m · E_m,
    c_{m+1} = Σ_{k=0..m} (−1)^{m−k} · C(m, k) · t_k,    t_k = 1 for 1 ≤ k ≤ n − 2, else 0.

For four lights that is E_2 − E_3: six tables of pairs and four of triples instead of a table of quadruples. For every
even n the term of all n lights cancels likewise. With levels below the shade threshold set to 0 and all levels capped
at the saturation level S, ``h(min) = min − S·[all m levels are saturated]``, both plain minima.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.optimize._matrix import Levels, Thresholds
from lightopt.optimize._minimum_sums import minimum_sums
from lightopt.optimize._packed import joint_counts, packed

__all__ = ["PAPER", "Paper"]

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@dataclass(frozen=True)
class Paper:
    """The paper's evaluation value; see the module's text."""

    name: str = "paper"
    unit: str = "sensor level"

    def refusal(self, lights: int) -> str | None:
        """Dropping the highest and the lowest of two leaves nothing."""
        if lights > 2:
            return None
        return (
            f"objective paper drops each patch's highest and lowest level, and with {lights} lights nothing is left; "
            "expected at least 3 lights, or use the objective coverage"
        )

    def weights(self, areas: Float64) -> Int64:
        """Every patch counts the same, as every polygon does in the paper."""
        return np.ones(len(areas), np.int64)

    def score(self, levels: Levels, weights: Int64, thresholds: Thresholds) -> int:
        """Sort, drop the ends, zero what is not usable, sum."""
        middle = np.sort(levels, axis=0)[1:-1].astype(np.int64)
        usable = (middle >= thresholds.shade) & (middle < thresholds.saturation)
        return int(((middle - thresholds.black) * usable * weights).sum())

    def scores(
        self, levels: Sequence[Levels], weights: Int64, thresholds: Thresholds, *, threads: int
    ) -> Int64:
        """By tables of minima; `weights` are those of :meth:`weights`, all 1."""
        del weights
        lights = len(levels)
        capped = [_capped(layer, thresholds) for layer in levels]
        # few patches can be saturated under two lights or more
        lit = [layer >= thresholds.saturation for layer in levels]
        several = np.sum([layer.any(axis=0) for layer in lit], axis=0) >= 2
        saturated = [packed(layer[:, several]) for layer in lit]
        table = np.zeros(tuple(len(layer) for layer in levels), np.int64)
        for count, coefficient in enumerate(_coefficients(lights), start=1):
            if coefficient == 0:
                continue
            for chosen in itertools.combinations(range(lights), count):
                sums = minimum_sums([capped[i] for i in chosen], threads=threads)
                sums -= (thresholds.saturation - thresholds.black) * joint_counts(
                    [saturated[i] for i in chosen]
                )
                table += (
                    coefficient * sums[tuple(slice(None) if i in chosen else None for i in range(lights))]
                )
        return table

    def bound(self, levels: Sequence[Levels], weights: Int64, thresholds: Thresholds) -> int:
        """The lesser of two limits of each patch: its n − 2 largest usable levels, and its middle greatest levels.

        The second holds since the j-th level of any combination is at most the j-th of the lights' greatest levels.
        """
        del weights  # all 1
        usable = np.sort([_usable(layer, thresholds).max(axis=0) for layer in levels], axis=0)
        greatest = np.sort([layer.max(axis=0) for layer in levels], axis=0)[1:-1]
        black = greatest.dtype.type(thresholds.black)
        lit = np.minimum(greatest, thresholds.saturation - 1) - black
        middle = np.where(greatest >= thresholds.shade, lit, 0)
        return int(
            np.minimum(usable[2:].sum(axis=0, dtype=np.int64), middle.sum(axis=0, dtype=np.int64)).sum()
        )


def _coefficients(lights: int) -> list[int]:
    # c_1 … c_n of the module's text
    wanted = [int(1 <= k <= lights - 2) for k in range(lights)]
    return [sum((-1) ** (m - k) * math.comb(m, k) * wanted[k] for k in range(m + 1)) for m in range(lights)]


def _capped(layer: Levels, thresholds: Thresholds) -> Levels:
    zero, black = layer.dtype.type(0), layer.dtype.type(thresholds.black)
    cap = layer.dtype.type(min(thresholds.saturation, np.iinfo(layer.dtype).max))
    return np.where(layer >= thresholds.shade, np.minimum(layer, cap) - black, zero)


def _usable(layer: Levels, thresholds: Thresholds) -> Levels:
    usable = (layer >= thresholds.shade) & (layer < thresholds.saturation)
    return np.where(usable, layer - layer.dtype.type(thresholds.black), layer.dtype.type(0))


PAPER = Paper()
