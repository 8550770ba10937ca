"""An image from its gradients: weighted least squares over the edges between pixels of a mask.

The minimum of Σ w·(u_j − u_i − g_ij)² over all edges is the solution of Poisson's equation with the natural boundary
condition: nothing is said about what lies beyond the mask, holes included. It is found by conjugate gradients,
preconditioned by a W-cycle of multigrid on blocks of pixels (Braess 1995, doi:10.1007/BF02238484), so that the number
of steps hardly depends on the size of the image or on the outline of the mask.

Grids have a border of one row and one column of zeros on every side, so that no pixel lacks a neighbour. An edge joins
a pixel with the one to its right (`wx`) or below it (`wy`), and is kept at the former. Edges of weight 0 are not there:
a mask is nothing but zeros, and the border of the mask is a natural one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Float64, Int32
from lightopt.core.errors import LightoptError
from lightopt.core.kernels import kernel
from lightopt.inspection._image_blocks import mask_window

TOLERANCE = 1e-10  # residual that is left, as a share of the right side's
MOST_STEPS = 400
SMALLEST_SIDE = 3
COARSEST_SWEEPS = 12
SWEEPS = 2
REPEATED = 4  # sizes of blocks that a cycle goes through twice: more of them take time and save no steps

Grid = NDArray[Any]  # float64 or float32


# weights of the edges between blocks of one size, right and below, and one over their sums at each block; with a border
# of zeros. Single precision will do for a preconditioner
_Level = tuple[Float32, Float32, Float32]


@dataclass(frozen=True, eq=False)
class _Workspace:
    """What solving for one image writes to: the image, its direction and that direction's Laplacian, with a border."""

    u: Float64
    p: Float64
    q: Float64
    grids: tuple[tuple[Float32, Float32], ...]  # of each size of blocks the right side and the solution of a cycle

    @staticmethod
    def of(levels: Sequence[_Level]) -> "_Workspace":
        """One for so many sizes of blocks."""
        u, p, q = (np.zeros(levels[0][0].shape) for _ in range(3))
        return _Workspace(u, p, q, tuple((np.zeros_like(wx), np.zeros_like(wx)) for wx, _, _ in levels))


@dataclass(frozen=True)
class PoissonGrid:
    """Edges of a mask with their weights, at every size of blocks, for many gradients; from :func:`poisson_grid`."""

    mask: Bool  # pixels of the image, shape (H, W)
    components: Int32  # number of each pixel's connected component of the mask, 0 outside of it, shape (H, W)
    count: int
    window: tuple[slice, slice]  # rows and columns that hold the mask
    _wx: Float64
    _wy: Float64
    _levels: tuple[_Level, ...]
    _idle: list[_Workspace] = field(default_factory=list)  # for the next image: making new ones takes as long as steps

    def integrate(self, gx: Float64, gy: Float64, *, level: Float64, tolerance: float = TOLERANCE) -> Float64:
        """The image with the gradients given, float64 of shape (H, W); 0 outside of the mask.

        Gradients do not determine the level of a component of the mask: each gets the mean that `level` has over it.

        gx, gy: differences to the pixel to the right, shape (H, W − 1), and below, shape (H − 1, W).
        level: shape (H, W).
        """
        b = divergence(_edges(gx, self.window, 1), _edges(gy, self.window, 0), self._wx, self._wy)
        try:
            work = self._idle.pop()
        except IndexError:
            work = _Workspace.of(self._levels)
        self._solve(b, tolerance, work)
        result, inner = np.zeros(self.mask.shape), work.u[1:-1, 1:-1]
        _add_levels(inner, level[self.window], self.components[self.window], self.count, result[self.window])
        self._idle.append(work)
        return result

    def _solve(self, b: Float64, tolerance: float, work: _Workspace) -> None:
        # preconditioned conjugate gradients; L is singular on each component, but b has nothing there. The right side
        # is given up
        u, p, q, r = work.u, work.p, work.q, b
        u.fill(0.0)
        p.fill(0.0)
        goal = tolerance * math.sqrt(float(np.vdot(b, b)))
        if goal == 0.0:
            return
        if not math.isfinite(goal):
            raise LightoptError("gradients that are not finite numbers have no image")
        scaled, z = work.grids[0]
        size = float(np.abs(b).max())
        before = math.inf
        for _ in range(MOST_STEPS):
            np.multiply(r, 1.0 / size, out=scaled, casting="unsafe")
            self._cycle(0, work.grids)
            now = size * product(r, z)
            next_direction(p, z, size, now / before)
            before = now
            square, size = advance(u, r, p, q, now / laplacian(p, self._wx, self._wy, q))
            if math.sqrt(square) <= goal:
                return
        raise LightoptError(f"gradients were not integrated within {MOST_STEPS} steps")

    def _cycle(self, depth: int, grids: Sequence[tuple[Float32, Float32]], *, again: bool = False) -> None:
        # one symmetric W-cycle, from 0 or from where it was
        level, (b, u) = self._levels[depth], grids[depth]
        if not again:
            u.fill(0.0)
        if depth + 1 == len(self._levels):
            relax(u, b, *level, 0, COARSEST_SWEEPS)
            relax(u, b, *level, 1, COARSEST_SWEEPS)
            return
        relax(u, b, *level, 0, SWEEPS)
        coarse, correction = grids[depth + 1]
        residual(u, b, *level[:2], coarse)
        self._cycle(depth + 1, grids)
        if depth < REPEATED:
            self._cycle(depth + 1, grids, again=True)
        add_coarse(u, correction, level[2])
        relax(u, b, *level, 1, SWEEPS)


def poisson_grid(mask: Bool, wx: Float64, wy: Float64) -> PoissonGrid:
    """Prepare the integration over a mask.

    mask: Pixels of the image, shape (H, W).
    wx, wy: Weight of the differences to the pixel to the right, shape (H, W − 1), and below, (H − 1, W); above 0. Those
        of edges that leave the mask do not matter.
    """
    components = np.zeros(mask.shape, np.int32)
    count = ndimage.label(mask, output=components)
    window = mask_window(mask)
    wx = _edges(np.where(mask[:, 1:] & mask[:, :-1], wx, 0.0), window, 1)
    wy = _edges(np.where(mask[1:] & mask[:-1], wy, 0.0), window, 0)
    level = [(wx.astype(np.float32), wy.astype(np.float32))]
    while min(level[-1][0].shape) - 2 > SMALLEST_SIDE:
        level.append(coarser(*level[-1]))
    levels = tuple((x, y, reciprocal_sums(x, y)) for x, y in level)
    return PoissonGrid(mask, components, cast(int, count), window, wx, wy, levels)


def _edges(values: NDArray[Any], window: tuple[slice, slice], axis: int) -> Float64:
    # those within the window, with the border that kernels want
    rows, columns = window
    shape = (rows.stop - rows.start + 2, columns.stop - columns.start + 2)
    inside = [rows, columns]
    # the last pixel of the window has no edge beyond it
    inside[axis] = slice(inside[axis].start, max(inside[axis].start, inside[axis].stop - 1))
    part = values[inside[0], inside[1]]
    bordered = np.zeros(shape)
    bordered[1 : 1 + part.shape[0], 1 : 1 + part.shape[1]] = part
    return bordered


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
def relax(u: Grid, b: Grid, wx: Grid, wy: Grid, reciprocal: Grid, first: int, sweeps: int) -> None:
    """Sweeps of Gauss and Seidel in place: each of the pixels of one colour of a chess board, then of the other.

    All are done in one pass over the image, which would not fit a cache: each half of a sweep is a row behind the one
    before, when both rows that it needs are as that one leaves them. Rows are computed whole, since the processor works
    on neighbours at once, and those of the colour are kept.
    """
    rows, columns = u.shape
    new = np.empty(columns, u.dtype)
    halves = 2 * sweeps
    for front in range(1, rows - 1 + halves - 1):
        for half in range(max(0, front - rows + 2), min(halves, front)):
            r = front - half
            own, above, below, right, down, up = u[r], u[r - 1], u[r + 1], wx[r], wy[r], wy[r - 1]
            for c in range(1, columns - 1):
                beside = right[c - 1] * own[c - 1] + right[c] * own[c + 1]
                beside += up[c] * above[c] + down[c] * below[c]
                new[c] = (b[r, c] + beside) * reciprocal[r, c]
            for c in range(1 + (r + first + half) % 2, columns - 1, 2):
                own[c] = new[c]


@kernel
def residual(u: Grid, b: Grid, wx: Grid, wy: Grid, result: Grid) -> None:
    """Write to `result`, of half the rows and columns, the sums of b − L·u over blocks of 2 × 2 pixels."""
    result[:] = 0.0
    inner = u.shape[1] - 2
    value = np.zeros(inner + 1, u.dtype)  # of a row, and 0 beyond an odd number of columns
    for r in range(1, u.shape[0] - 1):
        # slices, so that the compiler sees that no index is negative
        own, left, right, above, below = u[r, 1:], u[r], u[r, 2:], u[r - 1, 1:], u[r + 1, 1:]
        to_left, to_right, up, down, given = wx[r], wx[r, 1:], wy[r - 1, 1:], wy[r, 1:], b[r, 1:]
        for c in range(inner):
            here = own[c]
            less = given[c] - to_left[c] * (here - left[c]) - to_right[c] * (here - right[c])
            value[c] = less - (up[c] * (here - above[c]) + down[c] * (here - below[c]))
        sums = result[(r + 1) // 2, 1:]
        for k in range((inner + 1) // 2):
            sums[k] = sums[k] + value[2 * k] + value[2 * k + 1]


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
def _add_levels(u: Float64, level: Float64, components: Int32, count: int, result: Float64) -> None:
    # to `result`: the image u, and on each of so many components what takes its mean to that of `level`
    sums, sizes = np.zeros(count + 1), np.zeros(count + 1)
    for r in range(u.shape[0]):
        for c in range(u.shape[1]):
            sums[components[r, c]] += level[r, c] - u[r, c]
            sizes[components[r, c]] += 1.0
    for r in range(u.shape[0]):
        for c in range(u.shape[1]):
            own = components[r, c]
            if own > 0:
                result[r, c] = u[r, c] + sums[own] / sizes[own]


@kernel
def divergence(gx: Float64, gy: Float64, wx: Float64, wy: Float64) -> Float64:
    """The right side Dᵀ·W·g of the normal equations for differences `gx` and `gy` along the edges."""
    b = np.zeros_like(wx)
    for r in range(1, wx.shape[0] - 1):
        for c in range(1, wx.shape[1] - 1):
            b[r, c] = wx[r, c - 1] * gx[r, c - 1] - wx[r, c] * gx[r, c]
            b[r, c] += wy[r - 1, c] * gy[r - 1, c] - wy[r, c] * gy[r, c]
    return b
