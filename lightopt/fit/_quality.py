"""How well the model describes the images, and in words what they can and cannot tell."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.errors import InputError
from lightopt.fit._estimate import Estimate
from lightopt.fit._likelihood import LOG_R_S, LOG_SIGMA, predicted
from lightopt.fit._samples import Samples, thinned
from lightopt.fit._search import estimate

__all__ = ["Quality", "appraise", "poor_fit", "refuse_strangers", "words"]

STRANGER_EPSILON = 0.12
STRANGER_R2 = 0.6
"""Images of whose unsaturated pixels less than this share of the variance is explained, for more than a share of
unexplained pixels or for residuals far beyond the noise, are not taken for images of this part on this rig. A knob
480 px wide that is shifted by 2 px has an explained share of 0.88 and 9 % unexplained pixels, by 8 px 0.33 and 15 %;
mirrored, it has none and residuals of 10 levels."""

POOR_EPSILON = 0.02
POOR_NOISE = 3.0
"""Residuals beyond this many times the sensor's noise, and unexplained pixels beyond this share, are worth a word."""

WIDE_INTERVAL = 0.02
STRONG_CORRELATION = 0.95
LEAST_IMPROVEMENT = 1.0
MIRROR_BUDGET = 150


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Residuals of the pixels that a fit looked at.

    Attributes
    ----------
    rms
        Of the unsaturated pixels [grey level at the image's exposure].
    typical
        Median absolute residual times 1.48, which a few unexplained pixels do not move [grey level].
    noise
        What the sensor's noise and quantisation make of a typical pixel [grey level].
    explained
        Share of the variance of the unsaturated pixels that the model explains, 1 for all of it.
    epsilon
        Share of the pixels that the model would have left out if it could.
    tau
        Deviation beside the sensor's noise [grey level].
    saturated
        Share of the observations that are saturated.
    """

    rms: float
    typical: float
    noise: float
    explained: float
    epsilon: float
    tau: float
    saturated: float

    def as_dict(self) -> dict[str, float]:
        """JSON form."""
        return {name: float(f"{value:.6g}") for name, value in vars(self).items()}


def appraise(samples: Samples, found: Estimate, *, full_scale: float) -> Quality:
    """Compare a fit with the pixels that it was made from."""
    sensor = samples.sensor
    mean = predicted(samples, samples.specular(found.sigma), found.x)
    unit = full_scale / sensor.max_level
    level = samples.level.astype(np.float64)
    seen = ~samples.saturated & (mean < sensor.saturated_from)
    residual = (level - np.maximum(mean, 0.0))[seen]
    signal = np.maximum(mean[seen] - sensor.black_level, 0.0)
    electrons = sensor.electrons_per_level
    variance = sensor.read_noise_levels**2 + (signal / electrons if electrons else 0.0) + 1.0 / 12.0
    spread = float(np.var(level[seen])) if seen.any() else 0.0
    return Quality(
        rms=unit * _rms(residual),
        typical=unit * 1.4826 * float(np.median(np.abs(residual))) if seen.any() else 0.0,
        noise=unit * math.sqrt(float(np.median(variance * np.ones(len(signal))))) if seen.any() else 0.0,
        explained=1.0 - float(np.mean(residual**2)) / spread if spread > 0.0 else 1.0,
        epsilon=found.unexplained,
        tau=unit * found.tau,
        saturated=float(np.mean(samples.saturated)),
    )


def words(
    found: Estimate, quality: Quality, lowest: float, highest: float, *, shorter: bool
) -> tuple[str, ...]:
    """What a person should know about a fit of R_s and σ beside its numbers.

    Parameters
    ----------
    found, quality
        The fit.
    lowest, highest
        95 % interval of R_s [grey level].
    shorter
        Whether the images have more than one exposure already.
    """
    said: list[str] = list(poor_fit(quality))
    if LOG_R_S in found.free and LOG_SIGMA in found.free:
        width = math.log(max(highest, 1e-9) / max(lowest, 1e-9))
        correlation = found.correlation(LOG_R_S, LOG_SIGMA)
        if abs(correlation) > STRONG_CORRELATION and width > WIDE_INTERVAL:
            what = "a still shorter exposure" if shorter else "a shorter exposure, such as 1/16 of this one"
            said.append(
                f"these images hardly separate R_s from σ (correlation {correlation:.3f}, R_s known to "
                f"±{50.0 * width:.1f} %): add {what}"
            )
        if quality.saturated == 0.0:
            said.append(
                "no pixel is saturated: R_s and σ come from the flanks and the peak of the highlight alone"
            )
    return tuple(said)


def poor_fit(quality: Quality) -> tuple[str, ...]:
    """What to say where the model does not describe the images."""
    if quality.epsilon <= POOR_EPSILON and quality.typical <= POOR_NOISE * quality.noise:
        return ()
    text = (
        f"the model describes these images badly: {100.0 * quality.epsilon:.1f} % of the pixels are unexplained, and "
        f"the residual is {quality.rms:.3g} grey levels rms where the sensor's noise makes {quality.noise:.2g}. The "
        "mesh's normals, the part's place (--free shift), the number of points of the panels or a lobe that is not a "
        "Gaussian may be the reason; intervals are widened for it, but do not hold what they promise"
    )
    return (text,)


def refuse_strangers(samples: Samples, quality: Quality) -> None:
    """Refuse images that do not show this part on this rig.

    Raises
    ------
    InputError
        With what would fit better: mirrored or turned images.
    """
    far = quality.epsilon > STRANGER_EPSILON or quality.typical > POOR_NOISE * quality.noise
    if quality.explained > STRANGER_R2 or not far:
        return
    few = thinned(samples, MIRROR_BUDGET)
    own = _value_per_pixel(few)
    flips = {
        "mirrored left to right": (slice(None), slice(None, None, -1)),
        "mirrored top to bottom": (slice(None, None, -1), slice(None)),
        "turned by 180°": (slice(None, None, -1), slice(None, None, -1)),
    }
    better = {name: _value_per_pixel(_flipped(few, flip)) - own for name, flip in flips.items()}
    name = max(better, key=lambda key: better[key])
    hint = (
        f"; they fit far better {name}: turn them, or correct the camera's roll and azimuth in the rig"
        if better[name] > LEAST_IMPROVEMENT
        else "; check that rig, part, placement and postures are those of the images, or try --free shift where the "
        "part lies a little off"
    )
    raise InputError(
        f"the images do not look like this part on this rig: {100.0 * quality.epsilon:.0f} % of the pixels are "
        f"unexplained, and the residual of the others is {quality.rms:.3g} grey levels rms where the sensor's noise "
        f"makes {quality.noise:.2g}{hint}"
    )


def _value_per_pixel(samples: Samples) -> float:
    return estimate(samples).maximum.evaluation.value / len(samples.level)


def _flipped(samples: Samples, flip: tuple[slice, slice]) -> Samples:
    levels = [image.levels[flip] for image in samples.images]
    saturated = [image.saturated[flip] for image in samples.images]
    return samples.remeasured(levels, saturated)


def _rms(values: NDArray[np.float64]) -> float:
    return math.sqrt(float(np.mean(values**2))) if len(values) else 0.0
