"""Images of sine stripes that move by steps of a period: phase, place on the display, and the normals that mirror it.

Image k of N of a direction with coordinate u on the display shows cos(2πu/P − δ_k), δ_k = 2πk/N, so that the phase
grows with u. (For stripes that move the other way, cos(φ + δ_k), the sine's sum has a minus.)

Deflectometry: the camera sees, at a point of the surface, the place X of the display whose light is mirrored there. The
normal that does this bisects the directions to X and to the camera. The surface's points are the model's: an error h of
its height turns the result by about h·sinθ/d, θ the angle of incidence and d the distance to the display.
"""

import math
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.lights import PanelLight

LEAST_TANGENT = 0.1  # share of the X axis in the tangent plane, from which on it is a direction of the slope


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


@dataclass(frozen=True)
class SlopeMap:
    """How far the measured normals lean from the model's, shape (...); NaN where unknown.

    x, y: Towards the X axis as projected onto the model's tangent plane, and towards the direction 90° counterclockwise
        of it, seen from outside [deg]
    """

    x: Float64
    y: Float64


def slope_map(
    points: Float64, normals: Float64, u: Float64, v: Float64, *, camera: Float64, display: PanelLight
) -> SlopeMap:
    """Slopes of a mirror surface against its model; everything in one frame, the part's or the world's.

    points, normals: Of the model, where each pixel's ray meets it: [mm] and of unit length, shape (..., 3)
    u, v: Place on the display that each pixel sees, from its middle along `across` and `along` [mm], shape (...)
    camera: Position of the camera [mm], shape (3,)
    """
    places = display.centre + u[..., None] * display.across + v[..., None] * display.along
    measured = _unit(_unit(places - points) + _unit(camera - points))
    x_axis = np.array([1.0, 0.0, 0.0]) - normals[..., :1] * normals
    length = np.linalg.norm(x_axis, axis=-1, keepdims=True)
    x_axis = _unit(np.where(length >= LEAST_TANGENT, x_axis, np.nan))
    axes = x_axis, np.cross(normals, x_axis)
    x, y = (np.degrees(np.arctan2(_dot(measured, axis), _dot(measured, normals))) for axis in axes)
    return SlopeMap(x, y)


def _unit(vectors: Float64) -> Float64:
    return vectors / np.sqrt(_dot(vectors, vectors))[..., None]


def _dot(a: Float64, b: Float64) -> Float64:
    return np.sum(a * b, axis=-1)
