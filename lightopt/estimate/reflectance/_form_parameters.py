"""Parameters of the reflectance's form, which the other fits take as given.

They are the exponent or the roughness of the diffuse component; the logarithm of how many times wider the lobe of a
brushed surface is across the brushing; of two lobes the logarithms of height and width of the wide one, relative to the
narrow one.

The criterion's maximum over all other parameters is a function of these. It is searched on the scan's pixels, first by
least squares, then by the likelihood where the best of that describes the images, and bent there: its curvature gives
the covariance, and the maxima on both sides how the other parameters follow. The curvature of least squares is no
covariance where the noise differs between pixels.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from lightopt.config import MOST_ACROSS
from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.estimate.reflectance import _clipped_least_squares as clipped
from lightopt.estimate.reflectance._clipped_least_squares import LeastSquares, SpecularTable
from lightopt.estimate.reflectance._estimate import CHI2_95, Estimate, FreeParameters, Maximum, maximise
from lightopt.estimate.reflectance._fit_samples import USUAL_TABLE, climb
from lightopt.estimate.reflectance._result import DIFFUSE_KEYS, FittedValue
from lightopt.estimate.reflectance._samples import Samples, relit, subsample
from lightopt.estimate.reflectance._sigma_scan import SigmaScan, scan_budget, scan_sigma
from lightopt.estimate.reflectance._vector import LOG_R_S, LOG_SIGMA, R_D
from lightopt.geometry import RayCaster
from lightopt.optics import LAMBERT, DiffuseForm, SpecularModel

ParameterName = Literal["exponent", "oren-nayar", "across"]
# as part files allow; a lobe that is alike all round is no brushed one
RANGES: dict[ParameterName, tuple[float, float]] = {
    "exponent": (0.5, 5.0),
    "oren-nayar": (0.0, 1.0),
    "across": (0.0, math.log(MOST_ACROSS)),
}
STARTS: dict[ParameterName, tuple[float, ...]] = {
    "exponent": (0.6, 0.8, 1.0, 1.4, 2.2, 4.0),
    "oren-nayar": (0.0, 0.3, 0.7),
    "across": tuple(map(math.log, (1.5, 2.5, 4.0, 7.0, 12.0, 25.0))),
}
STEP = 0.03  # over which the criterion is bent
FINE = 5e-4  # to which the parameter is searched
UNDETERMINED = 0.3  # standard error of a parameter that the images do not determine
# of the wide lobe: starts of the search, as ln of its share and of its width over the narrow one's
WIDE_STARTS = tuple((math.log(share), math.log(ratio)) for share in (0.1, 0.01, 0.001) for ratio in (2.5, 6.0))
WIDE_RANGES = np.log([[1e-6, 1.0], [1.05, 100.0]])  # as part files allow, in logarithms
AT_END = 0.01  # of a range of logarithms: the search ended at its end
MOST_STEPS = 60
WIDE_FINE = 0.01  # of both logarithms: the simplex that ends the search by least squares; bends go on from there
# The criterion is bent over one standard deviation along each axis of the covariance: two lobes share the light between
# them, so that one axis has several times the deviation of the other, and no steps of the logarithms suit both. No step
# is longer than this, over which the first bend is.
WIDE_STEP = 0.02
# A bend is the last where the top of the parabola is within this share of a step, and the curvature within this share
# of what the steps were chosen for. From one bend to the next the search moves no farther than so many steps.
AT_TOP, AS_EXPECTED, MOST_BENDS, LONGEST_MOVE = 0.1, 0.2, 10, 4.0
OPPOSITE = ((1, 0), (-1, 0)), ((0, 1), (0, -1))
AROUND = (*OPPOSITE[0], *OPPOSITE[1], (1, 1), (-1, -1))
FOLLOWERS = [R_D, LOG_R_S, LOG_SIGMA]
MOST_DEVIATION = 10.0  # standard deviation of a logarithm that bends nothing
WIDE_UNDETERMINED = 0.5  # standard deviation of a logarithm that the images do not determine


@dataclass(frozen=True, eq=False, kw_only=True)
class FittedParameter:
    name: ParameterName
    value: float  # as the scan's pixels have it
    variance: float
    slopes: Float64  # how R_d, ln R_s and ln σ follow the parameter, shape (3,)

    def values(self, found: Estimate, others: Sequence[FittedValue], model: SpecularModel) -> tuple[FittedValue, ...]:
        """Coefficients and the form's parameter, whose uncertainty the coefficients' errors and intervals include.

        others: The coefficients, as fitted with the form held
        model: Of the lobe
        """
        width = next(one for one in others if one.name == model.width_key)
        own = math.sqrt(self.variance * float(np.mean(found.inflation)) * found.critical / CHI2_95)
        units = (1.0, found.R_s, width.value)
        slopes = dict(zip(("R_d", "R_s", model.width_key), self.slopes * units, strict=True))
        widened = [_widened(one, abs(slopes.get(one.name, 0.0)) * own) for one in others]
        root = math.sqrt(CHI2_95)
        if self.name != "across":
            low, high = RANGES[self.name]
            interval = max(low, self.value - root * own), min(high, self.value + root * own)
            return (*widened, FittedValue(DIFFUSE_KEYS[self.name], self.value, own, interval))
        value = width.value * math.exp(self.value)
        # its logarithm is that of the width along the brushing, which follows the parameter, and the parameter
        error = math.hypot(width.standard_error / width.value, (1.0 + float(self.slopes[2])) * own)
        ends = value * math.exp(-root * error), value * math.exp(root * error)
        return (*widened, FittedValue(model.across_key, value, value * error, ends))


def _widened(one: FittedValue, more: float) -> FittedValue:
    if not one.standard_error or one.interval is None:
        return one
    error = math.hypot(one.standard_error, more)
    ratio = error / one.standard_error
    low, high = (None if end is None else one.value + ratio * (end - one.value) for end in one.interval)
    return replace(one, standard_error=error, interval=(low, high))


def changed_form(
    model: SpecularModel, form: DiffuseForm, name: ParameterName, value: float
) -> tuple[SpecularModel, DiffuseForm]:
    if name == "across":
        return replace(model, across_ratio=math.exp(value)), form
    return model, DiffuseForm(exponent=value) if name == "exponent" else DiffuseForm(roughness=value)


def fit_form_parameter(
    samples: Samples, name: ParameterName, *, caster: RayCaster, freed: FreeParameters, run: RunContext
) -> FittedParameter:
    """Fit exponent, roughness or the width across the brushing, together with all other parameters.

    Raises InputError: images that do not determine it
    """
    report = run.stage("width across the brushing" if name == "across" else "diffuse form")
    few = subsample(samples, scan_budget(samples))
    profile = _Profile(few, name, caster, freed)
    report(0.2)
    start = max(STARTS[name], key=lambda value: profile.at(value).value)
    report(0.5)
    value = profile.search(start)
    if profile.describes(value):
        profile.likelihood = True
        value = profile.search(value)
    report(0.9)
    low, high = RANGES[name]
    # beside an end the criterion is bent towards the middle
    middle = min(max(value, low + STEP), high - STEP)
    below, top, above = (profile.at(middle + step) for step in (-STEP, 0.0, STEP))
    bend = (2.0 * top.value - below.value - above.value) / STEP**2
    report(1.0)
    at_end = name != "oren-nayar" and not low + STEP < value < high - STEP
    if at_end or bend <= UNDETERMINED**-2:
        raise InputError(_undetermined(few.model, name, value))
    places = [R_D, LOG_R_S, LOG_SIGMA]
    slopes = (above.x[places] - below.x[places]) / (2.0 * STEP)
    return FittedParameter(name=name, value=value, variance=1.0 / bend, slopes=slopes)


def _undetermined(model: SpecularModel, name: ParameterName, value: float) -> str:
    if name == "across":
        return (
            f"the images do not determine {model.across_key}, whose best value is {math.exp(value):.3g} times that of "
            f"{model.width_key}. Remove the brushing from the part file, or add postures that turn the brushing"
        )
    return (
        f"diffuse {name}: the images do not determine {DIFFUSE_KEYS[name]}, whose best value is {value:.3g}. Fit "
        "another form, or add images in which more of the surface is away from the highlights"
    )


class _Profile:
    # maxima of the criterion over all parameters but the form's

    def __init__(self, few: Samples, name: ParameterName, caster: RayCaster, freed: FreeParameters) -> None:
        self._few, self._caster = few, caster
        self._name: ParameterName = name
        scan = scan_sigma(few, freed, None)
        self._free, self._x, self._table = scan.free, scan.best.x, SpecularTable(few)
        self.likelihood = False

    def _samples(self, value: float) -> Samples:
        model, form = changed_form(self._few.model, LAMBERT, self._name, value)
        if self._name == "across":
            return replace(self._few, model=model)
        return relit(self._few, self._caster, form=form)

    def _least_squares(self, value: float) -> LeastSquares:
        some = self._samples(value)
        return LeastSquares(some, SpecularTable(some) if self._name == "across" else self._table)

    def at(self, value: float) -> Maximum:
        if not self.likelihood:
            return maximise(self._least_squares(value), self._x, self._free[:-2])
        return climb(self._samples(value), self._x, self._free, USUAL_TABLE).maximum

    def describes(self, value: float) -> bool:
        return clipped.measure_misfit(self._least_squares(value), self._x) <= clipped.MOST_MISFIT

    def search(self, start: float) -> float:
        # between the starts on both sides; climbs begin where the one at the start ends
        ends = sorted({*RANGES[self._name], *STARTS[self._name]})
        low = max((end for end in ends if end < start), default=ends[0])
        high = min((end for end in ends if end > start), default=ends[-1])
        self._x = self.at(start).x
        found: Any = minimize_scalar(
            lambda value: -self.at(value).value, bounds=(low, high), method="bounded", options={"xatol": FINE}
        )
        value = float(found.x)
        self._x = self.at(value).x
        return value


@dataclass(frozen=True, eq=False, kw_only=True)
class WideLobe:
    model: SpecularModel  # with its share and its ratio
    covariance: Float64  # of their logarithms, shape (2, 2)
    slopes: Float64  # how R_d, ln R_s and ln σ follow these, shape (3, 2)

    def values(self, found: Estimate, others: Sequence[FittedValue], model: SpecularModel) -> tuple[FittedValue, ...]:
        """R_d, and height and width of both lobes, whose logarithms are normal.

        others, model: As of :class:`FittedParameter`
        """

        def variance(outer: Float64) -> float:
            # by the wide lobe, of what follows its logarithms like this, shape (2,)
            return inflation * float(outer @ self.covariance @ outer)

        places = [found.free.index(place) for place in (LOG_R_S, LOG_SIGMA)]
        inner = np.diag(found.covariance)[places] * found.inflation[places]
        inflation = float(np.mean(found.inflation[places])) * found.critical / CHI2_95
        names = ("R_s", "sigma_rad", "R_s_wide", "sigma_wide_rad")
        narrow, factors = (found.R_s, found.sigma), (1.0, 1.0, model.wide_share, model.wide_ratio)
        values: list[FittedValue] = []
        for number, (name, factor) in enumerate(zip(names, factors, strict=True)):
            own = number % 2
            value = narrow[own] * factor
            outer = self.slopes[1 + own] + (np.eye(2)[own] if number > 1 else 0.0)
            error = math.sqrt(float(inner[own]) + variance(outer))
            reach = math.sqrt(CHI2_95) * error
            ends = value * math.exp(-reach), value * math.exp(reach)
            values.append(FittedValue(name, value, value * error, ends))
        return _widened(others[0], math.sqrt(variance(self.slopes[0]))), *values


def fit_wide_lobe(samples: Samples, *, freed: FreeParameters, held: Float64 | None, run: RunContext) -> WideLobe:
    """Fit the wider lobe's share and ratio, together with all other parameters.

    Raises InputError: Images that do not determine them
    """
    few = subsample(samples, scan_budget(samples))
    report = run.stage("wide lobe")
    scan = scan_sigma(_with_wide(few, None), freed, held)
    describes = False

    def maximum(at: Float64, x: Float64) -> Maximum | None:
        if np.any((at < WIDE_RANGES[:, 0]) | (at > WIDE_RANGES[:, 1])):
            return None
        some = _with_wide(few, at)
        if describes:
            return climb(some, x, scan.free, USUAL_TABLE).maximum
        return maximise(LeastSquares(some, SpecularTable(some)), x, scan.free[:-2])

    tops = [(at, found) for at, x in _wide_starts(few, scan) if (found := maximum(at, x)) is not None]
    best, top = max(tops, key=lambda one: one[1].value)
    report(0.3)

    def fall(at: Float64) -> float:
        nonlocal best, top
        found = maximum(at, top.x)
        if found is None:
            return math.inf
        if found.value > top.value:
            best, top = at.copy(), found
        return -found.value

    simplex = best + np.array([[0.0, 0.0], [0.3, 0.0], [0.0, 0.2]])
    options = {"initial_simplex": simplex, "xatol": WIDE_FINE, "fatol": 1e-3, "maxfev": MOST_STEPS}
    minimize(fall, best, method="Nelder-Mead", options=options)
    report(0.5)
    # which criterion is bent is decided where the search ended: no start describes the images
    some = _with_wide(few, best)
    describes = clipped.measure_misfit(LeastSquares(some, SpecularTable(some)), top.x) <= clipped.MOST_MISFIT
    if describes:
        top = maximum(best, top.x) or top
    # columns are the steps of the bend, and minus the second derivatives that are expected over them
    axes, expected = WIDE_STEP * np.eye(2), np.full((2, 2), np.inf)
    covariance, slopes = np.zeros((2, 2)), np.zeros((3, 2))
    for _ in range(MOST_BENDS):
        back = np.linalg.inv(axes)
        # beside a bound the place itself stands for the one beyond
        around = {place: maximum(best + axes @ place, top.x) or top for place in AROUND}
        followed = [0.5 * (around[ahead].x - around[behind].x)[FOLLOWERS] for ahead, behind in OPPOSITE]
        slopes = np.stack(followed, axis=1) @ back
        gradient = np.array([0.5 * (around[ahead].value - around[behind].value) for ahead, behind in OPPOSITE])
        hessian = _bend(top, around)
        values, vectors = np.linalg.eigh(back.T @ hessian @ back)
        deviations = np.maximum(values, MOST_DEVIATION**-2) ** -0.5
        covariance = (vectors * deviations**2) @ vectors.T
        move = covariance @ back.T @ gradient
        far = float(np.max(np.abs(back @ move)))
        fall(best + min(1.0, LONGEST_MOVE / max(far, 1e-300)) * move)
        if far < AT_TOP and np.allclose(hessian, expected, rtol=0.0, atol=AS_EXPECTED):
            break
        steps = np.minimum(deviations, WIDE_STEP)
        axes, expected = vectors * steps, np.diag((steps / deviations) ** 2)
    report(1.0)
    ends = (best <= WIDE_RANGES[:, 0] + AT_END) | (best >= WIDE_RANGES[:, 1] - AT_END)
    if ends.any() or float(np.max(np.diag(covariance))) > WIDE_UNDETERMINED**2:
        raise InputError(
            f"model two-lobe: the images do not determine a second, wider and lower lobe: its best R_s is "
            f"{math.exp(best[0]):.3g} of that of the narrow one, its best width {math.exp(best[1]):.3g} times as much. "
            "Fit torrance-sparrow or ggx, or add images at other exposures and under further lights"
        )
    return WideLobe(model=_with_wide(few, best).model, covariance=covariance, slopes=slopes)


def _bend(top: Maximum, around: dict[tuple[int, int], Maximum]) -> Float64:
    # minus the second derivatives of the maximum by two steps, shape (2, 2)
    falls = {place: 2.0 * top.value - around[place].value - around[-place[0], -place[1]].value for place in around}
    cross = 0.5 * (falls[1, 1] - falls[1, 0] - falls[0, 1])
    return np.array([[falls[1, 0], cross], [cross, falls[0, 1]]])


def _with_wide(few: Samples, at: Float64 | None) -> Samples:
    # with ln of the wide lobe's share and ratio; without that lobe for None
    share, ratio = (0.0, 1.0) if at is None else (math.exp(at[0]), math.exp(at[1]))
    return replace(few, model=replace(few.model, wide_share=share, wide_ratio=ratio))


def _wide_starts(few: Samples, scan: SigmaScan) -> list[tuple[Float64, Float64]]:
    # the three best by least squares, as the wide lobe's and all parameters
    found: list[tuple[Float64, Maximum]] = []
    for start in WIDE_STARTS:
        at = np.array(start)
        some = _with_wide(few, at)
        criterion = LeastSquares(some, SpecularTable(some))
        for narrower in (1.0, 0.5):
            x = scan.best.x.copy()
            x[LOG_SIGMA] += math.log(narrower)
            x[LOG_R_S] -= math.log(narrower)
            found.append((at, maximise(criterion, x, scan.free[:-2])))
    found.sort(key=lambda one: -one[1].value)
    return [(at, top.x) for at, top in found[:3]]
