"""What is known of a sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lightopt.errors import InputError

__all__ = ["Sensor"]


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """A linear sensor.

    Attributes
    ----------
    bit_depth
        Bits of a delivered level, 1 to 16.
    saturation_level
        Delivered level from which a pixel counts as saturated; full scale, 2^bit_depth − 1, when not given.
        Real cameras top out lower: 4080 of 4095, for instance.
    black_level
        Delivered level without light.
    read_noise_levels
        Standard deviation of the read noise [sensor level].
    electrons_per_level
        Photo-electrons that make one sensor level; None for a sensor without shot noise.

    Raises
    ------
    InputError
        When a value is out of its range.
    """

    bit_depth: int
    saturation_level: float | None = None
    black_level: float = 0.0
    read_noise_levels: float = 0.0
    electrons_per_level: float | None = None

    def __post_init__(self) -> None:
        problems: list[str] = []
        if not 1 <= self.bit_depth <= 16 or self.bit_depth != int(self.bit_depth):
            raise InputError(
                f"sensor: bit_depth: expected a whole number from 1 to 16, found {self.bit_depth}"
            )
        top = self.max_level
        if self.saturation_level is not None and not 0 < self.saturation_level <= top:
            problems.append(f"saturation_level: expected above 0 up to {top}, found {self.saturation_level}")
        if not 0 <= self.black_level < self.saturated_from:
            expected = f"from 0 to below the saturation level {self.saturated_from:g}"
            problems.append(f"black_level: expected {expected}, found {self.black_level}")
        if not (self.read_noise_levels >= 0 and math.isfinite(self.read_noise_levels)):
            problems.append(f"read_noise_levels: expected 0 or more, found {self.read_noise_levels}")
        electrons = self.electrons_per_level
        if electrons is not None and not (electrons > 0 and math.isfinite(electrons)):
            problems.append(f"electrons_per_level: expected above 0, found {electrons}")
        if problems:
            raise InputError(*(f"sensor: {problem}" for problem in problems))

    @property
    def max_level(self) -> int:
        """Highest level delivered, 2^bit_depth − 1."""
        return (1 << int(self.bit_depth)) - 1

    @property
    def saturated_from(self) -> float:
        """Delivered level from which a pixel counts as saturated."""
        return float(self.max_level) if self.saturation_level is None else float(self.saturation_level)
