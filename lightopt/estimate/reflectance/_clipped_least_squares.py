"""Least squares of levels as the camera clips them, each pixel of the images counting alike.

The criterion for images that the model does not describe: a likelihood of the noise then asks which of the pixels to
give up, while this finds the reflectance that predicts images best. It is the log-likelihood of Gaussian deviations of
one unknown variance, which is put at its best value: −N/2·(ln(2π·mean square) + 1). Its residual against the noise,
without dust, shows whether the model describes the images.
"""

import math

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Float64, Int32
from lightopt.core.kernels import kernel
from lightopt.estimate.reflectance._likelihood import (
    Evaluation,
    Light,
    Sums,
    add_slopes,
    clipped_levels,
    image_factors,
    lagrange,
    parameter_count,
    predicted,
    specular_and_slope,
    sum_in_chunks,
)
from lightopt.estimate.reflectance._samples import ImageFacts, Samples
from lightopt.estimate.reflectance._vector import DARK, LOG_SIGMA

# widths of lobes that are tried [rad]: somewhat beyond the documented range, so that an edge is seen as one
LEAST_SIGMA, MOST_SIGMA, MOST_GGX_SIGMA = 0.0007, 0.3, 0.7
# nodes of ln σ over that range, and how many of them an interpolation takes: its error is some 1e-6 of the lobe
NODES, WINDOW = 121, 5
LEAST_MEAN_SQUARE = 1.0 / 12.0  # that of rounding to whole levels: no model can be nearer
# pixels of one exposure are compared with those of a like geometry: rings per octave of the angle from the mirror
# direction, and steps of the diffuse light
RINGS, DIFFUSE_STEPS = 3, 10
# a pixel is dust where its residual is so many deviations, and at least this share of the full scale, from the middle
# of the pixels of a like geometry, of which there are so many at least
DUST_SPREADS, DUST_LEVELS, LEAST_ALIKE = 8.0, 0.06, 20
MOST_DUST = 0.1  # where more of a geometry's pixels than this are far off, that is the model's fault
# the model describes the images while the residual of least squares is no more than this many times the noise [rms]:
# what the model gets wrong is then less than three quarters of the noise
MOST_MISFIT = 1.25
_CHUNK = 65_536
# Immerkær 1996, doi:10.1006/cviu.1996.0060: what it leaves of anything that is a plane or a saddle is nothing
_WINDOW = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])


class SpecularTable:
    """Light per unit of R_s of some pixels over ln σ, worked out at nodes as they are needed."""

    def __init__(self, samples: Samples) -> None:
        most = MOST_GGX_SIGMA if samples.model.name == "ggx" else MOST_SIGMA
        self.nodes = np.linspace(math.log(LEAST_SIGMA), math.log(most), NODES)  # ln σ
        self._samples = samples
        self._columns: dict[int, Float64] = {}
        self._window: tuple[int, Float64] = (-1, np.zeros((0, 0)))

    def column(self, node: int) -> Float64:
        """At a node, shape (n,)."""
        if node not in self._columns:
            self._columns[node] = self._samples.specular(math.exp(self.nodes[node]))
        return self._columns[node]

    def around(self, log_sigma: float) -> tuple[Float64, Float64]:
        """The nodes around a place, shape (w,), and the light there, shape (n, w)."""
        nearest = round((log_sigma - self.nodes[0]) / (self.nodes[1] - self.nodes[0]))
        first = min(max(nearest - WINDOW // 2, 0), NODES - WINDOW)
        if self._window[0] != first:
            self._window = first, np.stack([self.column(first + k) for k in range(WINDOW)], axis=1)
        return self.nodes[first : first + WINDOW], self._window[1]


class LeastSquares:
    """The criterion of least squares over samples.

    fixed: ln σ and the light there, shape (n,), of a criterion that is only evaluated there.
    weight: Pixels of the images that each observation stands for, on average 1, shape (N,).
    """

    def __init__(self, samples: Samples, table: SpecularTable, *, fixed: tuple[float, Float64] | None = None) -> None:
        self.samples = samples
        self.table = table
        self.size = parameter_count(samples)
        self._fixed = None if fixed is None else (np.array([fixed[0]]), fixed[1][:, None])
        weight = samples.weight[samples.sample]
        # pixels of the images that each observation stands for, on average 1, shape (N,)
        self.weight = weight / max(float(np.mean(weight)), 1e-300) if len(weight) else weight
        self.sigma_range = float(table.nodes[0]), float(table.nodes[-1])

    def without(self, left_out: Bool) -> "LeastSquares":
        """The same of other samples: those not marked in `left_out`, shape (N,)."""
        return LeastSquares(self.samples.select(~left_out), self.table)

    def light(self, x: Float64) -> Float64:
        """Specular light per unit of R_s at the σ of `x`, shape (n,)."""
        at = float(x[LOG_SIGMA])
        nodes, columns = self._fixed or self.table.around(at)
        return columns @ lagrange(nodes, at)[0]

    def mean_square(self, x: Float64) -> float:
        """Of measured minus predicted level, both clipped as by the camera [sensor level²]."""
        return -2.0 * self._sums(x)[0] / max(1, len(self.samples.sample))

    def evaluate(self, x: Float64) -> Evaluation:
        value, gradient, curvature = self._sums(x)
        count = len(self.samples.sample)
        mean = max(-2.0 * value / max(1, count), LEAST_MEAN_SQUARE)
        return Evaluation(-0.5 * count * (math.log(2.0 * math.pi * mean) + 1.0), gradient / mean, curvature / mean)

    def _sums(self, x: Float64) -> tuple[float, Float64, Float64]:
        s = self.samples
        at = float(x[LOG_SIGMA])
        nodes, columns = self._fixed or self.table.around(at)
        c, dc = lagrange(nodes, at)
        top = s.sensor.saturated_from

        observed, light = (s.sample, s.level, s.image, self.weight), (s.diffuse, columns, c, dc)

        def add(start: int, end: int, *sums: Float64) -> float:
            return _accumulate(observed, start, end, light, s.facts, (s.sensor.black_level, top), x, sums)

        return sum_in_chunks(add, len(s.sample), self.size, chunk=_CHUNK, threads=s.threads)


_Observed = tuple[Int32, Float32, Int32, Float64]
_Ends = tuple[float, float]


@kernel
def _accumulate(
    observed: _Observed, start: int, end: int, light: Light, facts: ImageFacts, ends: _Ends, x: Float64, sums: Sums
) -> float:
    # minus half the sum of weighted squares, its gradient, and the matrix of Gauss and Newton
    (sample, level, image, weights), (diffuse, specular, c, dc), (black, top) = observed, light, ends
    r_d, r_s, dark = x[0], math.exp(x[1]), x[3]
    factor_of = image_factors(facts, x)
    total = 0.0
    for j in range(start, end):
        i, m = sample[j], image[j]
        factor = factor_of[m]
        s, ds = specular_and_slope(i, specular, c, dc)
        signal = factor * (r_d * diffuse[i] + r_s * s)
        mean = black + dark + signal
        weight = weights[j]
        residual = min(float(level[j]), top) - min(max(mean, 0.0), top)
        total -= 0.5 * weight * residual * residual
        if mean < 0.0 or mean > top:
            continue
        slopes, pull = (factor * diffuse[i], factor * r_s * s, factor * r_s * ds, signal), weight * residual
        add_slopes(pull, pull, weight, 4 + facts.light[m], slopes, sums)
    return total


def find_dust(samples: Samples, mean: Float64) -> Bool:
    """Observations that are far from all others of a like geometry, shape (N,).

    A model that is wrong is wrong alike there, so that its misfit is not taken for dust.

    mean: Predicted levels, not clipped, shape (N,).
    """
    level, model = clipped_levels(samples, mean)
    residual = level - model
    ring = np.floor(RINGS * np.log2(np.maximum(samples.deflection, 1e-4) / 1e-4)).astype(np.intp)
    step = np.floor(DIFFUSE_STEPS * samples.diffuse).astype(np.intp)
    exposure = np.unique(samples.facts.factor, return_inverse=True)[1]
    key = ((ring * 1000 + np.minimum(step, 999)) * 100)[samples.sample] + exposure[samples.image]
    _, group, count = np.unique(key, return_inverse=True, return_counts=True)
    groups = np.arange(len(count))
    off = np.abs(residual - ndimage.median(residual, group, groups)[group])
    spread = ndimage.median(off, group, groups)
    limit = np.maximum(DUST_SPREADS * 1.4826 * spread, DUST_LEVELS * samples.sensor.max_level)
    far = (off > limit[group]) & (count >= LEAST_ALIKE)[group]
    share = np.bincount(group, weights=far) / count
    return far & (share <= MOST_DUST)[group]


def measure_misfit(criterion: LeastSquares, x: Float64) -> float:
    """Residual of least squares over the noise, both rms over the lit pixels of one exposure; that of the worst one.

    The noise is that of the rig file or, where they show more, of the images.
    """
    s = criterion.samples
    sensor = s.sensor
    mean = predicted(s, criterion.light(x), x)
    top = sensor.saturated_from
    lit = s.diffuse[s.sample] > 0.0
    seen = lit & ~(s.saturated & (mean >= top))
    if not seen.any():
        return 0.0
    level, model = clipped_levels(s, mean)
    signal = np.minimum(mean, top) - sensor.black_level - x[DARK]
    variance = sensor.noise_variance(signal, frames=s.facts.frames[s.image])
    variance = np.maximum(variance, image_noise(s) ** 2)
    exposure = np.unique(s.facts.factor, return_inverse=True)[1][s.image]
    weight = criterion.weight * seen
    squares = np.bincount(exposure, weights=weight * (level - model) ** 2)
    floors = np.bincount(exposure, weights=weight * variance)
    return math.sqrt(float(np.max(squares[floors > 0.0] / floors[floors > 0.0])))


def image_noise(samples: Samples) -> float:
    """Typical deviation of a lit pixel from the plane through its neighbours [sensor level]; 0 where there is none.

    Immerkær 1996, doi:10.1006/cviu.1996.0060: what a 3 × 3 window leaves of anything that is a plane or a saddle.
    """
    row, column = samples.places
    height, width = samples.images[0].levels.shape
    use = (row > 0) & (row < height - 1) & (column > 0) & (column < width - 1)
    use &= (samples.diffuse[samples.sample] > 0.0) & (samples.level > 0.0) & ~samples.saturated
    index = np.flatnonzero(use)
    if not len(index):
        return 0.0
    index = index[np.argsort(samples.image[index], kind="stable")]
    ends = np.searchsorted(samples.image[index], np.arange(1, len(samples.images)))
    responses: list[Float64] = []  # 6 times the noise
    for image, here in zip(samples.images, np.split(index, ends), strict=True):
        r, c = row[here], column[here]
        response = np.zeros(len(here))
        for (y, x), factor in np.ndenumerate(_WINDOW):
            response += factor * image.levels[r + y - 1, c + x - 1]
        responses.append(response)
    return 1.4826 * float(np.median(np.abs(np.concatenate(responses)))) / 6.0
