"""What a pixel's mean keeps of a defect's walls: all of a wall that fills it, little of a defect that it swallows.

A pixel that the defect does not fill changes by F · (D − M) + A · M (docs/how-to/planning.md, Narrow defects), with

    F = |mean of ∂h/∂y| / tan(slope),    A = mean of |∇h|² / tan²(slope),

the means over the pixel, h the profile, y across. A stain or a haze has no walls: F = A is its share of the pixel. The
pixel grid is turned by 22.5°, midway between along and diagonal, and off the defect's middle by (−0.3, 0.3) pixels: for
defects from a third of a pixel to six pixels wide F and A are near their medians over all places and turns.
"""

import math

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.defects._shape import SHAPE_KINDS, DefectShape, height_gradient, radial_place

PER_OCTAVE = 4
LEAST_OCTAVE, MOST_OCTAVE = -5, 3

PIXEL_RATIOS: Float64 = np.exp2(np.arange(LEAST_OCTAVE * PER_OCTAVE, MOST_OCTAVE * PER_OCTAVE + 1) / PER_OCTAVE)
"""Side of a pixel's footprint over the width of the defect, at which shares are worked out: 1/32 to 8."""

TURN = math.radians(22.5)
OFFSET = -0.3, 0.3  # of the grid: its turn [rad], and how far one pixel's middle is off the defect's [px]
SAMPLES = 20  # across the defect's width; across a pixel there are not fewer nor more than these:
LEAST_SAMPLES, MOST_SAMPLES = 4, 64

# pixels to each side of its middle at which a long defect is looked at: what lies further off is another place
STRETCH = 1.75


def pixel_shares(shape: DefectShape) -> Float64:
    """F and A of the pixel with the greatest F, then of that with the greatest A, at :data:`PIXEL_RATIOS`; (n, 4).

    shape: Of the defect; how steep it is does not matter
    """
    return np.array([grid_shares(shape, float(ratio), turn=TURN, offset=OFFSET) for ratio in PIXEL_RATIOS])


def grid_shares(
    shape: DefectShape, ratio: float, *, turn: float, offset: tuple[float, float]
) -> tuple[float, float, float, float]:
    """As :func:`pixel_shares`, on one grid of pixels.

    ratio: Side of a pixel's footprint over the width
    turn: Of the grid against the defect's length [rad]
    offset: Of one pixel's middle from the defect's, along the grid's axes [px]
    """
    side = ratio * shape.width
    along = min(0.5 * shape.length, max(STRETCH * side, 0.5 * shape.width)) + 0.5 * side
    across = 0.5 * shape.width + side
    reach = math.ceil(math.hypot(along, across) / side) + 1
    steps = np.arange(-reach, reach + 1)
    cosine, sine = math.cos(turn), math.sin(turn)
    columns, rows = (a.ravel() * side for a in np.meshgrid(steps + offset[0], steps + offset[1]))
    near = np.abs(cosine * columns - sine * rows) <= along
    near &= np.abs(sine * columns + cosine * rows) <= across
    count = min(MOST_SAMPLES, max(LEAST_SAMPLES, math.ceil(SAMPLES * ratio)))
    inner = ((np.arange(count) + 0.5) / count - 0.5) * side
    right, down = (a.ravel() for a in np.meshgrid(inner, inner))
    u, v = columns[near][:, None] + right, rows[near][:, None] + down
    x, y = cosine * u - sine * v, sine * u + cosine * v
    one, all_of_it = _means(shape, x, y)
    best, most = int(one.argmax()), int(all_of_it.argmax())
    return float(one[best]), float(all_of_it[best]), float(one[most]), float(all_of_it[most])


def _means(shape: DefectShape, x: Float64, y: Float64) -> tuple[Float64, Float64]:
    # F and A of each pixel, from its samples; shapes (pixels, samples) → (pixels,)
    if shape.kind not in SHAPE_KINDS:
        share = (radial_place(shape, x.ravel(), y.ravel()) < 1.0).reshape(x.shape).mean(axis=1)
        return share, share
    steepest = math.tan(shape.slope)
    along, across = (part.reshape(x.shape) / steepest for part in height_gradient(shape, x.ravel(), y.ravel()))
    return np.abs(across.mean(axis=1)), (along**2 + across**2).mean(axis=1)
