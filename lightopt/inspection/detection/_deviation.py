"""Deviation of each pixel from the good part, in units of its expected deviation by noise and model errors."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.defects import DARK, REGISTRATION_PX
from lightopt.inspection._image_blocks import in_image_blocks
from lightopt.inspection.prediction._posture_view import PostureView

# a step between pixels of so many times the steps before and after it is the edge of the shadow of a point light: a ray
# per pixel has it a pixel further or not, however little the part is off
HARD = 4.0

LOCAL_PX = 14.0
# the typical deviation of a pixel's surroundings, Gaussian of this width, each clipped: where that is more than noise
# makes, the model is wrong there, and the noise counts for more
CLIPPED = 4.0

# surroundings are added up in blocks of this side first, of which there are whole ones in the rows of a thread
BLOCK_PX = 4

MEAN_OF_NORMAL = 0.7979  # mean magnitude of a standard normal deviate


@dataclass(frozen=True)
class Deviations:
    """Measured minus predicted of a posture."""

    z: Float32  # in standard deviations, shape (lights, H, W); 0 where not usable
    # the standard deviation [grey level at exposure 1], same shape; at pixels that cannot be judged, of noise and
    # surroundings alone
    scale: Float32
    # pixels that can show a defect in an image: reached by the light, off edges, not saturated in both image and
    # prediction, same shape
    usable: Bool
    # of these, the ones that are not :data:`DARK`: they show most defects, dark ones only what glints there, same shape
    lit: Bool
    # of what is no defect, from image to image at the same place: that of a texture; noise has none
    correlation: float = 0.0

    def in_box(self, rows: slice, columns: slice = slice(None)) -> "Deviations":
        """Some rows and columns, as views of the arrays."""
        box = (slice(None), rows, columns)
        return Deviations(self.z[box], self.scale[box], self.usable[box], self.lit[box], self.correlation)


def deviations(view: PostureView, *, local: bool = True, threads: int | None = None) -> Deviations:
    """Compare the images of a posture with the good part.

    Both are clipped where the camera clips, and what rounding, or the place of an edge inside its pixel, may make of a
    level is no deviation. A pixel's variance is that of the sensor's noise, of a part that lies a tenth of a pixel from
    where the model has it, and of what the model gets wrong around the pixel.

    local: Whether what the model gets wrong counts.
    """
    z, scale = np.empty_like(view.level), np.empty_like(view.level)
    usable, lit = np.empty(z.shape, np.bool_), np.empty(z.shape, np.bool_)
    lights, height, width = view.level.shape
    blocks = (lights, -(-height // BLOCK_PX), -(-width // BLOCK_PX))
    sums, counts = np.zeros(blocks), np.zeros(blocks)

    def compare(i: int, rows: slice) -> None:
        image = view.level[i], view.predicted[i], view.deviation[i], view.slack[i], view.limit[i], view.saturated[i]
        found = z[i], scale[i], usable[i], lit[i]
        _compare(image, view.clean, rows.start, rows.stop, found, sums[i], counts[i])

    in_image_blocks(compare, lights, height, threads)
    if not local:
        return Deviations(z, scale, usable, lit)
    typical = in_threads(lambda i: _around(sums[i], counts[i]), range(lights), threads)

    def normalise(i: int, rows: slice) -> None:
        normalise_rows(typical[i], rows.start, rows.stop, z[i], scale[i])

    in_image_blocks(normalise, lights, height, threads)
    return Deviations(z, scale, usable, lit)


def _around(sums: Float64, counts: Float64) -> Float32:
    # the typical deviation around each block of pixels, at least that of noise
    total, share = (ndimage.gaussian_filter(values, LOCAL_PX / BLOCK_PX) for values in (sums, counts))
    typical = total / np.maximum(share, 1e-6 * BLOCK_PX**2) / MEAN_OF_NORMAL
    return np.maximum(typical, 1.0).astype(np.float32)


@kernel
def _compare(
    image: tuple[Float32, Float32, Float32, Float32, Float32, Bool],
    clean: Bool,
    top: int,
    bottom: int,
    found: tuple[Float32, Float32, Bool, Bool],
    sums: Float64,
    counts: Float64,
) -> None:
    (level, predicted, deviation, slack, limit, saturated), (z, scale, usable, lit) = image, found
    height, width = level.shape
    for y in range(top, bottom):
        above, below = max(y - 1, 0), min(y + 1, height - 1)
        for x in range(width):
            if not clean[y, x]:
                usable[y, x] = lit[y, x] = False
                z[y, x], scale[y, x] = 0.0, deviation[y, x]
                continue
            before, after = max(x - 1, 0), min(x + 1, width - 1)
            down = (_model(predicted, limit, below, x) - _model(predicted, limit, above, x)) / max(below - above, 1)
            right = (_model(predicted, limit, y, after) - _model(predicted, limit, y, before)) / max(after - before, 1)
            noise = float(deviation[y, x])
            own = math.sqrt(noise * noise + REGISTRATION_PX**2 * (down * down + right * right))
            scale[y, x] = own
            both = saturated[y, x] and predicted[y, x] >= limit[y, x]
            usable[y, x] = not both and predicted[y, x] > 0.0
            lit[y, x] = usable[y, x] and predicted[y, x] >= DARK * noise
            z[y, x] = 0.0
            if usable[y, x]:
                off = _difference(min(level[y, x], limit[y, x]), predicted, limit, y, x)
                off = math.copysign(max(abs(off) - slack[y, x], 0.0), off) / own
                if lit[y, x] or abs(off) > DARK:
                    z[y, x] = off
                sums[y // BLOCK_PX, x // BLOCK_PX] += min(abs(off), CLIPPED)
                counts[y // BLOCK_PX, x // BLOCK_PX] += 1.0


@kernel
def _difference(level: float, predicted: Float32, limit: Float32, y: int, x: int) -> float:
    # measured minus predicted; at the hard edge of a shadow a pixel may be on either side, or on both. Steps are
    # compared before the camera clips: the flank of a highlight climbs on beyond, its clipped levels do not
    here = float(predicted[y, x])
    low = high = _model(predicted, limit, y, x)
    for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        behind_y, behind_x, far_y, far_x = y - down, x - right, y + 2 * down, x + 2 * right
        if min(behind_y, behind_x, far_y, far_x) < 0:
            continue
        if max(behind_y, far_y) >= len(predicted) or max(behind_x, far_x) >= predicted.shape[1]:
            continue
        there = float(predicted[y + down, x + right])
        even = max(abs(here - float(predicted[behind_y, behind_x])), abs(there - float(predicted[far_y, far_x])))
        if abs(there - here) > HARD * even:
            beside = _model(predicted, limit, y + down, x + right)
            low, high = min(low, beside), max(high, beside)
    return min(level - low, 0.0) + max(level - high, 0.0)


@kernel
def _model(predicted: Float32, limit: Float32, y: int, x: int) -> float:
    return float(min(max(predicted[y, x], np.float32(0.0)), limit[y, x]))


@kernel
def normalise_rows(typical: Float32, top: int, bottom: int, z: Float32, scale: Float32) -> None:
    """Divide rows of deviations by the typical deviation around their blocks, and multiply their scale by it."""
    # blocks' values belong to their middles; between those, on straight lines
    rows, columns = typical.shape
    for y in range(top, bottom):
        v = min(max((y + 0.5) / BLOCK_PX - 0.5, 0.0), rows - 1.0)
        i = min(int(v), max(rows - 2, 0))
        under = min(i + 1, rows - 1)
        t = v - i
        for x in range(z.shape[1]):
            u = min(max((x + 0.5) / BLOCK_PX - 0.5, 0.0), columns - 1.0)
            k = min(int(u), max(columns - 2, 0))
            beside = min(k + 1, columns - 1)
            s = u - k
            upper = typical[i, k] + s * (typical[i, beside] - typical[i, k])
            lower = typical[under, k] + s * (typical[under, beside] - typical[under, k])
            factor = upper + t * (lower - upper)
            z[y, x] /= factor
            scale[y, x] *= factor
