"""Observations: the images of a set, checked against the rig, less what their dark frames show."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.config import PartConfig, RigConfig
from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.errors import InputError, counted, refuse
from lightopt.core.threads import in_threads
from lightopt.core.transforms import Posture
from lightopt.images import ImageEntry, ImageSet, dark_name, read_metadata, read_png
from lightopt.optics import Sensor, clipped_mean
from lightopt.scene import build_sensor

ANGLE_TOLERANCE_DEG = 0.01  # a light that the manifest has this far from where the rig has it was elsewhere
# a level q says that the signal was between q − h and q + h [sensor level]: half a level of a quantised PNG, and for an
# EXR, which is not quantised, so little that it is the value itself
PNG_HALF_WIDTH, EXR_HALF_WIDTH = 0.5, 0.05
_REACH_PX = 4  # a frame without light is smoothed over windows of 9 × 9 pixels, except where it shows more than noise


@dataclass(frozen=True, kw_only=True)
class Observation:
    """One image."""

    light: str
    posture: Posture
    exposure: float  # at which `levels` were taken; 1 for a linear EXR
    # sensor levels, black level included, shape (height, width): as delivered, minus what the set's frames without
    # light show above black; or from an EXR
    levels: Float32
    saturated: Bool  # where `levels` are only a lower bound, same shape
    half_width: float  # how far from a level the signal may have been [sensor level]
    source: Path
    frames: int = 1  # number of frames that it is the mean of
    # dark level that was taken off `levels` [sensor level], shape (height, width) or the same for all pixels: so much
    # below the sensor's saturation level they are saturated
    subtracted: Float32 | float = 0.0

    @property
    def name(self) -> str:
        exposure = "" if self.exposure == 1.0 else f" ×{self.exposure:g}"
        return f"{self.light} {self.posture}{exposure}"


def observed_postures(image_set: ImageSet) -> tuple[Posture, ...]:
    return tuple(dict.fromkeys(entry.posture for entry in image_set.images))


def read_observations(
    image_set: ImageSet, rig: RigConfig, part: PartConfig, *, threads: int | None = None
) -> tuple[Observation, ...]:
    """Read all images of a set: PNG with the manifest's exposure, EXR only where there is no PNG.

    From the images of a set captured with frames without light those are subtracted.

    Raises InputError: no images; lights, angles, bit depth, levels or sizes that are not the rig's. All problems at
        once.
    """
    refuse([*_manifest_problems(image_set, rig, part), *_light_problems(image_set, rig)])
    width, height = rig.camera.resolution_px
    entries, sensor = image_set.images, build_sensor(rig.camera)
    observations = tuple(in_threads(lambda i: _read(image_set, entries[i], sensor), range(len(entries)), threads))
    other = [o for o in observations if o.levels.shape != (height, width)]
    if other:
        rows, columns = other[0].levels.shape
        more = f" (and {counted(len(other) - 1, 'image')} more of another size)" if len(other) > 1 else ""
        raise InputError(
            f"{other[0].source}: {columns} × {rows} px, but the rig's camera has {width} × {height} px "
            f"({rig.source.at('camera', 'resolution_px')}); give the rig that the images were taken with{more}"
        )
    return observations


def _manifest_problems(image_set: ImageSet, rig: RigConfig, part: PartConfig) -> Iterable[str]:
    manifest, sensor, where = image_set.manifest, rig.camera.sensor, image_set.folder
    of_sensor = ("camera", "sensor")
    if not manifest.images:
        yield f"{where}: the image set lists no images; expected at least one"
    if manifest.bit_depth != sensor.bit_depth:
        at = rig.source.at(*of_sensor, "bit_depth")
        yield f"{where}: images of {manifest.bit_depth} bits, but the rig's sensor has {sensor.bit_depth} ({at})"
        return
    saturation, full_scale = build_sensor(rig.camera).saturated_from, part.reflectance.full_scale
    saturated = saturation if manifest.saturation_level is None else manifest.saturated_from
    black = manifest.black_level or sensor.black_level
    for what, found, expected, at in (
        ("saturation level", saturated, saturation, rig.source.at(*of_sensor, "saturation_level")),
        ("black level", black, sensor.black_level, rig.source.at(*of_sensor, "black_level")),
        ("full scale", manifest.full_scale, full_scale, part.source.at("reflectance", "full_scale")),
    ):
        if found != expected:
            yield f"{where}: {what} {found:g}, but {at} has {expected:g}; correct whichever is wrong"


def _light_problems(image_set: ImageSet, rig: RigConfig) -> Iterable[str]:
    lights = {light.name: light for light in rig.lights}
    places = dict.fromkeys((e.light, e.light_elevation_deg, e.light_azimuth_deg) for e in image_set.images)
    for name, elevation, azimuth in places:
        if name not in lights:
            yield f'{image_set.folder}: light "{name}" is not in {rig.source.path}; it has {", ".join(lights)}'
            continue
        light = lights[name]
        off = math.remainder(azimuth - light.azimuth_deg, 360.0), elevation - light.elevation_deg
        if max(map(abs, off)) > ANGLE_TOLERANCE_DEG:
            at = rig.source.at("lights", list(lights).index(name))
            yield (
                f"{image_set.folder}: {name} stood at elevation {elevation:g}°, azimuth {azimuth:g}°, but {at} has "
                f"{light.elevation_deg:g}°, {light.azimuth_deg:g}°; give the rig that the images were taken with"
            )


def _read(image_set: ImageSet, entry: ImageEntry, sensor: Sensor) -> Observation:
    image = image_set.load(entry)
    manifest = image_set.manifest
    delivered = image.sensor is not None
    if image.sensor is not None:
        levels, subtracted = _above_dark(image_set, entry, image.sensor, sensor)
    else:
        levels, subtracted = image.levels * (manifest.max_level / manifest.full_scale) + manifest.black_level, 0.0
        levels = levels.astype(np.float32)
        if manifest.kind != "captured":
            # whether a foreign file was clipped is not known: saturated levels only say that they are at least that
            ceiling = manifest.black_level + (manifest.saturated_from - manifest.black_level) / entry.held_exposure
            levels = np.where(image.saturated, np.minimum(levels, np.float32(ceiling)), levels)
    return Observation(
        light=entry.light,
        posture=entry.posture,
        exposure=entry.held_exposure if delivered else 1.0,
        levels=levels,
        saturated=image.saturated,
        half_width=PNG_HALF_WIDTH if delivered else EXR_HALF_WIDTH,
        source=image_set.path((entry.png if delivered else entry.exr) or ""),
        frames=frames_of(entry) if delivered else 1,
        subtracted=subtracted,
    )


def _above_dark(
    image_set: ImageSet, entry: ImageEntry, delivered: NDArray[Any], sensor: Sensor
) -> tuple[Float32, Float32 | float]:
    """Sensor levels less what the panel did not light, and that; saturated ones stay lower bounds, zeros upper ones."""
    dark = dark_levels(image_set, entry, sensor)
    if dark is None:
        return delivered.astype(np.float32), 0.0
    if dark.shape != delivered.shape:
        raise InputError(f"{image_set.path(entry.png or '')}: its frame without light has another size; capture both")
    subtracted = dark - sensor.black_level
    levels = np.minimum(delivered, math.ceil(sensor.saturated_from)) - subtracted
    levels = np.where(delivered == 0, np.minimum(levels, 0.0), levels)
    return levels.astype(np.float32), subtracted.astype(np.float32)


def frames_of(entry: ImageEntry) -> int:
    """Number of frames that an image is the mean of, from its manifest; 1 by default."""
    facts = entry.extra.get("capture")
    frames = facts.get("frames", 1) if isinstance(facts, dict) else 1
    return frames if isinstance(frames, int) and frames > 0 else 1


def dark_levels(image_set: ImageSet, entry: ImageEntry, sensor: Sensor) -> Float64 | None:
    """Levels of an image of a captured set without its light [sensor level], shape (H, W).

    None where the set was captured without such frames: the sensor's black level is all that is known then.
    Raises InputError: when the set was captured with frames without light, but that of the image is not listed.
    """
    if not image_set.manifest.options.get("dark"):
        return None
    name = dark_name(entry.posture, entry.exposure)
    if name not in image_set.manifest.files:
        raise InputError(f"{image_set.folder}: the manifest does not list the dark frame {name}; resume the capture")
    path = image_set.path(name)
    levels = read_png(path).astype(np.float64)
    mean = read_metadata(path).get("mean_level")
    if isinstance(mean, int | float):
        levels += mean - float(levels.mean())  # of several frames the PNG has the rounded mean
    return smoothed(levels, sensor=sensor, frames=frames_of(entry))


def smoothed(levels: Float64, *, sensor: Sensor, frames: int) -> Float64:
    """A dark frame, freed of noise where it shows nothing else, and of what clipping at level 0 adds.

    Where the variance in a window is that of the noise the window's mean is taken, elsewhere as much of the pixel
    itself as the variance says (Lee 1980, doi:10.1109/TPAMI.1980.4766994).
    """
    mean = _window_mean(levels)
    variance = np.maximum(_window_mean(levels * levels) - mean * mean, 0.0)
    noise = sensor.noise_variance(mean - sensor.black_level)
    # a window's variance scatters: only what clearly exceeds that of noise is a pattern
    own = np.clip(1.0 - 2.0 * (noise / frames) / np.maximum(variance, 1e-12), 0.0, 1.0)
    return _unclipped(mean, sensor) + own * (levels - mean)


def _window_mean(image: Float64) -> Float64:
    """Means over square windows, which are cut off at the image's border."""
    for axis in (0, 1):
        size = image.shape[axis]
        total = np.insert(np.cumsum(image, axis=axis), 0, 0.0, axis=axis)
        low = np.maximum(np.arange(size) - _REACH_PX, 0)
        high = np.minimum(np.arange(size) + _REACH_PX + 1, size)
        count = (high - low).astype(np.float64)
        image = (total.take(high, axis) - total.take(low, axis)) / (count[:, None] if axis == 0 else count)
    return image


def _unclipped(mean: Float64, sensor: Sensor) -> Float64:
    """Mean of a signal whose noisy levels, none of which is below 0, have the mean given."""
    noise = sensor.read_noise_levels
    if noise < 0.3 or float(mean.min()) > 6.0 * noise:
        return mean  # levels are too coarse, or none is clipped
    signal = np.arange(-noise, 6.0 * noise, noise / 50.0)
    shown, _ = clipped_mean(signal, noise)
    return np.where(mean < shown[-1], np.interp(mean, shown, signal), mean)
