"""The statistic by which images show a defect: planning predicts it, and inspection computes it.

A hypothesis says by how much a defect would change each pixel of each image: m, in standard deviations of the good
part's level. With the measured deviations z in the same unit, each image has the sums U = Σ m·z and E = Σ m² over the
defect's pixels. All images together have

    Z = Σ U / √Σ E,

the matched filter. Where there is no defect Z is a normal deviate of variance 1; where there is one, of mean √Σ E. So
much is a defect expected to stand out, and an amplitude other than the hypothesis' is estimated by Σ U / Σ E.
"""

import math
from typing import Final

import numpy as np

from lightopt.core.arrays import Float32, Float64

MOST_CHANGE: Final = 8.0  # expected changes are clipped to so many standard deviations: no pixel decides alone
DARK: Final = 3.0
"""What is predicted to be less than so many standard deviations above black is dark: rounding and clipping at black
make as much of a deviation there as noise does, so that only more than this many show a defect."""

CONFIRMED: Final = 3.0  # where no image alone may decide, the others together must stand out by so much
REGISTRATION_PX: Final = 0.1
"""The part is known to lie within about this much of where the model has it: steep edges are off by so much."""

SCALES_PX: Final = (1.0, 2.0, 3.5)
"""Widths of the Gaussians that deviations are added up with: small and large defects have one that suits them."""

CATALOGUE_SHARE: Final = 0.5
"""Share of the false alarms that the catalogue's defects may cause; what no hypothesis describes has the others."""


def expected_change(good: Float64, varied: Float64, *, deviation: Float64, limit: Float64) -> Float64:
    """By how much a defect changes pixels, in standard deviations of their level, clipped.

    good, varied: Levels of the good part and of the defect before the camera clips
    deviation: Standard deviation of the good part's level
    limit: Level at which the camera clips
    """
    change = (np.clip(varied, 0.0, limit) - np.clip(good, 0.0, limit)) / deviation
    change = np.where((good < DARK * deviation) & (np.abs(change) <= DARK), 0.0, change)
    return np.clip(change, -MOST_CHANGE, MOST_CHANGE)


def chance_score(z: Float64) -> Float64:
    """−log₁₀ of the probability that a normal deviate is off by as much as Z to either side."""
    from scipy import special  # takes long to load, and most commands do not need it

    return -(special.log_ndtr(-np.abs(z)) + math.log(2.0)) / math.log(10.0)


DEFAULT_FALSE_ALARMS: Final = 0.05  # expected in the images of a posture of a good part


def false_alarms_problem(false_alarms: float) -> str | None:
    """What is wrong with a number of false alarms per posture; None where nothing is."""
    if 1e-9 <= false_alarms <= 1.0:
        return None
    return f"option 'false_alarms': expected a number from 1e-9 to 1, found {false_alarms:g}"


def least_z(tests: float, entries: int, false_alarms: float) -> float:
    """The |Z| at which a defect counts as found.

    Each of `entries` entries of a catalogue has an even part of the false alarms that the catalogue may cause, and of
    its `tests` hypotheses noise alone is expected to exceed this so often (Bonferroni's bound).

    false_alarms: Expected in the images of a posture of a good part
    """
    from scipy import special

    chance = CATALOGUE_SHARE * false_alarms / (max(tests, 1.0) * entries)
    return float(-special.ndtri(min(0.5 * chance, 0.5)))


def rest_of_images(sums: Float32, energies: Float32, images: int) -> Float64:
    """Z of all images but the `images` − 1 that support a defect most, shape (n,), with the sign of support.

    A defect that so many images must show counts where this is at least :data:`CONFIRMED`.

    sums, energies: U and E per image, shape (n, images)
    """
    sign = np.where(sums.sum(axis=1) < 0.0, -1.0, 1.0)
    support = sign[:, None] * sums
    order = np.argsort(-support, axis=1, kind="stable")[:, max(images, 1) - 1 :]
    u, e = (np.take_along_axis(a, order, axis=1).sum(axis=1, dtype=np.float64) for a in (support, energies))
    return np.where(e > 0.0, u / np.sqrt(np.maximum(e, 1e-12)), 0.0)
