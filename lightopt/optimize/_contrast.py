"""When a defect is visible in an image: its level is off that of the good surface by more than the sensor's noise.

With v the level that the sensor would deliver before rounding, ``black + exposure · scale · I`` clipped at the
saturation level, of the good surface v₀ and of the defect v_d, a trial is visible where

    |v_d − v₀| ≥ threshold · √(read noise² + (v₀ − black) / electrons per level + 1/12),

the noise of read-out, of photons and of rounding (EMVA Standard 1288, release 4.0, section 2) at the good surface's
level: what decides how often a good surface is taken for a defect. Where both are saturated the difference is 0. A
defect that is smaller than a pixel's footprint fills a share of the pixel, and the rest of it is good:

    I_d = I₀ + fill · (I_wall − I₀),   fill = min(1, width · cosθ / footprint) · min(1, length / footprint),

with the footprint on a plane that faces the camera at the patch's distance, and θ between normal and view, as if the
defect lay across the foreshortening. On what the camera sees at more than 80° to its normal nothing is visible: a
pixel's footprint there is six times as long and more, and mixes with its neighbours'.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.errors import InputError
from lightopt.kernels import kernel
from lightopt.optimize._packed import Words
from lightopt.optimize._trials import Trial
from lightopt.sensor import Sensor

__all__ = ["DEFAULT_CONTRAST", "GRAZING_COSINE", "Contrast", "threshold_problem"]

Float64 = NDArray[np.float64]

DEFAULT_CONTRAST = 5.0
"""Times the noise that a level must be off, unless asked otherwise. Of the two million pixels of an image noise alone
takes one for a defect at 5, and five thousand at 3. Rose found the same 5 for what people make out in pictures (J. Opt.
Soc. Am. 38, 1948, doi:10.1364/JOSA.38.000196)."""


GRAZING_COSINE = math.cos(math.radians(80.0))
"""Of the angle between normal and view beyond which nothing is visible."""


def threshold_problem(threshold: float) -> str | None:
    """What is wrong with a multiple of the noise; None where nothing is."""
    if math.isfinite(threshold) and threshold > 0.0:
        return None
    return f"--threshold: expected a number above 0, times the sensor's noise, found {threshold:g}"


@dataclass(frozen=True, kw_only=True)
class Contrast:
    """The sensor's side of the question whether a defect is visible.

    Attributes
    ----------
    sensor
        Of the camera.
    full_scale
        Grey level that makes a full-scale sensor level at exposure 1.
    threshold
        Times the noise.

    Raises
    ------
    InputError
        A threshold that is not above 0.
    """

    sensor: Sensor
    full_scale: float
    threshold: float = DEFAULT_CONTRAST

    def __post_init__(self) -> None:
        if problem := threshold_problem(self.threshold):
            raise InputError(problem)

    def words(
        self,
        good: Float64,
        varied: Float64,
        *,
        trials: Sequence[Trial],
        footprints: Float64,
        cosines: Float64,
        exposure: float,
    ) -> Words:
        """Bits of the trials that are visible, shape (k, ⌈t / 64⌉).

        Parameters
        ----------
        good, varied
            Linear levels of the good surface and of the trials where they fill the pixel [grey level at exposure 1],
            shapes (k,) and (k, t).
        trials
            The defects, t of them.
        footprints
            Side of a pixel's footprint on a plane that faces the camera [mm], shape (k,).
        cosines
            Of the angle between normal and view, shape (k,).
        exposure
            Of the image.
        """
        return _contrast_words(
            good,
            varied,
            np.array([trial.width for trial in trials]),
            np.array([trial.length for trial in trials]),
            footprints,
            cosines,
            exposure * self.sensor.max_level / self.full_scale,
            self.sensor.black_level,
            self.sensor.saturated_from,
            self.threshold,
            self.sensor.read_noise_levels,
            self.sensor.electrons_per_level or math.inf,
        )


@kernel
def _contrast_words(
    good: Float64,
    varied: Float64,
    widths: Float64,
    lengths: Float64,
    footprints: Float64,
    cosines: Float64,
    scale: float,
    black: float,
    saturation: float,
    threshold: float,
    read_noise: float,
    electrons: float,
) -> Words:
    words = np.zeros((len(good), (varied.shape[1] + 63) // 64), np.uint64)
    for i in range(len(good)):
        if cosines[i] < GRAZING_COSINE:
            continue
        level = min(black + scale * good[i], saturation)
        least = threshold * math.sqrt(read_noise * read_noise + (level - black) / electrons + 1.0 / 12.0)
        along, across = 1.0 / footprints[i], cosines[i] / footprints[i]
        for t in range(varied.shape[1]):
            fill = min(1.0, widths[t] * across) * min(1.0, lengths[t] * along)
            mixed = good[i] + fill * (varied[i, t] - good[i])
            if abs(min(black + scale * mixed, saturation) - level) >= least:
                words[i, t // 64] |= np.uint64(1) << np.uint64(t % 64)
    return words
