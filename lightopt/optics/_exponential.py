"""The exponential function in kernels, without branches, so that the processor computes several at once.

The C library's is called once for each number, and its last bit depends on the system.
"""

import math

from lightopt.core.kernels import bits_of_float, float_of_bits, kernel

_LOG2_E = 1.0 / math.log(2.0)

# ln 2 in two parts, of which the first has so few digits that its products with whole numbers up to 2¹¹ are exact
_LN_2 = float.fromhex("0x1.62e42fee00000p-1")
_LN_2_REST = float.fromhex("0x1.a39ef35793c76p-33")

# 1.5 · 2⁵²: a number added to it is rounded to a whole one, which its lowest bits then hold
_ROUNDER = 6755399441055744.0
_EXPONENT_BIAS, _EXPONENT_SHIFT = 1023, 52

# 1/n! of the series of e^r, which is cut off at r¹³: |r| ≤ ½ ln 2
_C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10, _C11, _C12, _C13 = (1.0 / math.factorial(n) for n in range(3, 14))


@kernel
def exponential(x: float) -> float:
    """e^x for x in [−700, 700], to less than one unit of its last digit.

    x = k·ln 2 + r with a whole k and |r| ≤ ½ ln 2; e^r is its series, and 2^k is put together from its bits.
    """
    shifted = x * _LOG2_E + _ROUNDER
    k = shifted - _ROUNDER
    r = (x - k * _LN_2) - k * _LN_2_REST
    # summed in groups, which the processor works on at the same time
    r2 = r * r
    r4 = r2 * r2
    low = (0.5 + _C3 * r) + r2 * (_C4 + _C5 * r)
    middle = (_C6 + _C7 * r) + r2 * (_C8 + _C9 * r)
    high = (_C10 + _C11 * r) + r2 * (_C12 + _C13 * r)
    series = low + r4 * (middle + r4 * high)
    power = float_of_bits((bits_of_float(shifted) + _EXPONENT_BIAS) << _EXPONENT_SHIFT)
    return (1.0 + (r + r2 * series)) * power


@kernel
def rough_exponential(x: float) -> float:
    """:func:`exponential` to 3e-6 of itself, in a third of the time."""
    shifted = x * _LOG2_E + _ROUNDER
    r = x - (shifted - _ROUNDER) * (_LN_2 + _LN_2_REST)
    r2 = r * r
    series = (1.0 + r) + r2 * ((0.5 + _C3 * r) + r2 * (_C4 + _C5 * r))
    return series * float_of_bits((bits_of_float(shifted) + _EXPONENT_BIAS) << _EXPONENT_SHIFT)
