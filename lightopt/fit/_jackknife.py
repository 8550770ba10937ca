"""Uncertainty of a fit to images that the model does not describe: how it changes with the lights that are left out.

What the model gets wrong is alike in all pixels of a light, so that pixels tell nothing of it. The estimates without
one group of images each scatter as it takes (Efron and Stein 1981, doi:10.1214/aos/1176345462).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from lightopt.fit._least_squares import LeastSquares
from lightopt.fit._maximise import maximise
from lightopt.fit._samples import Samples

__all__ = ["Jackknife", "leave_groups_out"]

Float64 = NDArray[np.float64]

LEAST_GROUPS, MOST_GROUPS = 4, 24
"""Groups of images: lights, where there are so many, else lights by posture, else pieces of the images. Further lights
share a group."""


@dataclass(frozen=True, kw_only=True)
class Jackknife:
    """Scatter of the estimates without one group of images each.

    Attributes
    ----------
    covariance
        Shape (k, k).
    groups
        Number of groups.
    of
        What a group is.
    quantile
        Student's t of a two-sided 95 % interval for so many groups.
    """

    covariance: Float64
    groups: int
    of: str
    quantile: float


def leave_groups_out(criterion: LeastSquares, x: Float64, free: Sequence[int]) -> Jackknife:
    """Fit again without each group of images.

    Parameters
    ----------
    criterion, x
        The fit.
    free
        Places of the parameters that were fitted.
    """
    label, of = _groups(criterion.samples)
    numbers = np.unique(label)
    count = len(numbers)
    index = list(free)
    found = np.array([maximise(criterion.without(label == number), x, free).x[index] for number in numbers])
    off = found - found.mean(axis=0)
    return Jackknife(
        covariance=(count - 1.0) / count * off.T @ off,
        groups=count,
        of=of,
        quantile=float(stdtrit(count - 1, 0.975)),
    )


def _groups(samples: Samples) -> tuple[NDArray[np.intp], str]:
    # a number per observation: what is left out together
    light = samples.facts.light[samples.image].astype(np.intp)
    postures = list(dict.fromkeys(image.posture for image in samples.images))
    posture = np.array([postures.index(image.posture) for image in samples.images])[samples.image]
    number, count, of = light, 0, ""
    for label, what in (
        (light, "lights"),
        (light * len(postures) + posture, "lights and postures"),
        (samples.block[samples.sample].astype(np.intp), "pieces of the images"),
    ):
        of = what
        _, number = np.unique(label, return_inverse=True)
        count = int(number.max(initial=0)) + 1
        if count >= LEAST_GROUPS:
            break
    each = math.ceil(count / MOST_GROUPS)
    # neighbours in number are rarely neighbours in place
    return number % math.ceil(count / each), of
