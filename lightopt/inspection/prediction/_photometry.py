"""Gains of the lights and the dark level, fitted to the images of a posture."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Bool, Float32, Float64, Index
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.estimate.registration import DARK_SPREAD, GAIN_SPREAD, LEVEL_CAP, Observation
from lightopt.scene import Scene

PIXELS_PER_IMAGE = 40_000  # about so many pixels of an image are used: all of them would hardly improve the fit

HUBER = 1.5
ROUNDS = 12
# black is no lighter than that share of an image's pixels, and so many times the noise of black
DARK_QUANTILE, DARK_NOISE = 0.05, 4.0

MOST_GAIN = 4.0  # gains further from those of the rig, up or down, are not accepted


@dataclass(frozen=True, kw_only=True)
class Photometry:
    """Brightness of the lights and of black, as the images have them.

    gains: by name of the light, measured over predicted brightness.
    dark: above the rig's black level [sensor level].
    """

    gains: dict[str, float]
    dark: float


def some_pixels(mask: Bool) -> Index:
    """Flat indices of pixels of a mask, shape (H, W); every n-th where there are more than are needed."""
    index = np.flatnonzero(mask)
    return index[:: max(1, len(index) // PIXELS_PER_IMAGE)]


def fit_photometry(
    observations: Sequence[Observation],
    predicted: Sequence[Float32],
    clean: Bool,
    scene: Scene,
    *,
    threads: int | None = None,
) -> Photometry:
    """Gain of each light and a common dark level, by robust least squares over pixels that are neither black nor full.

    predicted: for each image, levels of the good part [grey level at exposure 1], shape (H, W).
    clean: the pixels to use, shape (H, W).
    """
    names = [light.name for light in scene.lights]
    n = len(names)

    def sample(number: int) -> tuple[int, Float64, Float64, Float64]:
        o = observations[number]
        return names.index(o.light), *_sample(scene, o, predicted[number], clean)

    rows = in_threads(sample, range(len(observations)), threads)
    everywhere = some_pixels(clean)
    darkest = min((_darkest(scene, o, everywhere) for o in observations), default=np.inf)
    x = np.append(np.ones(n), 0.0)
    prior = np.append(np.full(n, 1.0 / GAIN_SPREAD**2), 1.0 / DARK_SPREAD**2)
    nominal = x.copy()
    # not with align.solve: each image has a spread of its own here, and sums in one pass need no matrix of all pixels
    for _ in range(ROUNDS):
        normal, right = np.diag(prior), prior * nominal
        for light, model, level, noise in rows:
            if not len(model):
                continue
            off = np.abs(level - x[light] * model - x[n]) / noise
            spread = max(1.4826 * float(np.median(off)), 1.0)
            square, both, count, seen, total = _huber_sums(off, model, level, noise, HUBER * spread)
            normal[light, light] += square
            normal[n, n] += count
            normal[light, n] += both
            normal[n, light] += both
            right[light] += seen
            right[n] += total
        x = np.linalg.solve(normal, right)
        if x[n] > darkest:
            x[n] = darkest
            x[:n] = (right[:n] - normal[:n, n] * darkest) / np.diag(normal)[:n]
    accepted = np.all((x[:n] >= 1.0 / MOST_GAIN) & (x[:n] <= MOST_GAIN))
    sets = [
        (names.index(o.light), *_above_black(scene, o, light, everywhere))
        for o, light in zip(observations, predicted, strict=True)
    ]
    if not accepted or _capped_residual(sets, x) > _capped_residual(sets, nominal):
        # not these lights, not this part or another lobe: fitted gains must not hide that
        x = nominal
    return Photometry(gains={name: float(g) for name, g in zip(names, x[:n], strict=True)}, dark=float(x[n]))


def _above_black(
    scene: Scene, o: Observation, predicted: Float32, index: Index
) -> tuple[Float64, Float64, Float64, Float64]:
    # predicted and measured levels above black at some pixels, and those at which the camera clips them
    sensor = scene.sensor
    scale = np.float32(o.exposure * sensor.max_level / scene.reflectance.full_scale)
    model = (predicted.ravel()[index] * scale).astype(np.float64)
    level = o.levels.ravel()[index].astype(np.float64) - sensor.black_level
    subtracted = np.broadcast_to(np.float32(o.subtracted), predicted.shape).reshape(-1)[index]
    bottom = -sensor.black_level - subtracted
    return model, level, bottom, bottom + sensor.saturated_from


def _sample(scene: Scene, o: Observation, predicted: Float32, clean: Bool) -> tuple[Float64, Float64, Float64]:
    # predicted and measured levels above black and the noise, at pixels that are neither black nor full
    model, level, _, top = _above_black(scene, o, predicted, some_pixels(clean & ~o.saturated))
    noise = np.sqrt(scene.sensor.noise_variance(model, frames=o.frames))
    usable = (model + 4.0 * noise < top) & (model > 4.0 * noise)
    return model[usable], level[usable], noise[usable]


def _capped_residual(sets: Sequence[tuple[int, Float64, Float64, Float64, Float64]], x: Float64) -> float:
    # sum of squared residuals over all pixels, black and full ones as the camera clips them; up to a cap, so that a
    # defect does not change the gains
    total = 0.0
    for light, model, level, bottom, top in sets:
        off = np.minimum(level, top) - np.clip(x[light] * model + x[-1], bottom, top)
        total += float(np.sum(np.minimum(np.square(off), np.square(LEVEL_CAP * (top - bottom)))))
    return total


def _darkest(scene: Scene, o: Observation, index: Index) -> float:
    # the lightest that black may be: where a part is dark, a lobe of another shape would pass for a dark level
    if not len(index):
        return np.inf
    level = o.levels.ravel()[index].astype(np.float64) - scene.sensor.black_level
    noise = math.sqrt(scene.sensor.noise_variance(0.0, frames=o.frames))
    return max(0.0, float(np.quantile(level, DARK_QUANTILE))) + DARK_NOISE * noise


@kernel
def _huber_sums(
    off: Float64, model: Float64, level: Float64, noise: Float64, reach: float
) -> tuple[float, float, float, float, float]:
    # with Huber's weights w: sums of w·m², w·m, w, w·m·level, w·level
    square, both, count, seen, total = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(off)):
        weight = min(1.0, reach / max(off[i], 1e-9)) / (noise[i] * noise[i])
        weighted = weight * model[i]
        square += weighted * model[i]
        both += weighted
        count += weight
        seen += weighted * level[i]
        total += weight * level[i]
    return square, both, count, seen, total
