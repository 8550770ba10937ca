"""The wider of two lobes: its height and width relative to the narrow one, which the other fits take as given.

The criterion's maximum over all other parameters is a function of these two. It is climbed by the simplex method on the
scan's pixels, and bent there: its curvature gives their covariance, and the maxima on both sides how the other
parameters follow.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.estimate.reflectance._clipped_least_squares import (
    MOST_MISFIT,
    LeastSquares,
    SpecularTable,
    measure_misfit,
)
from lightopt.estimate.reflectance._estimate import CHI2_95, Estimate, FreeParameters, Maximum, maximise
from lightopt.estimate.reflectance._likelihood import LOG_R_S, LOG_SIGMA
from lightopt.estimate.reflectance._likelihood_fit import USUAL_TABLE, climb
from lightopt.estimate.reflectance._samples import Samples, subsample
from lightopt.estimate.reflectance._sigma_scan import scan_budget, scan_sigma
from lightopt.optics import SpecularModel

# starts of the search, as ln of the wide lobe's share and of its width over the narrow one's
STARTS = tuple((math.log(share), math.log(ratio)) for share in (0.1, 0.01, 0.001) for ratio in (2.5, 6.0))
SHARES, RATIOS = (math.log(1e-6), 0.0), (math.log(1.05), math.log(100.0))  # as part files allow, in logarithms
AT_END = 0.01  # of a range of logarithms: the search ended at its end
STEP = 0.02  # of both logarithms, over which the criterion is bent
MOST_STEPS = 120
FINE = 3e-4  # of both logarithms: the simplex that ends the search
MOST_DEVIATION = 10.0  # standard deviation of a logarithm that bends nothing
UNDETERMINED = 0.5  # standard deviation of a logarithm that the images do not determine


@dataclass(frozen=True, eq=False, kw_only=True)
class WideLobe:
    """The wider lobe as fitted.

    model: With its share and its ratio
    covariance: Of their logarithms, shape (2, 2)
    slopes: How ln R_s and ln σ follow these logarithms, shape (2, 2)
    """

    model: SpecularModel
    covariance: Float64
    slopes: Float64

    def standard_error(self, found: Estimate, of_narrow: Float64, of_wide: Float64) -> float:
        """Standard error of a sum of logarithms.

        found: The fit of the other parameters
        of_narrow: Factors of ln R_s and ln σ
        of_wide: Factors of ln share and ln ratio
        """
        places = [found.free.index(place) for place in (LOG_R_S, LOG_SIGMA)]
        inner = found.covariance[np.ix_(places, places)] * np.sqrt(np.outer(*[found.inflation[places]] * 2))
        outer = self.slopes.T @ of_narrow + of_wide
        inflation = float(np.mean(found.inflation[places])) * found.critical / CHI2_95
        return math.sqrt(float(of_narrow @ inner @ of_narrow) + inflation * float(outer @ self.covariance @ outer))


def fit_wide_lobe(samples: Samples, *, freed: FreeParameters, held: Float64 | None, run: RunContext) -> WideLobe:
    """Fit the wider lobe's share and ratio, together with all other parameters."""
    few = subsample(samples, scan_budget(samples))
    report = run.stage("wide lobe")
    profiles = _Profiles(few, freed, held)
    best, top = max(profiles.starts(), key=lambda one: one[1].value)
    report(0.3)

    def fall(at: Float64) -> float:
        nonlocal best, top
        found = profiles.at(at, top.x)
        if found is None:
            return math.inf
        if found.value > top.value:
            best, top = at.copy(), found
        return -found.value

    simplex = best + np.array([[0.0, 0.0], [0.3, 0.0], [0.0, 0.2]])
    minimize(
        fall,
        best,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": FINE, "fatol": 1e-3, "maxfev": MOST_STEPS},
    )
    report(0.8)
    hessian, slopes = _bent(profiles, best, top)
    # a criterion of all samples bends as many times more as there are more of them
    hessian *= len(samples.sample) / max(1, len(few.sample))
    values, vectors = np.linalg.eigh(0.5 * (hessian + hessian.T))
    covariance = (vectors / np.maximum(values, MOST_DEVIATION**-2)) @ vectors.T
    report(1.0)
    _refuse_undetermined(best, covariance)
    return WideLobe(model=profiles.model(best), covariance=covariance, slopes=slopes)


def _refuse_undetermined(best: Float64, covariance: Float64) -> None:
    ends = [low + AT_END >= at or at >= high - AT_END for at, (low, high) in zip(best, (SHARES, RATIOS), strict=True)]
    if any(ends) or float(np.max(np.diag(covariance))) > UNDETERMINED**2:
        raise InputError(
            f"model two-lobe: the images do not determine a second, wider and lower lobe: its best R_s is "
            f"{math.exp(best[0]):.3g} of that of the narrow one, its best width {math.exp(best[1]):.3g} times as much. "
            "Fit torrance-sparrow or ggx, or add images at other exposures and under further lights"
        )


class _Profiles:
    # maxima of the criterion over all parameters but the wide lobe's

    def __init__(self, few: Samples, freed: FreeParameters, held: Float64 | None) -> None:
        one = replace(few, model=replace(few.model, wide_share=0.0, wide_ratio=1.0))
        scan = scan_sigma(one, freed, held)
        self._few, self._free, self._first = few, scan.free, scan.best.x
        self._describes = False

    def model(self, at: Float64) -> SpecularModel:
        return replace(self._few.model, wide_share=math.exp(at[0]), wide_ratio=math.exp(at[1]))

    def starts(self) -> Iterator[tuple[Float64, Maximum]]:
        # by least squares; what describes the images there decides by which criterion the search goes on
        found: list[tuple[Float64, Maximum, float]] = []
        for start in STARTS:
            at = np.array(start)
            some = replace(self._few, model=self.model(at))
            criterion = LeastSquares(some, SpecularTable(some))
            for narrower in (1.0, 0.5):
                x = self._first.copy()
                x[LOG_SIGMA] += math.log(narrower)
                x[LOG_R_S] -= math.log(narrower)
                top = maximise(criterion, x, self._free[:-2])
                found.append((at, top, top.value))
            if len(found) >= 2 and found[-1][2] >= max(value for _, _, value in found):
                self._describes = measure_misfit(criterion, found[-1][1].x) <= MOST_MISFIT
        found.sort(key=lambda one: -one[2])
        for at, top, _ in found[:3]:
            better = self.at(at, top.x)
            if better is not None:
                yield at, better

    def at(self, at: Float64, x: Float64) -> Maximum | None:
        if not (SHARES[0] <= at[0] <= SHARES[1] and RATIOS[0] <= at[1] <= RATIOS[1]):
            return None
        some = replace(self._few, model=self.model(at))
        if self._describes:
            return climb(some, x, self._free, USUAL_TABLE).maximum
        return maximise(LeastSquares(some, SpecularTable(some)), x, self._free[:-2])


def _bent(profiles: _Profiles, best: Float64, top: Maximum) -> tuple[Float64, Float64]:
    # minus the second derivatives of the maximum, and the derivatives of ln R_s and ln σ where it is
    steps = STEP * np.eye(2)
    found: dict[tuple[int, int], Maximum] = {}
    for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1)):
        # beside a bound the place itself stands for the one beyond
        found[i, j] = profiles.at(best + i * steps[0] + j * steps[1], top.x) or top
    value = {place: one.value for place, one in found.items()}
    along = [2.0 * top.value - value[1, 0] - value[-1, 0], 2.0 * top.value - value[0, 1] - value[0, -1]]
    diagonal = 2.0 * top.value - value[1, 1] - value[-1, -1]
    cross = 0.5 * (diagonal - along[0] - along[1])
    hessian = np.array([[along[0], cross], [cross, along[1]]]) / STEP**2
    inner = [LOG_R_S, LOG_SIGMA]
    both = found[1, 0].x[inner] - found[-1, 0].x[inner], found[0, 1].x[inner] - found[0, -1].x[inner]
    return hessian, np.stack(both, axis=1) / (2.0 * STEP)
