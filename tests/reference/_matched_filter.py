"""The matched filter of whole defects, one place after the other."""

from __future__ import annotations

import numpy as np


def matched_filter(change, z, pieces, row, column, *, most=np.inf):
    """U = Σ m·z and E = Σ m² per light, and the same over the pixels of which no piece changes by `most` or more.

    change: (h, w, lights, variants); z: (h, w, lights); pieces: (down, right, variant, weight) from the middle on.
    """
    m = np.zeros(z.shape)
    whole = np.ones(z.shape, bool)
    for down, right, variant, weight in pieces:
        y, x = row + down, column + right
        m[y, x] += weight * change[y, x, :, variant]
        whole[y, x] &= np.abs(change[y, x, :, variant]) < most
    u, e = m * z, m * m
    return u.sum((0, 1)), e.sum((0, 1)), (u * whole).sum((0, 1)), (e * whole).sum((0, 1))


def summed_blocks(z, usable, ratio):
    """Sums of z over blocks of ratio × ratio usable pixels over the root of their number, and that number."""
    height, width = (-(-side // ratio) for side in z.shape)
    total, count = np.zeros((height, width)), np.zeros((height, width), int)
    for y in range(z.shape[0]):
        for x in range(z.shape[1]):
            if usable[y, x]:
                total[y // ratio, x // ratio] += z[y, x]
                count[y // ratio, x // ratio] += 1
    return np.where(count > 0, total / np.sqrt(np.maximum(count, 1)), 0.0), count
