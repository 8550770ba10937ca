"""How likely the images are: interval-censored levels of a noisy sensor, some of which the model cannot explain.

A quantised level q says that the signal was between q − ½ and q + ½, a saturated one that it was at least that, a zero
that it was at most ½ (Tobin 1958, doi:10.2307/1907382). The signal is Gaussian about the model's level with the
sensor's shot and read noise (EMVA Standard 1288) and a further deviation τ that is estimated, since neither meshes nor
noise figures are exact. The mean of N frames has an N-th of the sensor's variance. A share ε of the pixels, estimated
as well, may show anything at all: dust, scratches, glints.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lightopt.core.arrays import Bool, Float32, Float64, Int32
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.estimate.reflectance._samples import ImageFacts, Samples
from lightopt.estimate.reflectance._vector import DARK, FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D

# share of the unexplained pixels that are black, and of those that are saturated: dust and glints; the rest is spread
# evenly over the levels between
EXTREME_SHARE = 0.05
_CHUNK = 16_384
_SQRT_HALF = math.sqrt(0.5)
_SQRT_TWO_PI = math.sqrt(2.0 * math.pi)
Light = tuple[Float64, Float64, Float64, Float64]  # diffuse, specular, and weights of its nodes
_Observed = tuple[Int32, Float32, Bool, Int32]
_Noise = tuple[float, float, float, float, float]
Sums = tuple[Float64, Float64]  # gradient, shape (K,), and curvature, shape (K, K)


@dataclass(frozen=True)
class Evaluation:
    value: float
    gradient: Float64
    curvature: Float64  # positive semi-definite matrix that stands for minus the Hessian in a Newton step, shape (K, K)


class Criterion(Protocol):
    """A log-likelihood of samples: the censored one of noise and outliers, or that of least squares."""

    samples: Samples
    size: int  # number of parameters K
    sigma_range: tuple[float, float]  # values of ln σ for which it can be evaluated

    # value, gradient and curvature at the parameters `x`, shape (K,)
    def evaluate(self, x: Float64) -> Evaluation: ...


def parameter_count(samples: Samples) -> int:
    return FIRST_GAIN + len(samples.lights) + 2


def sum_in_chunks(
    add: Callable[[int, int, Float64, Float64], float], count: int, size: int, *, chunk: int, threads: int | None
) -> tuple[float, Float64, Float64]:
    """Value, gradient and curvature of all observations, computed in chunks in parallel.

    add: Returns the value of the observations `start` to `end`, and adds to gradient (K,) and to the upper triangle of
        the curvature (K, K).
    """

    def one(start: int) -> tuple[float, Float64, Float64]:
        gradient, curvature = np.zeros(size), np.zeros((size, size))
        value = add(start, min(start + chunk, count), gradient, curvature)
        return value, gradient, np.triu(curvature) + np.triu(curvature, 1).T

    parts = in_threads(one, range(0, count, chunk), threads)
    if len(parts) == 1:
        return parts[0]
    return (sum(p[0] for p in parts), np.sum([p[1] for p in parts], axis=0), np.sum([p[2] for p in parts], axis=0))


@kernel
def image_factors(facts: ImageFacts, x: Float64) -> Float64:
    """Levels per unit of light in each image at the gains of the parameters `x`, shape (M,)."""
    return np.array([facts.factor[m] * math.exp(x[4 + facts.light[m]]) for m in range(len(facts.factor))])


@kernel
def specular_and_slope(i: int, specular: Float64, c: Float64, dc: Float64) -> tuple[float, float]:
    """Specular light of pixel `i` per unit of R_s, and its slope by ln σ; `c`, `dc` are the nodes' weights for both."""
    s = ds = 0.0
    for k in range(len(c)):
        s += c[k] * specular[i, k]
        ds += dc[k] * specular[i, k]
    return s, ds


@kernel
def add_slopes(
    score: float, dark: float, bend: float, gain: int, slopes: tuple[float, float, float, float], sums: Sums
) -> None:
    """Add the gradient of one observation, and its curvature to the upper triangle.

    score, dark: Slopes of the criterion by the level, and by the dark level.
    bend: Minus the second derivative of the criterion by the level.
    gain: Place of the gain of its light.
    slopes: Of the level by R_d, ln R_s, ln σ and ln gain; that by the dark level is 1.
    """
    (r_d, r_s, sigma, signal), (gradient, curvature) = slopes, sums
    gradient[0] += score * r_d
    gradient[1] += score * r_s
    gradient[2] += score * sigma
    gradient[3] += dark
    gradient[gain] += score * signal
    by_r_d, by_r_s, by_sigma = bend * r_d, bend * r_s, bend * sigma
    curvature[0, 0] += by_r_d * r_d
    curvature[0, 1] += by_r_d * r_s
    curvature[0, 2] += by_r_d * sigma
    curvature[0, 3] += by_r_d
    curvature[0, gain] += by_r_d * signal
    curvature[1, 1] += by_r_s * r_s
    curvature[1, 2] += by_r_s * sigma
    curvature[1, 3] += by_r_s
    curvature[1, gain] += by_r_s * signal
    curvature[2, 2] += by_sigma * sigma
    curvature[2, 3] += by_sigma
    curvature[2, gain] += by_sigma * signal
    curvature[3, 3] += bend
    curvature[3, gain] += bend * signal
    curvature[gain, gain] += bend * signal * signal


class Likelihood:
    """The likelihood of a set of samples, for σ near those of the specular light's columns.

    log_sigmas: ln σ of the columns of `specular`, shape (m,); between them the light is interpolated by a polynomial.
    specular: Per unit of R_s, shape (n, m).
    """

    def __init__(self, samples: Samples, log_sigmas: Float64, specular: Float64) -> None:
        self.samples = samples
        self.log_sigmas = log_sigmas
        self.specular = specular
        self.size = parameter_count(samples)
        low, high = float(log_sigmas[0]), float(log_sigmas[-1])
        reach = 0.5 * (high - low) if len(log_sigmas) > 1 else math.inf
        self.sigma_range = low - reach, high + reach

    def evaluate(self, x: Float64) -> Evaluation:
        s = self.samples
        add = self._summation(s, x)
        return Evaluation(*sum_in_chunks(add, len(s.sample), self.size, chunk=_CHUNK, threads=s.threads))

    def by_block(self, x: Float64) -> tuple[Float64, Float64]:
        """Gradients and curvatures of the blocks of the images, (B, K) and (B, K, K); each sums up to the whole."""
        s = self.samples
        block = s.block[s.sample]
        order = np.argsort(block, kind="stable")
        ends = [0, *(np.flatnonzero(np.diff(block[order])) + 1).tolist(), len(order)]
        add = self._summation(s.select(order), x)
        gradients = np.zeros((len(ends) - 1, self.size))
        curvatures = np.zeros((len(ends) - 1, self.size, self.size))
        for number, (start, end) in enumerate(itertools.pairwise(ends)):
            add(start, end, gradients[number], curvatures[number])
        return gradients, np.triu(curvatures) + np.triu(curvatures, 1).transpose(0, 2, 1)

    def _summation(self, s: Samples, x: Float64) -> Callable[[int, int, Float64, Float64], float]:
        # sums over a range of the observations of some samples, as :func:`sum_in_chunks` takes it
        c, dc = lagrange(self.log_sigmas, float(x[LOG_SIGMA]))
        sensor = (
            s.sensor.black_level,
            s.sensor.read_noise_levels**2,
            1.0 / s.sensor.electrons_per_level if s.sensor.electrons_per_level else 0.0,
            float(math.ceil(s.sensor.saturated_from)),  # the level from which a pixel is saturated
            (1.0 - 2.0 * EXTREME_SHARE) / max(1.0, s.sensor.max_level - 1.0),  # density of outliers
        )
        observed, light = (s.sample, s.level, s.saturated, s.image), (s.diffuse, self.specular, c, dc)
        return lambda start, end, *sums: _accumulate(observed, start, end, light, s.facts, sensor, x, sums)


def likelihood_at(samples: Samples, log_sigma: float) -> Likelihood:
    light = samples.specular(math.exp(log_sigma))
    return Likelihood(samples, np.array([log_sigma]), light[:, None])


def predicted(samples: Samples, specular: Float64, x: Float64) -> Float64:
    """Sensor levels, not clipped, of each observation, (N,), by `x` and the light per unit of R_s at its σ, (n,)."""
    light = x[R_D] * samples.diffuse + math.exp(x[LOG_R_S]) * specular
    factor = samples.facts.factor * np.exp(x[FIRST_GAIN + samples.facts.light])
    return samples.sensor.black_level + x[DARK] + factor[samples.image] * light[samples.sample]


def clipped_levels(samples: Samples, mean: Float64) -> tuple[Float64, Float64]:
    """Sensor levels of each observation, measured and :func:`predicted`, both clipped where the camera clips, (N,)."""
    top = samples.sensor.saturated_from
    return np.minimum(samples.level.astype(np.float64), top), np.clip(mean, 0.0, top)


def lagrange(nodes: Float64, at: float) -> tuple[Float64, Float64]:
    """Weights of the values at `nodes` in the interpolating polynomial at a place, and in its derivative there."""
    m = len(nodes)
    weights, slopes = np.ones(m), np.zeros(m)
    if m == 1:
        return weights, slopes
    for j in range(m):
        others = [k for k in range(m) if k != j]
        scale = math.prod(nodes[j] - nodes[k] for k in others)
        weights[j] = math.prod(at - nodes[k] for k in others) / scale
        slopes[j] = sum(math.prod(at - nodes[k] for k in others if k != i) for i in others) / scale
    return weights, slopes


@kernel
def _normal_interval(a: float, b: float) -> float:
    # Φ(b) − Φ(a) without cancellation in either tail
    if a > 0.0:
        return 0.5 * (math.erfc(a * _SQRT_HALF) - math.erfc(b * _SQRT_HALF))
    return 0.5 * (math.erfc(-b * _SQRT_HALF) - math.erfc(-a * _SQRT_HALF))


@kernel
def _accumulate(
    observed: _Observed, start: int, end: int, light: Light, facts: ImageFacts, sensor: _Noise, x: Float64, sums: Sums
) -> float:
    (sample, level, saturated, image), (diffuse, specular, c, dc) = observed, light
    (black, read_variance, levels_per_electron, ceiling, spread_outliers), (gradient, curvature) = sensor, sums
    size = len(x)
    r_d, r_s, dark = x[0], math.exp(x[1]), x[3]
    factor_of = image_factors(facts, x)
    tau2 = math.exp(x[size - 2])
    epsilon = 1.0 / (1.0 + math.exp(-x[size - 1]))
    total = 0.0
    for j in range(start, end):
        i, m = sample[j], image[j]
        factor = factor_of[m]
        s, ds = specular_and_slope(i, specular, c, dc)
        signal = factor * (r_d * diffuse[i] + r_s * s)
        mean = black + dark + signal
        # the mean of frames has less noise; but it is saturated where any one of them is
        share = 1.0 if saturated[j] else 1.0 / facts.frames[m]
        variance = share * read_variance + tau2
        shot = 0.0
        if signal > 0.0:
            shot = share * levels_per_electron
            variance += shot * signal
        deviation = math.sqrt(variance)
        q, half = level[j], facts.half_width[m]
        # the interval that the signal was in, in standard deviations from the mean
        a, b, outlier = -math.inf, math.inf, spread_outliers
        if saturated[j]:
            a = (min(q, ceiling) - half - mean) / deviation if half >= 0.5 else (q - mean) / deviation
            outlier = EXTREME_SHARE
        elif q <= 0.0:
            b = (half - mean) / deviation
            outlier = EXTREME_SHARE
        else:
            a, b = (q - half - mean) / deviation, (q + half - mean) / deviation
            outlier *= 2.0 * half
        f = _normal_interval(a, b)
        pa = math.exp(-0.5 * a * a) / _SQRT_TWO_PI if a > -math.inf else 0.0
        pb = math.exp(-0.5 * b * b) / _SQRT_TWO_PI if b < math.inf else 0.0
        apa = a * pa if pa > 0.0 else 0.0
        bpb = b * pb if pb > 0.0 else 0.0
        p = (1.0 - epsilon) * f + epsilon * outlier
        total += math.log(p)
        by_mean = (pa - pb) / deviation
        by_variance = (apa - bpb) / (2.0 * variance)
        inside = (1.0 - epsilon) / p
        score = inside * (by_mean + shot * by_variance)
        surely = inside * f
        bend = 0.0
        if f > 1e-200:
            ratio = by_mean / f
            bend = min(max(ratio * ratio - (apa - bpb) / (variance * f), 0.0), 1.0 / variance)
        bend *= surely
        slopes = factor * diffuse[i], factor * r_s * s, factor * r_s * ds, signal
        # the dark level makes no shot noise
        add_slopes(score, inside * by_mean, bend, 4 + facts.light[m], slopes, sums)
        part = tau2 / variance
        gradient[size - 2] += inside * by_variance * tau2
        curvature[size - 2, size - 2] += 0.5 * surely * part * part
        gradient[size - 1] += (outlier - f) / p * epsilon * (1.0 - epsilon)
        curvature[size - 1, size - 1] += epsilon * (1.0 - epsilon)
    return total
