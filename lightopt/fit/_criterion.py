"""What a fit makes as large as possible, as a function of all parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lightopt.fit._samples import Samples

__all__ = ["DARK", "FIRST_GAIN", "LOG_R_S", "LOG_SIGMA", "R_D", "Criterion", "Evaluation", "parameter_name"]

Float64 = NDArray[np.float64]

R_D, LOG_R_S, LOG_SIGMA, DARK, FIRST_GAIN = 0, 1, 2, 3, 4
"""Places in the vector of parameters: R_d, ln R_s, ln σ, dark level, then ln gain per light, ln τ², logit ε."""


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
