"""A thin lens of finite aperture: what is out of focus, the places that its light passes, and diffraction."""

import math

import numpy as np

from lightopt.core.arrays import Float64

# Radius of the kernel of diffraction [px]. Highlights are a thousand times as bright as what is around them, and the
# light outside falls with the cube of the radius: at 128 px a pixel gets 2e-8 of a point's light.
_KERNEL_RADIUS = 128

_RINGS_RADIUS = 16  # beyond, the kernel has the mean of the rings [px]
_ACROSS = 9  # places along a pixel's side that the kernel is integrated from
_SCRAMBLING = 3  # seed

# Airy's disc is as wide as a uniform disc of 1.69 λ·b/D: both have the spread of a Gaussian of 0.42 λ·b/D
_AIRY_DIAMETER = 1.69


def circle_of_confusion(depth: Float64, *, focus: float, aperture: float, image_distance: float) -> Float64:
    """Diameter of the image of a point [mm].

    depth: Of points along the optical axis, in front of the lens [mm], shape (k,)
    focus: Depth of the plane in focus [mm]
    aperture: Diameter of the lens [mm]
    image_distance: Lens to image plane [mm]
    """
    return aperture * image_distance * np.abs(1.0 / depth - 1.0 / focus)


def depth_of_field(diameter: float, *, focus: float, aperture: float, image_distance: float) -> tuple[float, float]:
    """Nearest and farthest depth [mm] at which the circle of confusion is no wider than `diameter` [mm]."""
    step = diameter / (aperture * image_distance)
    return 1.0 / (1.0 / focus + step), 1.0 / (1.0 / focus - step) if step * focus < 1.0 else math.inf


def pupil_points(count: int) -> tuple[Float64, Float64]:
    """Well-spread pairs of a place in the unit disc and an offset from a pixel's centre, each of shape (count, 2).

    The first ones of a larger number are those of a smaller. Of Sobol's sequence in four dimensions, scrambled (Owen
    1995), with the concentric map of a square to a disc (Shirley and Chiu 1997, doi:10.1080/10867651.1997.10487479).

    count: A power of two
    """
    from scipy.stats import qmc  # takes long to load

    # `seed` is `rng` in newer SciPy, which takes both
    sequence = qmc.Sobol(4, scramble=True, seed=_SCRAMBLING)  # pyright: ignore[reportCallIssue]
    places: Float64 = sequence.random(count)
    a, b = 2.0 * places[:, 0] - 1.0, 2.0 * places[:, 1] - 1.0
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    share = np.where(wide, b, a) / radius
    angle = np.where(wide, 0.25 * math.pi * share, 0.5 * math.pi - 0.25 * math.pi * share)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1), places[:, 2:] - 0.5


def airy_diameter(cutoff: float) -> float:
    """Diameter of the uniform disc that blurs as much as diffraction does [px].

    cutoff: Frequency from which on it leaves no contrast, D / (λ·b) [cycles/px]
    """
    return _AIRY_DIAMETER / cutoff


def airy_kernel(cutoff: float) -> Float64:
    """Shares of a pixel's light that diffraction brings to the pixels around, shape (257, 257), of sum 1.

    Airy's pattern (Born and Wolf, Principles of Optics, section 8.5.2), integrated over pixels. Its contrast is within
    0.04 of that of the aperture up to half of the highest frequency of the pixels.

    cutoff: As of :func:`airy_diameter` [cycles/px]
    """
    from scipy import special  # takes long to load

    places = np.arange(-_KERNEL_RADIUS, _KERNEL_RADIUS + 1.0)
    radius = np.maximum(np.hypot(places[:, None], places), 1.0)
    kernel = 1.0 / (math.pi**3 * cutoff * radius**3)  # the mean of J₁² far out
    inner = slice(_KERNEL_RADIUS - _RINGS_RADIUS, _KERNEL_RADIUS + _RINGS_RADIUS + 1)
    n = 2 * _RINGS_RADIUS + 1
    fine = (np.arange(n * _ACROSS) + 0.5) / _ACROSS - 0.5 * n
    v = math.pi * cutoff * np.maximum(np.hypot(fine[:, None], fine), 1e-9)
    pattern = math.pi * cutoff**2 * (special.j1(v) / v) ** 2
    kernel[inner, inner] = pattern.reshape(n, _ACROSS, n, _ACROSS).mean(axis=(1, 3))
    return kernel / kernel.sum()
