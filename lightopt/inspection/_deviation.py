"""How far each pixel is from the good part, in units of what noise and the model's own errors explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lightopt.inspection._view import PostureView

__all__ = ["Deviations", "deviations"]

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

REGISTRATION_PX = 0.1
"""The part is known to lie within about this much of where the model has it: steep edges are off by so much."""

LIT = 3.0
"""What is predicted to be less than this many standard deviations above black shows nothing."""

LOCAL_PX = 14.0
CLIPPED = 4.0
"""The typical deviation of a pixel's surroundings, Gaussian of this width, each clipped: where that is more than noise
makes, the model is wrong there, and the noise counts for more."""

MEAN_OF_NORMAL = 0.7979
"""Mean magnitude of a standard normal deviate."""


@dataclass(frozen=True)
class Deviations:
    """Measured minus predicted of a posture.

    Attributes
    ----------
    z
        In standard deviations, shape (lights, H, W); 0 where not usable.
    scale
        The standard deviation [grey level at exposure 1], same shape.
    usable
        Pixels that can show a defect in an image: lit, off edges, not saturated in both image and prediction.
    """

    z: Float32
    scale: Float32
    usable: Bool


def deviations(view: PostureView) -> Deviations:
    """Compare the images of a posture with the good part.

    Both are clipped where the camera clips. A pixel's variance is that of the sensor's noise, of a part that lies a
    tenth of a pixel from where the model has it, and of what the model gets wrong around the pixel.
    """
    z = np.zeros(view.level.shape, np.float32)
    scale = np.ones_like(z)
    usable = np.zeros(z.shape, np.bool_)
    for i in range(len(view.lights)):
        model = np.clip(view.predicted[i], 0.0, view.limit[i])
        seen = np.minimum(view.level[i], view.limit[i])
        down, right = np.gradient(model)
        variance = np.square(view.deviation[i]) + REGISTRATION_PX**2 * (down * down + right * right)
        both = view.saturated[i] & (view.predicted[i] >= view.limit[i])
        usable[i] = view.clean & ~both & (view.predicted[i] >= LIT * view.deviation[i])
        first = np.where(usable[i], (seen - model) / np.sqrt(variance), 0.0)
        wrong = _around(np.minimum(np.abs(first), CLIPPED), usable[i]) / MEAN_OF_NORMAL
        factor = np.maximum(wrong, 1.0)
        z[i] = first / factor
        scale[i] = np.sqrt(variance) * factor
    return Deviations(z, scale, usable)


def _around(values: NDArray[np.floating], mask: Bool) -> Float64:
    share = ndimage.gaussian_filter(mask.astype(np.float64), LOCAL_PX)
    return ndimage.gaussian_filter(np.where(mask, values, 0.0).astype(np.float64), LOCAL_PX) / np.maximum(
        share, 1e-6
    )
