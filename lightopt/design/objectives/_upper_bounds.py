"""Extreme levels of each patch over all candidates of a light, from which bounds are computed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Int64
from lightopt.core.kernels import kernel
from lightopt.design.responses._luminance_matrix import Levels, LevelThresholds


@dataclass(frozen=True, kw_only=True)
class LevelRange:
    """Levels at patches over all candidates of a light, each of shape (p,).

    usable: The greatest usable level; −1 where none is usable.
    greatest, least: The greatest and the least level.
    """

    usable: Int64
    greatest: Int64
    least: Int64


def level_range(layer: Levels, thresholds: LevelThresholds, start: int, end: int) -> LevelRange:
    """The range of a light's levels at the patches from `start` to `end`."""
    usable, greatest, least = _reach(layer, thresholds.shade, thresholds.saturation, start, end)
    return LevelRange(usable=usable, greatest=greatest, least=least)


@kernel
def _reach(layer: Levels, shade: int, saturation: int, start: int, end: int) -> tuple[Int64, Int64, Int64]:
    usable = np.full(end - start, -1, np.int64)
    greatest = np.full(end - start, -1, np.int64)
    least = np.full(end - start, 1 << 16, np.int64)
    for a in range(len(layer)):
        for p in range(start, end):
            level = np.int64(layer[a, p])
            greatest[p - start] = max(greatest[p - start], level)
            least[p - start] = min(least[p - start], level)
            if shade <= level < saturation:
                usable[p - start] = max(usable[p - start], level)
    return usable, greatest, least
