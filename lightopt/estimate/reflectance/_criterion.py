"""The criterion that a fit maximises, as a function of all parameters, and what its two kinds share."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.estimate.reflectance._samples import ImageFacts, Samples

# places in the vector of parameters: R_d, ln R_s, ln σ, dark level, then ln gain per light, ln τ², logit ε
R_D, LOG_R_S, LOG_SIGMA, DARK, FIRST_GAIN = 0, 1, 2, 3, 4


@dataclass(frozen=True)
class Evaluation:
    """A criterion at a vector of parameters.

    curvature: Positive semi-definite matrix that stands for minus the Hessian in a Newton step, shape (K, K).
    """

    value: float
    gradient: Float64
    curvature: Float64


class Criterion(Protocol):
    """A log-likelihood of samples: the censored one of noise and outliers, or that of least squares.

    size: Number of parameters K.
    sigma_range: Values of ln σ for which it can be evaluated.
    """

    samples: Samples
    size: int
    sigma_range: tuple[float, float]

    def evaluate(self, x: Float64) -> Evaluation:
        """Value, gradient and curvature at the parameters `x`, shape (K,)."""
        ...


def parameter_count(samples: Samples) -> int:
    """Number of parameters K of a criterion of samples."""
    return FIRST_GAIN + len(samples.lights) + 2


def outlier_share(x: Float64) -> float:
    """Share ε of the pixels that a vector of parameters takes for dust, glints and the like."""
    return 1.0 / (1.0 + math.exp(-x[-1]))


def parameter_name(place: int, lights: tuple[str, ...]) -> str:
    """Name of a place in the vector of parameters, for messages."""
    gains = (f"the gain of {light}" for light in lights)
    noise = ("the deviation beside the noise", "the share of outliers")
    return ("R_d", "R_s", "σ", "the dark level", *gains, *noise)[place]


def sum_in_chunks(
    add: Callable[[int, int, Float64, Float64], float], count: int, size: int, *, chunk: int, threads: int | None
) -> tuple[float, Float64, Float64]:
    """Value, gradient and curvature of all observations, computed in chunks in parallel.

    add: Returns the value of the observations `start` to `end`, and adds to gradient (K,) and curvature (K, K).
    """

    def one(start: int) -> tuple[float, Float64, Float64]:
        gradient, curvature = np.zeros(size), np.zeros((size, size))
        return add(start, min(start + chunk, count), gradient, curvature), gradient, curvature

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
def add_curvature(
    bend: float, gain: int, r_d: float, r_s: float, sigma: float, signal: float, curvature: Float64
) -> None:
    """Add the curvature of one observation to the upper triangle.

    bend: Minus the second derivative of the criterion by the level.
    gain: Place of the gain of its light.
    r_d, r_s, sigma, signal: Slopes of the level by R_d, ln R_s, ln σ and ln gain; that by the dark level is 1.
    """
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


@kernel
def mirror_curvature(curvature: Float64) -> None:
    """Copy the upper triangle to the lower, shape (K, K)."""
    for k in range(len(curvature)):
        for n in range(k):
            curvature[k, n] = curvature[n, k]
