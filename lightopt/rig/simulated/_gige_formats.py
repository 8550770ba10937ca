"""Pixel formats of the simulated GigE camera: levels as the bytes of a frame, from the tables of the PFNC."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FORMATS: dict[str, tuple[int, int]] = {
    "Mono8": (0x01080001, 8),
    "Mono10": (0x01100003, 10),
    "Mono10p": (0x010A0046, 10),
    "Mono10Packed": (0x010C0004, 10),
    "Mono12": (0x01100005, 12),
    "Mono12p": (0x010C0047, 12),
    "Mono12Packed": (0x010C0006, 12),
    "Mono16": (0x01100007, 16),
}
"""Number and bits by name."""

_DENSE = {0x010A0046: 10, 0x010C0047: 12}
_PAIRED = {0x010C0004: 2, 0x010C0006: 4}


def packed(levels: NDArray[np.integer[Any]], code: int) -> bytes:
    """Bytes of a frame.

    Parameters
    ----------
    levels
        Right-aligned, shape (H, W).
    code
        Number of the pixel format.
    """
    flat = levels.reshape(-1)
    if code in _DENSE:
        places = np.arange(_DENSE[code])
        bits = (flat[:, None].astype(np.int64) >> places & 1).astype(np.uint8)
        return np.packbits(bits.reshape(-1), bitorder="little").tobytes()
    if code in _PAIRED:
        low = _PAIRED[code]
        pairs = np.zeros((-(-len(flat) // 2), 2), np.int64)
        pairs.reshape(-1)[: len(flat)] = flat
        first, second = pairs.T
        mask = (1 << low) - 1
        middle = (first & mask) | (second & mask) << 4
        return np.stack((first >> low, middle, second >> low), axis=1).astype(np.uint8).tobytes()
    return flat.astype(np.uint8 if code >> 16 & 0xFF == 8 else "<u2").tobytes()
