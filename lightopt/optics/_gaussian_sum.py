"""A lobe that is given by a table, as a sum of a few Gaussian lobes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.optics._reflection_model import MOST_WIDER

# shares of the peak below which relative deviations count less: in the search, and in the error that is stated
FLOOR, ERROR_FLOOR = 1e-4, 1e-3
# angles over which deviations are averaged, so that noise of a table is none: to either side, as a share of the angle
# and of the narrowest σ
_WINDOW, _CORE = 0.3, 1.0
_WIDTHS = 48  # that are tried, from half the table's least angle above 0 to this [rad]
_WIDEST = 1.0
_LEAST_WIDTH = 2e-4  # [rad]
_MOST_PLACES = 400  # of the table that count, evenly by the logarithm of the angle
_APART, _LEAST_RATIO = 1.4, 1.1  # of widths of lobes that follow each other, as they are added and in the end


@dataclass(frozen=True)
class GaussianSum:
    """Gaussian lobes that follow a table, and how well they do."""

    lobes: tuple[tuple[float, float], ...]
    """Height and σ [rad] of each, from the narrowest on; the heights' sum is 1."""
    error: float
    """Greatest deviation from the table, averaged over neighbouring angles, as a share of the level and 1e-3 of the
    peak."""
    worst: float
    """Angle δ of that deviation [rad]."""


def gaussian_sum(delta: Float64, value: Float64) -> GaussianSum:
    """The Gaussian lobes whose sum follows a table.

    Widths are added one by one, each the one that helps most, and then improved together.

    delta: Angle δ between normal and half vector [rad], ascending, from 0 or nearly so, shape (n,)
    value: The lobe there, in any unit, shape (n,)
    Raises InputError: The table has no peak at its first angle
    """
    from scipy.optimize import least_squares, nnls  # takes long to load

    if not value[0] > 0.0 or value[0] < 0.5 * value.max():
        raise InputError("expected a lobe that is greatest at the least angle δ")
    least = max(float(delta[delta > 0.0][0]), 1e-4)
    wanted_places = np.searchsorted(delta, np.geomspace(least, delta[-1], _MOST_PLACES))
    rows = np.arange(len(delta)) if len(delta) <= _MOST_PLACES else np.unique([0, *wanted_places])
    places, wanted = delta[rows], value[rows] / value[0]
    weight = 1.0 / (wanted + FLOOR)

    def lobes(sigma: NDArray[np.float64]) -> Float64:
        return np.exp(-0.5 * (places[:, None] / sigma) ** 2)

    def fit(sigma: NDArray[np.float64]) -> tuple[Float64, float]:
        heights, rest = nnls(weight[:, None] * lobes(sigma), weight * wanted)
        return heights, float(rest)

    tried = np.geomspace(max(0.5 * least, _LEAST_WIDTH), _WIDEST, _WIDTHS)
    chosen = np.zeros(0)
    before = np.inf
    for _ in range(MOST_WIDER + 1):
        apart = [s for s in tried if np.all(np.abs(np.log(chosen / s)) > np.log(_APART))]
        rests = [fit(np.sort(np.append(chosen, s)))[1] for s in apart]
        if not rests or min(rests) > 0.98 * before:
            break
        before = min(rests)
        chosen = np.sort(np.append(chosen, apart[int(np.argmin(rests))]))
    chosen = chosen[fit(chosen)[0] > 0.0]

    def residuals(logarithms: Float64) -> Float64:
        heights, sigma = np.exp(logarithms.reshape(2, -1))
        return weight * (lobes(sigma) @ heights - wanted)

    def improved(sigma: NDArray[np.float64]) -> NDArray[np.float64]:
        start = np.log(np.stack([np.maximum(fit(sigma)[0], 1e-9), sigma])).ravel()
        return np.sort(np.exp(least_squares(residuals, start, max_nfev=200).x.reshape(2, -1)[1]))

    sigma = improved(chosen)
    while np.any(alike := sigma[1:] < _LEAST_RATIO * sigma[:-1]):
        sigma = improved(np.delete(sigma, 1 + int(np.argmax(alike))))
    heights, _ = fit(sigma)
    sigma, heights = sigma[heights > 0.0], heights[heights > 0.0]
    deviations = np.append(0.0, np.cumsum((lobes(sigma) @ heights - wanted) / (wanted + ERROR_FLOOR)))
    reach = np.maximum(_WINDOW * places, _CORE * sigma[0])
    first, end = np.searchsorted(places, places - reach), np.searchsorted(places, places + reach, side="right")
    errors = np.abs(deviations[end] - deviations[first]) / (end - first)
    worst = int(np.argmax(errors))
    shares = heights / heights.sum()
    found = tuple(zip(shares.tolist(), sigma.tolist(), strict=True))
    return GaussianSum(found, float(errors[worst]), float(places[worst]))
