"""Samples of photographs to linear grey levels, and masks to outlines."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float32, Float64, UInt8
from lightopt.core.errors import InputError
from lightopt.images import photograph_format, read_photograph

Gamma = Literal["linear", "srgb"]
Channel = Literal["luminance", "red", "green", "blue"]

SRGB_BITS = 12
"""Bits in which 8-bit sRGB samples are written as linear levels: enough that no two become one."""

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)  # ITU-R BT.709-6, section 3.2
_WEIGHTS = {"luminance": _LUMINANCE, **dict(zip(("red", "green", "blue"), np.eye(3, dtype=np.float32), strict=True))}


def grey_share(samples: NDArray[Any], *, full: float, gamma: Gamma, channel: Channel) -> tuple[Float32, Bool]:
    """Linear grey value as a share of full scale, and where a channel that counts is at full scale; shape (H, W) each.

    samples: As stored, shape (H, W, 1 or 3)
    full: Sample at full scale
    """
    value = samples.astype(np.float32) / np.float32(full)
    if gamma == "srgb":
        # IEC 61966-2-1, section 5.2
        decoded = np.where(value <= 0.04045, value / 12.92, ((np.maximum(value, 0.0) + 0.055) / 1.055) ** 2.4)
        value = decoded.astype(np.float32)
    weights = _WEIGHTS[channel] if value.shape[2] == 3 else np.ones(1, dtype=np.float32)
    grey = np.asarray(value @ weights, dtype=np.float32)
    return grey, np.any(value[..., weights > 0.0] >= 1.0, axis=2)


def quantised(share: Float32, full: Bool, *, bits: int) -> UInt8 | NDArray[np.uint16]:
    """Sensor levels of so many bits, rounded; the highest where `full`."""
    top = 2**bits - 1
    levels = np.clip(np.floor(share * np.float32(top) + np.float32(0.5)), 0, top)
    levels[full] = top
    return levels.astype(np.uint8) if bits <= 8 else levels.astype(np.uint16)


def read_mask(path: Path) -> Bool:
    """Pixels of the part, shape (H, W): those of at least half of full scale.

    Raises InputError: The file is no image, or has pixels of one kind only
    """
    bits, samples = photograph_format(path).bits, read_photograph(path)
    mask = samples.max(axis=2) * 2.0 >= (1.0 if bits is None else 2**bits - 1)
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
