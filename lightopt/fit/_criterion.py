"""What a fit makes as large as possible, as a function of all parameters."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lightopt.fit._samples import Samples
from lightopt.kernels import kernel
from lightopt.rendering import in_threads

__all__ = [
    "DARK",
    "FIRST_GAIN",
    "LOG_R_S",
    "LOG_SIGMA",
    "R_D",
    "SLOPES",
    "Criterion",
    "Evaluation",
    "parameter_name",
    "signal_and_slopes",
    "sum_pieces",
]

Float64 = NDArray[np.float64]

R_D, LOG_R_S, LOG_SIGMA, DARK, FIRST_GAIN = 0, 1, 2, 3, 4
"""Places in the vector of parameters: R_d, ln R_s, ln σ, dark level, then ln gain per light, ln τ², logit ε."""

SLOPES = 5
"""Parameters that the level of a pixel depends on: R_d, ln R_s, ln σ, the gain of its light, the dark level."""


@dataclass(frozen=True)
class Evaluation:
    """A criterion at a vector of parameters.

    Attributes
    ----------
    value
        Log-likelihood [nat].
    gradient
        Shape (K,).
    curvature
        Positive semi-definite matrix that stands for minus the Hessian in a Newton step, shape (K, K).
    """

    value: float
    gradient: Float64
    curvature: Float64


class Criterion(Protocol):
    """A log-likelihood of samples: the censored one of noise and outliers, or that of least squares."""

    samples: Samples

    @property
    def size(self) -> int:
        """Number of parameters K."""
        ...

    @property
    def sigma_range(self) -> tuple[float, float]:
        """Values of ln σ for which it can be evaluated."""
        ...

    def evaluate(self, x: Float64) -> Evaluation:
        """Value, gradient and curvature at the parameters `x`, shape (K,)."""
        ...


def parameter_name(place: int, lights: tuple[str, ...]) -> str:
    """What a place in the vector of parameters is called; `lights` are the names of the scene's lights."""
    names = ["R_d", "R_s", "σ", "the dark level"]
    names += [f"the gain of {light}" for light in lights]
    names += ["the deviation beside the noise", "the share of outliers"]
    return names[place]


def sum_pieces(
    add: Callable[[int, int, Float64, Float64], float],
    count: int,
    size: int,
    *,
    piece: int,
    threads: int | None,
) -> tuple[float, Float64, Float64]:
    """Value, gradient and curvature of all observations, worked out in pieces side by side.

    Parameters
    ----------
    add
        Returns the value of the observations from one number to another, and adds to the gradient, shape (K,), and the
        curvature, shape (K, K), that it is given.
    count, size
        Number of observations, and of parameters K.
    piece
        Observations at a time.
    threads
        Number of threads; the result does not depend on it.
    """

    def one(start: int) -> tuple[float, Float64, Float64]:
        gradient, curvature = np.zeros(size), np.zeros((size, size))
        value = add(start, min(start + piece, count), gradient, curvature)
        return value, gradient, curvature

    parts = in_threads(one, range(0, count, piece), threads)
    return (
        sum(p[0] for p in parts),
        np.sum([p[1] for p in parts], axis=0),
        np.sum([p[2] for p in parts], axis=0),
    )


@kernel
def signal_and_slopes(
    i: int,
    m: int,
    diffuse: Float64,
    specular: Float64,
    c: Float64,
    dc: Float64,
    factors: Float64,
    lights: NDArray[np.int32],
    x: Float64,
    place: NDArray[np.int64],
    slope: Float64,
) -> float:
    """Level above the dark level that pixel `i` has in image `m`, and its slopes.

    Parameters
    ----------
    i, m
        Numbers of the pixel and of the image.
    diffuse, specular
        Light per unit of R_d, shape (n,), and of R_s at the nodes of ln σ, shape (n, w).
    c, dc
        Weights of the nodes for the light and for its slope by ln σ, shape (w,).
    factors, lights
        Of the images: exposure by gain as the rig has it, and the light, shape (M,).
    x
        Parameters, shape (K,).
    place, slope
        Filled with the places of the parameters and the slopes by them, shape (:data:`SLOPES`,); the dark level last.
    """
    r_d, r_s = x[0], math.exp(x[1])
    s = ds = 0.0
    for k in range(len(c)):
        s += c[k] * specular[i, k]
        ds += dc[k] * specular[i, k]
    gain_place = 4 + lights[m]
    factor = factors[m] * math.exp(x[gain_place])
    signal = factor * (r_d * diffuse[i] + r_s * s)
    place[0], slope[0] = 0, factor * diffuse[i]
    place[1], slope[1] = 1, factor * r_s * s
    place[2], slope[2] = 2, factor * r_s * ds
    place[3], slope[3] = gain_place, signal
    place[4], slope[4] = 3, 1.0
    return signal
