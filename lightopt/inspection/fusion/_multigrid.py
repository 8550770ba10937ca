"""Kernels of sums over the edges between neighbouring pixels: the weighted Laplacian of an odd-shaped mask.

All arrays have a border of one row and one column of zeros on every side, so that no pixel lacks a neighbour. An edge
joins a pixel with the one to its right (`wx`) or below it (`wy`), and is kept at the former. Edges of weight 0 are not
there: a mask is nothing but zeros, and the border of the mask is a natural one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel

Grid = NDArray[Any]
"""float64 or float32."""


@kernel
def reciprocal_sums(wx: Grid, wy: Grid) -> Grid:
    """One over the sum of the weights of each pixel's edges; 0 for a pixel without edges."""
    result = np.zeros_like(wx)
    for r in range(1, wx.shape[0] - 1):
        for c in range(1, wx.shape[1] - 1):
            total = wx[r, c - 1] + wx[r, c] + wy[r - 1, c] + wy[r, c]
            if total > 0.0:
                result[r, c] = 1.0 / total
    return result


@kernel
def laplacian(u: Grid, wx: Grid, wy: Grid, result: Grid) -> float:
    """Write L·u to `result`, and return uᵀ·L·u."""
    energy = 0.0
    for r in range(1, u.shape[0] - 1):
        for c in range(1, u.shape[1] - 1):
            here = u[r, c]
            value = wx[r, c - 1] * (here - u[r, c - 1]) + wx[r, c] * (here - u[r, c + 1])
            value += wy[r - 1, c] * (here - u[r - 1, c]) + wy[r, c] * (here - u[r + 1, c])
            result[r, c] = value
            energy += value * here
    return energy


@kernel
def product(r: Grid, z: Grid) -> float:
    """Sum of the products of two images' pixels."""
    total = 0.0
    for i in range(r.shape[0]):
        for c in range(r.shape[1]):
            total += r[i, c] * z[i, c]
    return total


@kernel
def next_direction(p: Grid, z: Grid, size: float, share: float) -> None:
    """The next direction of conjugate gradients, size·z + share·p, in place of `p`."""
    for r in range(p.shape[0]):
        for c in range(p.shape[1]):
            p[r, c] = size * z[r, c] + share * p[r, c]


@kernel
def advance(u: Grid, r: Grid, p: Grid, q: Grid, step: float) -> tuple[float, float]:
    """A step of conjugate gradients: u + step·p and r − step·q in place; the sum of squares of r, and its greatest."""
    square, most = 0.0, 0.0
    for i in range(u.shape[0]):
        for c in range(u.shape[1]):
            u[i, c] += step * p[i, c]
            left = r[i, c] - step * q[i, c]
            r[i, c] = left
            square += left * left
            most = max(most, abs(left))
    return square, most


@kernel
def relax(u: Grid, b: Grid, wx: Grid, wy: Grid, reciprocal: Grid, first: int) -> None:
    """One sweep of Gauss and Seidel in place: the pixels of one colour of a chess board, then those of the other."""
    for colour in (first, 1 - first):
        for r in range(1, u.shape[0] - 1):
            for c in range(1 + (r + colour) % 2, u.shape[1] - 1, 2):
                beside = wx[r, c - 1] * u[r, c - 1] + wx[r, c] * u[r, c + 1]
                beside += wy[r - 1, c] * u[r - 1, c] + wy[r, c] * u[r + 1, c]
                u[r, c] = (b[r, c] + beside) * reciprocal[r, c]


@kernel
def residual(u: Grid, b: Grid, wx: Grid, wy: Grid, result: Grid) -> None:
    """Write to `result`, of half the rows and columns, the sums of b − L·u over blocks of 2 × 2 pixels."""
    result[:] = 0.0
    for r in range(1, u.shape[0] - 1):
        for c in range(1, u.shape[1] - 1):
            here = u[r, c]
            value = b[r, c] - wx[r, c - 1] * (here - u[r, c - 1]) - wx[r, c] * (here - u[r, c + 1])
            value -= wy[r - 1, c] * (here - u[r - 1, c]) + wy[r, c] * (here - u[r + 1, c])
            result[(r + 1) // 2, (c + 1) // 2] += value


@kernel
def add_coarse(u: Grid, correction: Grid, reciprocal: Grid) -> None:
    """Add to each pixel that has an edge what its block of 2 × 2 pixels has."""
    for r in range(1, u.shape[0] - 1):
        for c in range(1, u.shape[1] - 1):
            if reciprocal[r, c] > 0.0:
                u[r, c] += correction[(r + 1) // 2, (c + 1) // 2]


@kernel
def coarser(wx: Grid, wy: Grid) -> tuple[Grid, Grid]:
    """Weights of the edges between blocks of 2 × 2 pixels.

    Half the sum of the weights across, so that the coarse Laplacian is that of pixels of twice the size.
    """
    shape = ((wx.shape[0] - 1) // 2 + 2, (wx.shape[1] - 1) // 2 + 2)
    cx, cy = np.zeros(shape, wx.dtype), np.zeros(shape, wx.dtype)
    for r in range(1, wx.shape[0] - 1):
        for c in range(2, wx.shape[1] - 1, 2):
            cx[(r + 1) // 2, c // 2] += 0.5 * wx[r, c]
    for r in range(2, wx.shape[0] - 1, 2):
        for c in range(1, wx.shape[1] - 1):
            cy[r // 2, (c + 1) // 2] += 0.5 * wy[r, c]
    return cx, cy


@kernel
def divergence(gx: Float64, gy: Float64, wx: Float64, wy: Float64) -> Float64:
    """The right side Dᵀ·W·g of the normal equations for differences `gx` and `gy` along the edges."""
    b = np.zeros_like(wx)
    for r in range(1, wx.shape[0] - 1):
        for c in range(1, wx.shape[1] - 1):
            b[r, c] = wx[r, c - 1] * gx[r, c - 1] - wx[r, c] * gx[r, c]
            b[r, c] += wy[r - 1, c] * gy[r - 1, c] - wy[r, c] * gy[r, c]
    return b
