"""Waviness of good surfaces (orange peel): slopes that images show, and the noise that they are to an inspection.

The height over the CAD model is a normal random field with the covariance A²·exp(−d²/(2ℓ²)) at a distance d, or the sum
of several of them, the bands of its power spectrum. The slope of each along each axis of the surface has the standard
deviation A/ℓ.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel

_WAVES = 96  # plane waves in space that the field of a band is the sum of


@dataclass(frozen=True, eq=False, kw_only=True)
class Waviness:
    """Random slopes of a good surface."""

    bands: tuple[tuple[float, float], ...]  # root mean square slope [rad] and correlation length ℓ of the height [mm]
    seed: int | None = None  # of the surface that images show; None for the smooth one

    @cached_property
    def slope(self) -> float:
        """Root mean square slope [rad]."""
        return math.hypot(*(slope for slope, _ in self.bands))

    @cached_property
    def _waves(self) -> tuple[Float64, Float64, Float64]:
        rng = np.random.default_rng(self.seed)
        vectors, phases, amplitudes = list[Float64](), list[Float64](), list[Float64]()
        for slope, length in self.bands:
            own = rng.standard_normal((_WAVES, 3))
            vectors.append(own * (math.sqrt(3.0 * _WAVES / np.sum(own**2)) / length))
            phases.append(rng.uniform(0.0, 2.0 * math.pi, _WAVES))
            amplitudes.append(np.full(_WAVES, slope * length / math.sqrt(_WAVES)))
        return np.concatenate(vectors), np.concatenate(phases), np.concatenate(amplitudes)

    @property
    def leans(self) -> tuple[Float64, Float64]:
        """Slope and direction of two variants of the surface [rad], each of shape (2,).

        The squares of what they change add up to the variance of a level, which is linear in so small a slope.
        """
        return np.full(2, self.slope / math.sqrt(2.0)), np.array([0.0, 0.5 * math.pi])

    def normals(self, points: Float64, normals: Float64) -> Float64:
        """Unit normals of the wavy surface where those of the smooth one are known, shape (n, 3).

        points: In coordinates that move with the part [mm], shape (n, 3)
        normals: In the same frame, shape (n, 3)
        """
        if self.seed is None:
            return normals
        result = np.empty_like(normals)
        _lean(points, normals, *self._waves, result)
        return result

    def correlated_pixels(self, footprint: float, scales: Sequence[float], *, walls: bool = False) -> float:
        """How many times the variance of a pixel the waviness adds to a sum over pixels, of variance 1 in white noise.

        The sum is over a Gaussian of the width s [px] that is worst. With the covariance of the slope and q = ℓ²/(2s²),
        ℓ in pixels, it is 2πℓ²·q/(1 + q)². Where the sum is over the slope of a Gaussian hill of that width, as walls
        of a defect have it, it is 6πℓ²·q/(1 + q)³. At least 1. Bands count by the squares of their slopes.

        footprint: Side of a pixel on the surface [mm]
        scales: Widths s
        walls: Whether sums are over slopes, too
        """
        kinds = [False, True] if walls else [False]
        return max(self._correlated(scale * footprint, footprint, kind) for scale in scales for kind in kinds)

    def _correlated(self, width: float, footprint: float, walls: bool) -> float:
        # of the sum over a Gaussian of a width [mm], or over its slope
        total = 0.0
        for slope, length in self.bands:
            q = 0.5 * (length / width) ** 2
            factor = 2.0 * math.pi * (length / footprint) ** 2 * q / (1.0 + q) ** 2
            if walls:
                factor *= 3.0 / (1.0 + q)
            total += (slope / self.slope) ** 2 * max(1.0, factor)
        return total


@kernel
def _lean(
    points: Float64, normals: Float64, vectors: Float64, phases: Float64, amplitudes: Float64, result: Float64
) -> None:
    # n − ∇h, of unit length, with the gradient in the tangent plane
    for i in range(len(points)):
        x = y = z = 0.0
        for w in range(len(vectors)):
            a, b, c = vectors[w]
            rise = amplitudes[w] * math.sin(a * points[i, 0] + b * points[i, 1] + c * points[i, 2] + phases[w])
            x -= rise * a
            y -= rise * b
            z -= rise * c
        along = x * normals[i, 0] + y * normals[i, 1] + z * normals[i, 2]
        for k, part in enumerate((x, y, z)):
            result[i, k] = normals[i, k] - (part - along * normals[i, k])
        length = math.sqrt(result[i, 0] ** 2 + result[i, 1] ** 2 + result[i, 2] ** 2)
        for k in range(3):
            result[i, k] /= length


@kernel
def clipped_variance(level: float, spread: float, limit: float) -> float:
    """Mean square deviation of min(X, limit) from min(level, limit), X normal about `level` with a `spread`."""
    if spread <= 0.0:
        return 0.0
    a = (limit - level) / spread
    if a > 8.0:
        return spread * spread
    if a < -8.0:
        return 0.0
    below = 0.5 * math.erfc(-a * math.sqrt(0.5))
    density = math.exp(-0.5 * a * a) / math.sqrt(2.0 * math.pi)
    if a >= 0.0:
        return spread * spread * (below - a * density + a * a * (1.0 - below))
    return spread * spread * ((1.0 + a * a) * below + a * density)
