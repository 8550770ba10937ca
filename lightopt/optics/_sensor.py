"""What is known of a sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError

Level = TypeVar("Level", bound=np.floating[Any])


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """A linear sensor.

    Attributes
    ----------
    bit_depth: Bits of a delivered level, 1 to 16
    saturation_level: Delivered level from which a pixel counts as saturated; full scale, 2^bit_depth − 1, when not
        given. Real cameras top out lower: 4080 of 4095, for instance.
    black_level: Delivered level without light
    read_noise_levels: Standard deviation of the read noise [sensor level]
    electrons_per_level: Photo-electrons that make one sensor level; None for a sensor without shot noise

    Raises InputError: When a value is out of its range
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

    @overload
    def noise_variance(self, signal: float, *, frames: int = 1) -> float: ...

    @overload
    def noise_variance(self, signal: NDArray[Level], *, frames: int | Float64 = 1) -> NDArray[Level]: ...

    def noise_variance(self, signal: Any, *, frames: Any = 1) -> Any:
        """Variance of a delivered level: read noise and shot noise, of which averaging leaves less, and rounding.

        Parameters
        ----------
        signal: Level above the black level [sensor level], of any shape; below 0 there is no shot noise
        frames: Of how many frames the level is the rounded mean

        Returns: [sensor level²], of the signal's shape and kind.
        """
        levels_per_electron = 1.0 / self.electrons_per_level if self.electrons_per_level else 0.0
        lit = max(signal, 0.0) if isinstance(signal, float) else np.maximum(signal, 0)
        return (self.read_noise_levels**2 + levels_per_electron * lit) / frames + 1.0 / 12.0
