"""Samples of photographs to linear grey levels, and masks to outlines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float64, UInt8
from lightopt.core.errors import InputError
from lightopt.images import read_photograph

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)  # ITU-R BT.709-6, section 3.2


def grey_levels(samples: NDArray[Any], *, full: int, srgb: bool, bits: int) -> UInt8 | NDArray[np.uint16]:
    """Linear grey levels of so many bits, shape (H, W); the highest where a channel is at full scale.

    samples: As stored, shape (H, W, 1 or 3)
    full: Sample at full scale
    """
    value = samples.astype(np.float32) / np.float32(full)
    if srgb:
        # IEC 61966-2-1, section 5.2
        decoded = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
        value = decoded.astype(np.float32)
    grey = value @ _LUMINANCE if value.shape[2] == 3 else value[..., 0]
    top = 2**bits - 1
    levels = np.floor(grey * np.float32(top) + np.float32(0.5))
    levels[np.any(value >= 1.0, axis=2)] = top
    return levels.astype(np.uint8) if bits <= 8 else levels.astype(np.uint16)


def read_mask(path: Path) -> Bool:
    """Pixels of the part, shape (H, W): those of at least half of full scale.

    Raises InputError: The file is no image, or has pixels of one kind only
    """
    samples = read_photograph(path)
    mask: Bool = samples.max(axis=2) > np.iinfo(samples.dtype).max // 2
    if mask.all() or not mask.any():
        raise InputError(
            f"{path}: the mask is all {'white' if mask.all() else 'black'}; expected the part white on black"
        )
    return mask


def outline(mask: Bool) -> tuple[Float64, Float64]:
    """Columns and rows [px] of the middles of all pixel sides between the mask and what is around it."""
    rows, columns = np.nonzero(mask[:, 1:] != mask[:, :-1])
    below, beside = np.nonzero(mask[1:] != mask[:-1])
    middles = np.array([np.append(columns + 1.0, beside + 0.5), np.append(rows + 0.5, below + 1.0)], dtype=np.float64)
    return middles[0], middles[1]
