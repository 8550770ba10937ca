"""The images of a posture and the prediction of the good part: gains and dark level fitted, exposures merged.

They are the input of fusion and detection.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from lightopt.core.arrays import Bool, Float32, Float64, Index, UInt8
from lightopt.core.errors import InputError, counted
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.core.transforms import Posture
from lightopt.defects import SCALES_PX, clipped_variance
from lightopt.estimate.registration import DARK_SPREAD, GAIN_SPREAD, LEVEL_CAP, Observation, refuse_mismatch
from lightopt.inspection._image_blocks import in_image_blocks
from lightopt.inspection.prediction._predict import Prediction
from lightopt.scene import Scene

PIXELS_PER_IMAGE = 40_000  # about so many pixels of an image are used: all of them would hardly improve the fit

HUBER, TUKEY = 1.5, 4.685
ROUNDS = 12
# black is no lighter than that share of an image's pixels, and so many times the noise of black
DARK_QUANTILE, DARK_NOISE = 0.05, 4.0

MOST_GAIN = 4.0  # gains further from those of the rig, up or down, are not accepted

_ARRAYS = ("level", "predicted", "deviation", "slack", "limit", "saturated")

# Standard deviation of the mean over a pixel, as a share of its difference from the centre: few rays stand for it, and
# the flank of a highlight may climb through all levels inside a pixel.
SAMPLING = np.float32(0.15)

# Images show the means over pixels unless levels go by more than this share to those of the pixels' centres.
CENTRES = 0.2
# That is the case where the sum of squared differences between centres and means, in units of noise, is less than this.
# Levels further off than a centre is by so many standard deviations are those of a defect.
NO_EDGES, WITHIN = 10.0, 4.0

_Blur = tuple[str, float]  # a light, and for a part that moves the exposure that blurs it; else 0

# noise of this variance [sensor level²] before rounding makes the mean of rounded levels the light's, to 0.002
EVEN_VARIANCE = 0.3


@dataclass(frozen=True, kw_only=True)
class Photometry:
    """Brightness of the lights and of black, as the images have them."""

    gains: dict[str, float]  # by name of the light, measured over predicted brightness
    dark: float  # above the rig's black level [sensor level]


@dataclass(frozen=True, kw_only=True)
class PostureView:
    """Images of one posture, one per light, and the prediction; all levels in grey levels at exposure 1."""

    posture: Posture
    lights: tuple[str, ...]  # names, of those that the set has for this posture
    # measured, black level and the lights' gains taken out, shape (lights, H, W). Of several exposures of a light each
    # pixel has the longest that is saturated neither in the image nor in the prediction
    level: Float32
    predicted: Float32  # of the good part, same shape
    # standard deviation of a good part's level, by the sensor's noise, the part's waviness, the few rays that stand for
    # the mean over a pixel, and those of the light from the part to the part, same shape
    deviation: Float32
    # by how much a good part's level may be off besides: by rounding, where noise does not even it out, and, in images
    # of pixels' centres, by what differs inside a pixel, same shape
    slack: Float32
    # level from which a pixel is saturated, same shape; where it is, not above `level`: a lower bound is never darker
    # than the good part
    limit: Float32
    saturated: Bool  # where `level` is only a lower bound, same shape
    prediction: Prediction  # the images that `predicted` is from, and the pixels that can be judged
    photometry: Photometry
    # variance by which `deviation` is greater for the waviness of good parts, were that independent from pixel to
    # pixel, same shape; None for smooth ones
    wavy: Float32 | None = None

    @cached_property
    def specular(self) -> Float32:
        """The highlights' share of `predicted`, same shape; stacked on first use."""
        images = {image.light: image.specular for image in self.prediction.images.lights}
        return np.stack([cast("Float32", images[light]) for light in self.lights])

    @property
    def part(self) -> Bool:
        """Pixels that show the part, shape (H, W)."""
        return self.prediction.images.geometry.hit

    @property
    def clean(self) -> Bool:
        """Evaluable pixels, shape (H, W)."""
        return self.prediction.clean


def posture_view(
    scene: Scene,
    observations: Sequence[Observation],
    prediction: Prediction,
    *,
    where: str,
    exact: bool = True,
    threads: int | None = None,
) -> PostureView:
    """Compare the images of one posture with its prediction: fit gains and dark level, merge exposures.

    observations: Of one posture.
    where: The set, for messages.
    exact: Whether the prediction is expected to describe the images; else it is not refused where it does not.
    Raises InputError: images that do not look like the prediction, or that are all saturated.
    """
    clean = prediction.clean
    if clean.any() and all(bool((o.saturated | ~clean).all()) for o in observations):
        raise InputError(
            f"{where}, posture {observations[0].posture}: all {clean.sum():,} evaluable pixels of the part "
            f"are saturated in each of {counted(len(observations), 'image')}; capture them with a "
            "shorter exposure or less light"
        )
    moves = bool(prediction.blurred)
    images = {_blur(o, moves): prediction.image(o.light, o.exposure) for o in observations}
    means = {key: image.level for key, image in images.items()}
    inside = {key: image.inside for key, image in images.items() if image.inside is not None}
    errors = {key: image.error for key, image in images.items() if image.error is not None}
    waviness, correlated = prediction.waviness, 1.0
    spreads = None
    if waviness is not None:
        correlated = waviness.waviness.correlated_pixels(waviness.footprint, SCALES_PX)
        spreads = [np.float32(math.sqrt(correlated)) * waviness.spread[o.light] for o in observations]
    lights = tuple(
        image.light for image in prediction.images.lights if any(o.light == image.light for o in observations)
    )
    shape = len(lights), *clean.shape
    arrays: dict[str, Any] = {
        name: np.empty(shape, np.bool_ if name == "saturated" else np.float32) for name in _ARRAYS
    }
    wavy = None if waviness is None else np.empty(shape, np.float32)
    # of a part that moves, which of its light's exposures each pixel is from
    number_of = np.zeros(shape if moves else (len(lights), 0, 0), np.uint8)

    def merge_images(levels: Mapping[_Blur, Float32]) -> Photometry:
        predicted = [levels[_blur(o, moves)] for o in observations]
        photometry = fit_photometry(observations, predicted, clean, scene, spreads=spreads, threads=threads)

        def merge(number: int, rows: slice) -> None:
            light = lights[number]
            own = {name: array[number, rows] for name, array in arrays.items()}
            some = [o for o in observations if o.light == light]
            _merge_exposures(scene, some, levels, photometry, rows, own, number_of[number, rows])
            if waviness is not None and wavy is not None:
                spread = waviness.spread[light][rows]
                _add_waviness(own["predicted"], spread, own["limit"], correlated, own["deviation"], wavy[number, rows])

        in_image_blocks(merge, len(lights), len(clean), threads)
        return photometry

    def merged(levels: Mapping[_Blur, Float32], number: int) -> Float32:
        # of the exposures that pixels are from
        own = [levels[key] for key in _longest_first(means, lights[number])]
        return np.choose(number_of[number], own) if moves else own[0]

    photometry = merge_images(means)
    if inside:
        differing = [merged(inside, i) for i in range(len(lights))]
        if (share := _share_of_centres(arrays, differing, clean)) > CENTRES:
            photometry = merge_images({key: means[key] + share * inside[key] for key in means})
            for i in range(len(lights)):
                # the edge of a shadow is on either side of a centre, however little the part is off
                arrays["slack"][i] += share * np.abs(merged(inside, i))
        for i in range(len(lights)):
            mean = merged(means, i)
            _add_deviation(arrays, i, mean, mean + merged(inside, i), SAMPLING)
    for i in range(len(lights) if errors else 0):
        mean, error = merged(means, i), merged(errors, i)
        _add_deviation(arrays, i, mean - error, mean + error, 0.5)
    posture = observations[0].posture
    if exact:
        level, predicted, limit, deviation = (arrays[k] for k in ("level", "predicted", "limit", "deviation"))
        refuse_mismatch(level, predicted, limit, deviation, some_pixels(clean), f"{where}, posture {posture}")
    return PostureView(
        posture=posture, lights=lights, prediction=prediction, photometry=photometry, wavy=wavy, **arrays
    )


def _add_deviation(
    arrays: Mapping[str, Any], number: int, low: Float32, high: Float32, share: float | np.float32
) -> None:
    # of a share of what levels of a light differ by, as far as these are not saturated
    limit, deviation = arrays["limit"][number], arrays["deviation"][number]
    deviation[:] = np.hypot(deviation, share * (np.minimum(high, limit) - np.minimum(low, limit)))


def _blur(observation: Observation, moves: bool) -> _Blur:
    return observation.light, observation.exposure if moves else 0.0


def _longest_first(images: Mapping[_Blur, Float32], light: str) -> list[_Blur]:
    return sorted((key for key in images if key[0] == light), key=lambda key: -key[1])


def _merge_exposures(
    scene: Scene,
    observations: Sequence[Observation],
    levels: Mapping[_Blur, Float32],
    photometry: Photometry,
    rows: slice,
    own: dict[str, Any],
    number_of: UInt8,
) -> None:
    # write some rows of what PostureView has of a light, shape (h, W): of each pixel the longest exposure that is not
    # saturated, and its number in `number_of` unless that is empty
    sensor = scene.sensor
    exposures = sorted(observations, key=lambda o: -o.exposure)
    gain = photometry.gains[exposures[0].light]
    keys = _longest_first(levels, exposures[0].light)
    open_ = np.ones(own["level"].shape, np.bool_)
    for number, o in enumerate(exposures):
        scale = gain * o.exposure * sensor.max_level / scene.reflectance.full_scale
        still = sensor.noise_variance(0.0, frames=o.frames)
        subtracted = np.broadcast_to(np.float32(o.subtracted), o.levels.shape)[rows]
        image = np.ascontiguousarray(o.levels[rows]), o.saturated[rows], np.ascontiguousarray(subtracted)
        black = sensor.black_level + photometry.dark, photometry.dark, sensor.saturated_from - sensor.black_level
        pattern = sensor.prnu**2
        variance = still, sensor.noise_variance(1.0, frames=o.frames) - still - pattern, pattern
        result = own["level"], own["deviation"], own["slack"], own["limit"], own["saturated"], own["predicted"]
        last, key = number + 1 == len(exposures), _blur(o, number_of.size > 0)
        _merge_exposure(
            image, levels[key][rows], open_, last, scale, black, variance, result, number_of, keys.index(key)
        )


@kernel
def _merge_exposure(
    image: tuple[Float32, Bool, Float32],
    predicted: Float32,
    open_: Bool,
    last: bool,
    scale: float,
    black: tuple[float, float, float],
    noise: tuple[float, float, float],
    result: tuple[Float32, Float32, Float32, Float32, Bool, Float32],
    number_of: UInt8,
    number: int,
) -> None:
    # one exposure, of the pixels that no longer one could measure: where it is not saturated, or is the last
    (levels, full, subtracted), (zero, dark, saturation), (still, shot, pattern) = image, black, noise
    level, deviation, slack, limit, saturated, shown = result
    height, width = levels.shape
    for y in range(height):
        for x in range(width):
            if not open_[y, x]:
                continue
            top = saturation - subtracted[y, x]
            signal = min(predicted[y, x] * scale, top)
            if not last and (full[y, x] or signal >= top):
                continue
            open_[y, x] = False
            shown[y, x] = predicted[y, x]
            if number_of.size:
                number_of[y, x] = number
            level[y, x] = (levels[y, x] - zero) / scale
            variance = still + (shot + pattern * signal) * signal
            deviation[y, x] = math.sqrt(variance) / scale
            before = variance - 1.0 / 12.0
            slack[y, x] = 0.0
            if before < EVEN_VARIANCE:
                # the first harmonic of what rounding does to the mean of a normal deviate, or half a level without any
                slack[y, x] = 0.5 * math.exp(-2.0 * math.pi**2 * before) / scale
            limit[y, x] = (top - 0.5 - dark) / scale
            saturated[y, x] = full[y, x]
            if full[y, x]:
                limit[y, x] = min(limit[y, x], level[y, x])


def _share_of_centres(arrays: dict[str, Any], inside: Sequence[Float32], clean: Bool) -> np.float32:
    # by which share levels go from the mean over each pixel to its centre, by least squares: a camera's pixels average
    # over their area, a renderer's may have one ray each
    across, square = 0.0, NO_EDGES
    for i, differing in enumerate(inside):
        level, predicted, deviation, limit, saturated = (
            arrays[name][i] for name in ("level", "predicted", "deviation", "limit", "saturated")
        )
        index = np.flatnonzero(clean & ~saturated & (predicted + np.abs(differing) < limit) & (differing != 0.0))
        noise = deviation.ravel()[index].astype(np.float64)
        step = differing.ravel()[index] / noise
        off = (level.ravel()[index] - predicted.ravel()[index]) / noise
        within = np.abs(off - 0.5 * step) < 0.5 * np.abs(step) + WITHIN
        across += float(step[within] @ off[within])
        square += float(step[within] @ step[within])
    return np.float32(min(max(across / square, 0.0), 1.0))


@kernel
def _add_waviness(
    predicted: Float32, spread: Float32, limit: Float32, correlated: float, deviation: Float32, wavy: Float32
) -> None:
    for y in range(len(predicted)):
        for x in range(predicted.shape[1]):
            wavy[y, x] = clipped_variance(predicted[y, x], spread[y, x], limit[y, x])
            deviation[y, x] = math.sqrt(deviation[y, x] * deviation[y, x] + correlated * wavy[y, x])


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
    spreads: Sequence[Float32] | None = None,
    threads: int | None = None,
) -> Photometry:
    """Gain of each light and a common dark level, by robust least squares over pixels that are neither black nor full.

    predicted: for each image, levels of the good part [grey level at exposure 1], shape (H, W).
    clean: the pixels to use, shape (H, W).
    spreads: for each image, by how much good parts scatter besides the sensor's noise, as `predicted`; None for not.
    """
    names = [light.name for light in scene.lights]
    n = len(names)

    scatter = [None] * len(observations) if spreads is None else spreads

    def sample(number: int) -> tuple[int, Float64, Float64, Float64]:
        o = observations[number]
        return names.index(o.light), *_sample(scene, o, predicted[number], scatter[number], clean)

    rows = in_threads(sample, range(len(observations)), threads)
    everywhere = some_pixels(clean)
    darkest = min((_darkest(scene, o, everywhere) for o in observations), default=np.inf)
    x = np.append(np.ones(n), 0.0)
    prior = np.append(np.full(n, 1.0 / GAIN_SPREAD**2), 1.0 / DARK_SPREAD**2)
    nominal = x.copy()
    # not with core.least_squares: each image has a spread of its own, and sums in one pass need no matrix of pixels
    for number in range(ROUNDS):
        normal, right = np.diag(prior), prior * nominal
        for light, model, level, noise in rows:
            if not len(model):
                continue
            off = np.abs(level - x[light] * model - x[n]) / noise
            spread = max(1.4826 * float(np.median(off)), 1.0)
            # Huber's weights find the place whatever the start; a defect of a tenth of the surface still moves it
            redescending = number >= ROUNDS // 2
            reach = (TUKEY if redescending else HUBER) * spread
            square, both, count, seen, total = _robust_sums(off, model, level, noise, reach, redescending)
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
    sets: list[tuple[int, Float64, Float64, Float64, Float64, Float64]] = []
    for o, light, own in zip(observations, predicted, scatter, strict=True):
        levels = _above_black(scene, o, light, everywhere)
        noise, whole = _noise(scene, o, levels[0], own, everywhere)
        sets.append((names.index(o.light), *levels, np.square(noise / whole)))  # share of the sensor's noise
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


def _noise(
    scene: Scene, o: Observation, model: Float64, spread: Float32 | None, index: Index
) -> tuple[Float64, Float64]:
    # standard deviations of levels at some pixels: of the sensor's noise, and with the scatter of good parts
    noise = np.sqrt(scene.sensor.noise_variance(model, frames=o.frames))
    if spread is None:
        return noise, noise
    scale = o.exposure * scene.sensor.max_level / scene.reflectance.full_scale
    return noise, np.hypot(noise, scale * spread.ravel()[index])


def _sample(
    scene: Scene, o: Observation, predicted: Float32, spread: Float32 | None, clean: Bool
) -> tuple[Float64, Float64, Float64]:
    # predicted and measured levels above black and their noise, at pixels that are neither black nor full
    index = some_pixels(clean & ~o.saturated)
    model, level, _, top = _above_black(scene, o, predicted, index)
    noise, whole = _noise(scene, o, model, spread, index)
    usable = (model + 4.0 * noise < top) & (model > 4.0 * noise)
    return model[usable], level[usable], whole[usable]


def _capped_residual(sets: Sequence[tuple[int, Float64, Float64, Float64, Float64, Float64]], x: Float64) -> float:
    # sum of squared residuals over all pixels, black and full ones as the camera clips them; up to a cap, so that a
    # defect does not change the gains. What scatters from part to part counts for less
    total = 0.0
    for light, model, level, bottom, top, share in sets:
        off = np.minimum(level, top) - np.clip(x[light] * model + x[-1], bottom, top)
        total += float(np.sum(share * np.minimum(np.square(off), np.square(LEVEL_CAP * (top - bottom)))))
    return total


def _darkest(scene: Scene, o: Observation, index: Index) -> float:
    # the lightest that black may be: where a part is dark, a lobe of another shape would pass for a dark level
    if not len(index):
        return np.inf
    level = o.levels.ravel()[index].astype(np.float64) - scene.sensor.black_level
    noise = math.sqrt(scene.sensor.noise_variance(0.0, frames=o.frames))
    return max(0.0, float(np.quantile(level, DARK_QUANTILE))) + DARK_NOISE * noise


@kernel
def _robust_sums(
    off: Float64, model: Float64, level: Float64, noise: Float64, reach: float, redescending: bool
) -> tuple[float, float, float, float, float]:
    # with Huber's or Tukey's weights w: sums of w·m², w·m, w, w·m·level, w·level
    square, both, count, seen, total = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(off)):
        share = off[i] / reach
        weight = max(1.0 - share * share, 0.0) ** 2 if redescending else 1.0 / max(share, 1.0)
        weight /= noise[i] * noise[i]
        weighted = weight * model[i]
        square += weighted * model[i]
        both += weighted
        count += weight
        seen += weighted * level[i]
        total += weight * level[i]
    return square, both, count, seen, total
