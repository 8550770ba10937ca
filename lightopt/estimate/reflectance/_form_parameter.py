"""A parameter of the reflectance's form, which the other fits take as given.

It is the exponent or the roughness of the diffuse component, or the logarithm of how many times wider the lobe of a
brushed surface is across the brushing.

The criterion's maximum over all other parameters is a function of this one. It is searched on the scan's pixels, first
by least squares, then by the likelihood where that describes the images, and bent there: its curvature gives the
standard error, and the maxima on both sides how the other parameters follow.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.optimize import minimize_scalar

from lightopt.config import MOST_ACROSS
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
from lightopt.estimate.reflectance._likelihood import LOG_R_S, LOG_SIGMA, R_D
from lightopt.estimate.reflectance._likelihood_fit import USUAL_TABLE, climb
from lightopt.estimate.reflectance._result import DIFFUSE_KEYS, FittedValue
from lightopt.estimate.reflectance._samples import Samples, subsample, with_form
from lightopt.estimate.reflectance._sigma_scan import scan_budget, scan_sigma
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


@dataclass(frozen=True, eq=False, kw_only=True)
class FittedParameter:
    """A parameter of the form as fitted.

    value, variance: Of the parameter, as the scan's pixels have it
    slopes: How R_d, ln R_s and ln σ follow the parameter, shape (3,)
    """

    name: ParameterName
    value: float
    variance: float
    slopes: Float64

    def values(self, found: Estimate, others: Sequence[FittedValue], model: SpecularModel) -> tuple[FittedValue, ...]:
        """Coefficients and the form's parameter, whose uncertainty the coefficients' errors and intervals include.

        others: The coefficients, as fitted with the form held
        model: Of the lobe
        """
        width_key = model.width_key
        own = math.sqrt(self.variance * float(np.mean(found.inflation)) * found.critical / CHI2_95)
        slopes = dict(zip(("R_d", "R_s", width_key), self.slopes * (1.0, found.R_s, 1.0), strict=True))
        slopes[width_key] *= next(one.value for one in others if one.name == width_key)
        low, high = RANGES[self.name]
        reach = math.sqrt(CHI2_95) * own
        interval = max(low, self.value - reach), min(high, self.value + reach)
        widened = [_widened(one, abs(slopes.get(one.name, 0.0)) * own) for one in others]
        if self.name != "across":
            return (*widened, FittedValue(DIFFUSE_KEYS[self.name], self.value, own, interval))
        width = next(one for one in others if one.name == width_key)
        value = width.value * math.exp(self.value)
        # its logarithm is that of the width along the brushing, which follows the parameter, and the parameter
        error = math.hypot((width.standard_error or 0.0) / width.value, (1.0 + float(self.slopes[2])) * own)
        ends = value * math.exp(-math.sqrt(CHI2_95) * error), value * math.exp(math.sqrt(CHI2_95) * error)
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
    """Lobe and form of the diffuse component with another value of the parameter."""
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
        return with_form(self._few, form, self._caster)

    def _least_squares(self, value: float) -> LeastSquares:
        some = self._samples(value)
        return LeastSquares(some, SpecularTable(some) if self._name == "across" else self._table)

    def at(self, value: float) -> Maximum:
        if not self.likelihood:
            return maximise(self._least_squares(value), self._x, self._free[:-2])
        return climb(self._samples(value), self._x, self._free, USUAL_TABLE).maximum

    def _fall(self, value: float) -> float:
        return -self.at(value).value

    def describes(self, value: float) -> bool:
        return measure_misfit(self._least_squares(value), self._x) <= MOST_MISFIT

    def search(self, start: float) -> float:
        # between the starts on both sides; climbs begin where the one at the start ends
        ends = sorted({*RANGES[self._name], *STARTS[self._name]})
        low = max((end for end in ends if end < start), default=ends[0])
        high = min((end for end in ends if end > start), default=ends[-1])
        self._x = self.at(start).x
        found: Any = minimize_scalar(self._fall, bounds=(low, high), method="bounded", options={"xatol": FINE})
        value = float(found.x)
        self._x = self.at(value).x
        return value
