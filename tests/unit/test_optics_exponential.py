"""The exponential of the kernels against exact decimal arithmetic."""

import math
from decimal import Decimal, localcontext

import numpy as np
import pytest

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel
from lightopt.optics._exponential import exponential
from lightopt.optics._reflection_model import NARROW_CHORD_SQUARED, gaussian, narrow_gaussian, rough_gaussian


@kernel
def _exponentials(x: Float64) -> Float64:
    out = np.empty_like(x)
    for i in range(len(x)):
        out[i] = exponential(x[i])
    return out


@kernel
def _lobes(chord_squared: Float64, inverse: float) -> tuple[Float64, Float64]:
    wide, narrow = np.empty_like(chord_squared), np.empty_like(chord_squared)
    for i in range(len(chord_squared)):
        wide[i] = gaussian(chord_squared[i], inverse)
        narrow[i] = narrow_gaussian(chord_squared[i], inverse)
    return wide, narrow


def units_of_the_last_digit(x: float, found: float) -> float:
    """Distance of `found` from e^x in units of the last digit of a float64."""
    with localcontext() as context:
        context.prec = 60
        exact = Decimal(x).exp()
        return float(abs(Decimal(found) - exact) / Decimal(math.ulp(float(exact))))


def test_it_is_exact_to_the_last_digit() -> None:
    random = np.random.default_rng(1)
    x = np.concatenate(
        [random.uniform(-700.0, 700.0, 400), random.uniform(-1.0, 1.0, 400), 10.0 ** random.uniform(-300.0, -1.0, 100)]
    )
    found = _exponentials(x)
    assert max(map(units_of_the_last_digit, x, found)) < 1.0


@pytest.mark.parametrize("k", [0, 1, -1, 5, -64, 700])
def test_borders_between_powers_of_two(k: int) -> None:
    x = np.array([(k + half) * math.log(2.0) for half in (-0.5, 0.0, 0.5)])
    found = _exponentials(x)
    assert max(map(units_of_the_last_digit, x, found)) < 1.0


def test_zero_is_one() -> None:
    assert _exponentials(np.zeros(1))[0] == 1.0


@pytest.mark.parametrize("sigma", [0.003, 0.0475, 0.2])
def test_the_lobe_without_branches_is_the_lobe(sigma: float) -> None:
    chord_squared = np.linspace(0.0, NARROW_CHORD_SQUARED, 2000, endpoint=False)
    inverse = 0.5 / sigma**2
    wide, narrow = _lobes(chord_squared, inverse)
    np.testing.assert_array_equal(wide, narrow)
    plain = np.exp(-((2.0 * np.arcsin(0.5 * np.sqrt(chord_squared))) ** 2) * inverse)
    np.testing.assert_allclose(narrow, plain, rtol=1e-9 / sigma**2 * 1e-2 + 1e-9, atol=1e-27)


@pytest.mark.parametrize(("sigma", "most"), [(0.003, 3e-6), (0.0475, 3e-6), (0.1, 3e-6), (0.2, 1e-5), (0.3, 1e-4)])
def test_the_rough_lobe_is_near_the_lobe_up_to_a_right_angle(sigma: float, most: float) -> None:
    inverse = 0.5 / sigma**2
    for chord_squared in np.linspace(0.0, 2.0, 2000).tolist():
        assert abs(rough_gaussian(chord_squared, inverse) - gaussian(chord_squared, inverse)) <= most
