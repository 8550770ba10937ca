"""What a fit finds: where the likelihood is greatest, and how sharply."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.fit._likelihood import LOG_R_S, LOG_SIGMA, R_D, Likelihood
from lightopt.fit._maximise import Maximum

__all__ = ["Estimate", "Freed", "ScanPoint"]

Float64 = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Freed:
    """What a fit may change beside R_d, R_s and σ.

    Attributes
    ----------
    diffuse, specular
        Whether R_d, and whether R_s and σ are fitted.
    gain
        Gain of every light, relative to the first one.
    dark
        A constant dark level.
    """

    diffuse: bool = True
    specular: bool = True
    gain: bool = False
    dark: bool = False


@dataclass(frozen=True, kw_only=True)
class ScanPoint:
    """The best fit at one σ.

    Attributes
    ----------
    sigma
        [rad].
    R_d, R_s
        [grey level].
    value
        Log-likelihood of the scan's pixels [nat].
    """

    sigma: float
    R_d: float
    R_s: float
    value: float


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Where the likelihood is greatest, and how sharply.

    Attributes
    ----------
    x
        Parameters, shape (K,), as :mod:`lightopt.fit._likelihood` orders them.
    free
        Places of the parameters that were fitted.
    covariance
        Of those, shape (k, k), if the model is right.
    inflation
        By how much the variance of each of those is larger when what the model gets wrong is alike within a piece of
        the image; at least 1, shape (k,).
    likelihood
        Near the maximum.
    maximum
        How the climb ended.
    scan
        Along σ.
    unexplained
        Share of the pixels that the model would have left out if it could.
    """

    x: Float64
    free: tuple[int, ...]
    covariance: Float64
    inflation: Float64
    likelihood: Likelihood
    maximum: Maximum
    scan: tuple[ScanPoint, ...]
    unexplained: float

    @property
    def R_d(self) -> float:  # noqa: N802
        """[grey level]."""
        return float(self.x[R_D])

    @property
    def R_s(self) -> float:  # noqa: N802
        """[grey level]."""
        return math.exp(self.x[LOG_R_S])

    @property
    def sigma(self) -> float:
        """[rad]."""
        return math.exp(self.x[LOG_SIGMA])

    @property
    def tau(self) -> float:
        """Deviation that the sensor's noise does not explain [sensor level]."""
        return math.exp(0.5 * self.x[-2])

    @property
    def epsilon(self) -> float:
        """Share of the pixels that the fit takes for dust, glints and the like."""
        return 1.0 / (1.0 + math.exp(-self.x[-1]))

    @property
    def mean_log_likelihood(self) -> float:
        """Of a level, each counting once [nat]."""
        plain = self.likelihood
        value = self.maximum.evaluation.value
        if plain.by_area:
            value = (
                Likelihood(plain.samples, plain.log_sigmas, plain.specular, threads=plain.threads)
                .evaluate(self.x)
                .value
            )
        return value / len(plain.samples.level)

    def standard_error(self, place: int) -> float:
        """Standard error of a parameter, for what the model gets wrong as well; 0 for one that was held."""
        if place not in self.free:
            return 0.0
        i = self.free.index(place)
        return math.sqrt(self.covariance[i, i] * self.inflation[i])

    def correlation(self, first: int, second: int) -> float:
        """Correlation of two parameters that were fitted."""
        i, j = self.free.index(first), self.free.index(second)
        return float(self.covariance[i, j] / math.sqrt(self.covariance[i, i] * self.covariance[j, j]))
