"""Images of sine stripes that move by steps of a period: phase, modulation, mean, and the place on the display.

Image k of N of a direction with coordinate u on the display shows cos(2πu/P − δ_k), δ_k = 2πk/N, so that the phase
grows with u. (For stripes that move the other way, cos(φ + δ_k), the sine's sum has a minus.)
"""

import math
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Float64


@dataclass(frozen=True)
class Stripes:
    """What N images of stripes say of each pixel, shape (H, W)."""

    phase: Float64  # φ = atan2(Σ I sin δ, Σ I cos δ), from −π to π [rad]
    modulation: Float64  # M = 2 |Σ I e^{iδ}| / Σ I: 1 for a mirror, 0 where all is scattered
    mean: Float64  # Σ I / N
    amplitude: Float64  # B = 2 |Σ I e^{iδ}| / N


def demodulate(images: Float64) -> Stripes:
    """Phase, modulation, mean and amplitude of stripes.

    images: In the order of their steps, shape (N, H, W), N ≥ 3 [grey level]; NaN where a pixel is unknown
    """
    steps = 2.0 * math.pi * np.arange(len(images)) / len(images)
    cosine, sine = (np.tensordot(f(steps), images, axes=1) for f in (np.cos, np.sin))
    mean, amplitude = images.mean(axis=0), 2.0 * np.hypot(cosine, sine) / len(images)
    with np.errstate(divide="ignore", invalid="ignore"):
        modulation = np.where(mean > 0.0, amplitude / mean, np.nan)
    return Stripes(np.arctan2(sine, cosine), modulation, mean, amplitude)


def phase_noise(amplitude: Float64, noise: Float64 | float, images: int) -> Float64:
    """Standard deviation of the phase [rad], √(2/N)·σ_I/B, of images with noise σ_I in the unit of the amplitude B."""
    with np.errstate(divide="ignore"):
        return math.sqrt(2.0 / images) * noise / amplitude


def phase_gradient(phase: Float64) -> tuple[Float64, Float64]:
    """Change of the phase per pixel to the right and down [rad/px], shape (H, W) each; steps of 2π do not count."""
    found: list[Float64] = []
    for axis in (1, 0):
        steps = _wrapped(np.diff(phase, axis=axis))
        ends = [(0, 0), (0, 0)]
        # mean of the steps on both sides; NaN at the image's edge
        ends[axis] = (1, 1)
        sides = np.pad(steps, ends, constant_values=np.nan)
        found.append(0.5 * (sides[:, 1:] + sides[:, :-1]) if axis == 1 else 0.5 * (sides[1:] + sides[:-1]))
    return found[0], found[1]


def absolute_place(phase: Float64, second_phase: Float64, periods: tuple[float, float], size: float) -> Float64:
    """Coordinate on the display from the phases of two periods [mm], from its middle, shape (H, W).

    The first phase gives it but for a whole number of periods: the number with which the second agrees best.

    phase, second_phase: Of the two periods [rad]
    periods: [mm]
    size: Of the display along the coordinate [mm]
    """
    place = phase * (periods[0] / (2.0 * math.pi))
    most = math.ceil(0.5 * size / periods[0]) + 1
    best, error = np.full(phase.shape, np.nan), np.full(phase.shape, np.inf)
    for number in range(-most, most + 1):
        at = place + number * periods[0]
        off = np.abs(_wrapped(second_phase - 2.0 * math.pi * at / periods[1]))
        # half a period beyond the edge, for noise
        better = (off < error) & (np.abs(at) <= 0.5 * size + 0.5 * periods[0])
        best, error = np.where(better, at, best), np.where(better, off, error)
    return best


def _wrapped(angle: Float64) -> Float64:
    return np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi
