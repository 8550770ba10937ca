"""The estimate: where the criterion is greatest, and its uncertainty."""

import math
from dataclasses import dataclass
from typing import Any

from lightopt.core.arrays import Float64
from lightopt.estimate.reflectance._likelihood import Coefficients, Criterion, outlier_share, significant
from lightopt.estimate.reflectance._newton import Maximum

Interval = tuple[float | None, float | None]  # 95 %; None for an end that the images do not bound

# 95 % quantile of χ² with one degree of freedom: twice the log-likelihood may fall by this (Wilks 1938)
CHI2_95 = 3.841458820694124


@dataclass(frozen=True, kw_only=True)
class FreeParameters:
    """Parameters that a fit may change: R_d, R_s with σ, the lights' gains relative to the first, the dark level."""

    diffuse: bool = True
    specular: bool = True
    gain: bool = False
    dark: bool = False


@dataclass(frozen=True, kw_only=True)
class ScanPoint(Coefficients):
    """The best fit at one σ."""

    x: Float64
    value: float  # criterion at the scan's pixels [nat]
    drop: float  # how far twice the criterion of the estimate is below its maximum there [nat]

    def as_dict(self, best: float) -> dict[str, float]:
        """JSON form; `best` is the greatest value of the profile."""
        values = {"sigma_rad": self.sigma, "R_d": self.R_d, "R_s": self.R_s}
        below = significant(2.0 * (best - self.value), 6)
        return {n: significant(v, 8) for n, v in values.items()} | {"twice_log_likelihood_below_best": below}


@dataclass(frozen=True)
class Optimum:
    """Where the climb from one peak of the profile over σ ended."""

    start_sigma: float
    top: Maximum  # all optima of an estimate are compared by the same criterion
    criterion: Criterion | None  # None for an optimum far below the best

    def as_dict(self) -> dict[str, Any]:
        top = {name: significant(getattr(self.top, name), 8) for name in ("sigma", "R_d", "R_s", "value")}
        return {"start_sigma": significant(self.start_sigma, 8), **top, "converged": self.top.converged}


@dataclass(frozen=True, kw_only=True)
class Estimate(Coefficients):
    """The best fit and its uncertainty."""

    x: Float64  # parameters, shape (K,), in the order of :mod:`lightopt.estimate.reflectance._likelihood`
    free: tuple[int, ...]  # places of the k parameters that were fitted
    covariance: Float64  # of those, shape (k, k), if the model is right
    inflation: Float64  # factor of each of their variances for what the model gets wrong, shape (k,)
    # square of the half-width of a 95 % interval in standard errors: a quantile of χ², or of Student's t where few
    # groups of images determine the variance
    critical: float = CHI2_95
    criterion: Criterion
    maximum: Maximum
    scan: tuple[ScanPoint, ...]  # the profile over σ, with the estimate itself
    # ends of the climbs from the peaks of the profile; the first is the estimate itself
    optima: tuple[Optimum, ...] = ()
    mean_log_likelihood: float  # per level, with noise and outliers [nat]: comparable between fits to the same levels
    unexplained: float  # share of the pixels that the likelihood would leave out as outliers
    misfit: float = 0.0  # residual of least squares over the noise; 0 where that was not tested
    # groups of images that the uncertainty comes from where it does not, such as "12 lights"
    scatter: str | None = None
    unsettled_refits: int = 0  # number of the fits without one of those groups that did not converge

    @property
    def describes(self) -> bool:
        """Whether the model describes the images, so that the likelihood was maximised; else least squares."""
        return self.scatter is None

    @property
    def tau(self) -> float:
        """Deviation that the sensor's noise does not explain [sensor level]."""
        return math.exp(0.5 * self.x[-2])

    @property
    def epsilon(self) -> float:
        """Share of the pixels that the fit takes for dust, glints and the like."""
        return outlier_share(self.x)

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
