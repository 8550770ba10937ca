"""A measured value with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

NORMAL_95 = 1.959964  # standard errors to each side


@dataclass(frozen=True, kw_only=True)
class Measured:
    """A value, its standard error and the 95 % interval."""

    value: float
    error: float
    interval_95: tuple[float, float]


def measured(value: float, error: float, *, errors_95: float = NORMAL_95) -> Measured:
    """A value whose interval is so many standard errors to each side."""
    half = errors_95 * error
    return Measured(value=value, error=error, interval_95=(value - half, value + half))
