"""Image sets of good and defective samples, each with one image per light, and the masks of their defects."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Float64, Int32, UInt8
from lightopt.core.errors import InputError, counted, refuse
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.design.from_images._labels import part_pixels, read_labels, read_mask
from lightopt.design.from_images._sensor_noise import ROUNDING
from lightopt.images import ImageEntry, ImageSet, Manifest, read_image_set

MOST_SATURATED = 0.001  # of several exposures of a light, the longest is used that saturates at most this share
LIT_SHARE = 0.02  # of full scale; without a geometry image, what no light makes brighter is background


@dataclass(frozen=True)
class Channel:
    light: str
    exposure: float


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Image sets of one rig, which show samples at the same place of the image."""

    sets: tuple[ImageSet, ...]
    names: tuple[str, ...]
    channels: tuple[Channel, ...]
    postures: tuple[Posture, ...]
    # per set and posture, shape (sets, postures, H, W): number of the defect that a pixel shows, from 0 in each set, −1
    # for none
    labels: Int32
    defects: tuple[tuple[str, ...], ...]  # per set, the names of its defects
    regions: tuple[Bool, ...]  # per posture the pixels of the part, shape (H, W)

    @property
    def manifest(self) -> Manifest:
        """Of the first set: sensor and full scale are those of all."""
        return self.sets[0].manifest

    @property
    def limit(self) -> float:
        """Highest level above black that the camera delivers [sensor level]."""
        return self.manifest.max_level - self.manifest.black_level

    @property
    def unsaturated(self) -> float:
        """Level above black from which on a pixel is saturated, less rounding [sensor level]."""
        return self.manifest.saturated_from - self.manifest.black_level - 0.5

    def entry(self, number: int, channel: Channel, posture: Posture) -> ImageEntry:
        key = (channel.light, posture, channel.exposure)
        return next(entry for entry in self.sets[number].images if entry.key == key)

    def load(self, number: int, channel: Channel, posture: Posture) -> Float32:
        """Levels above black at the channel's exposure, clipped as the camera clips [sensor level], shape (H, W).

        Raises InputError: the image is missing, damaged or of another size than those of the first set.
        """
        own, entry = self.sets[number], self.entry(number, channel, posture)
        levels = sensor_levels(own, entry)
        if levels.shape != self.labels.shape[2:]:
            sizes = [f"{shape[1]} × {shape[0]} px" for shape in (self.labels.shape[2:], levels.shape)]
            raise InputError(
                f"{own.path(entry.png or entry.exr or '')}: expected {sizes[0]}, the size of images of "
                f"{self.sets[0].folder}, found {sizes[1]}"
            )
        return levels


def sensor_levels(image_set: ImageSet, entry: ImageEntry) -> Float32:
    """Levels above black at the entry's exposure, clipped as the camera clips [sensor level], shape (H, W)."""
    manifest = image_set.manifest
    levels = image_set.load(entry).levels * np.float32(manifest.max_level * entry.exposure / manifest.full_scale)
    return np.minimum(levels, np.float32(manifest.max_level - manifest.black_level))


def read_samples(paths: Sequence[Path], region: Path | None = None, run: RunContext | None = None) -> Samples:
    """Read image sets, and check that they are of the same lights, exposures, postures and sensor.

    region: PNG that is not 0 where the part is to be inspected, in all postures
    Raises InputError: One message per problem: of a set, of its masks, or what differs between sets.
    """
    run = run or RunContext()
    sets = tuple(read_image_set(path) for path in paths)
    first = sets[0]
    homes = [one.folder.resolve() for one in sets]
    refuse(f"{path}: given twice" for path, home in zip(paths, homes, strict=True) if homes.count(home) > 1)
    refuse([problem for one in sets[1:] for problem in _misfits(first, one)])
    postures = tuple(dict.fromkeys(entry.posture for entry in first.images))
    channels = tuple(_channel(sets, light) for light in dict.fromkeys(entry.light for entry in first.images))
    keys = {entry.key for entry in first.images}
    refuse(
        f"{first.folder}: no image of light {c.light!r} at exposure {c.exposure:g} in posture {posture}"
        for c in channels
        for posture in postures
        if (c.light, posture, c.exposure) not in keys
    )
    shape = first.load(first.images[0]).levels.shape
    problems: list[str] = []
    found = [read_labels(one, postures, shape, problems, run) for one in sets]
    shown = None if region is None else read_mask(region, shape, problems)
    if shown is not None and not problems and not shown.any():
        problems.append(f"{region}: 0 everywhere; expected a picture that is not 0 where the part is to be inspected")
    refuse(problems)
    samples = Samples(
        sets=sets,
        names=_names(sets),
        channels=channels,
        postures=postures,
        labels=np.stack([labels for labels, _ in found]),
        defects=tuple(names for _, names in found),
        regions=(),
    )
    regions = tuple(_region(samples, p) if shown is None else shown for p in range(len(postures)))
    if not all(one.any() for one in regions):
        dark = f"no pixel is brighter than {LIT_SHARE:.0%} of full scale"
        raise InputError(f"{first.folder}: {dark}; take longer exposures, or give a mask with option 'region'")
    return replace(samples, regions=regions)


def _names(sets: Sequence[ImageSet]) -> tuple[str, ...]:
    # of the folders, with a number where two are alike
    names = [one.folder.resolve().name for one in sets]
    numbers = ("" if names.count(name) == 1 else f"-{1 + names[:i].count(name)}" for i, name in enumerate(names))
    return tuple(map("".join, zip(names, numbers, strict=True)))


def _misfits(first: ImageSet, other: ImageSet) -> list[str]:
    # how a set differs from the first one
    problems = [
        f"{other.folder}: {key}: {there}, but {first.folder} has {here}; expected sets of one rig"
        for key in ("bit_depth", "full_scale", "saturated_from", "black_level")
        if (there := getattr(other.manifest, key)) != (here := getattr(first.manifest, key))
    ]
    here, there = ({entry.key: None for entry in one.images} for one in (first, other))
    for one, left, right in ((other, here, there), (first, there, here)):
        missing = [key for key in left if key not in right]
        if missing:
            light, posture, exposure = missing[0]
            more = f" and {counted(len(missing) - 1, 'image')} more" if len(missing) > 1 else ""
            problems.append(
                f"{one.folder}: no image of light {light!r} at exposure {exposure:g} in posture {posture}{more}, which "
                f"{(first if one is other else other).folder} has; expected sets of the same lights and exposures"
            )
    return problems


def _channel(sets: Sequence[ImageSet], light: str) -> Channel:
    # of several exposures the longest that saturates hardly a pixel of the first set; the shortest where all do
    one = sets[0]
    exposures = sorted({entry.exposure for entry in one.images if entry.light == light})
    for exposure in reversed(exposures[1:]):
        entries = [entry for entry in one.images if entry.light == light and entry.exposure == exposure]
        if max(float(one.load(entry).saturated.mean()) for entry in entries) <= MOST_SATURATED:
            return Channel(light, exposure)
    return Channel(light, exposures[0])


def _region(samples: Samples, p: int) -> Bool:
    # of the part: by the geometry of a rendered set, else what some light makes brighter than background, or is masked
    posture = samples.postures[p]
    shown = part_pixels(samples.sets, posture, samples.labels.shape[2:])
    if shown is not None:
        return shown
    brightest = samples.load(0, samples.channels[0], posture)
    for channel in samples.channels[1:]:
        brightest = np.maximum(brightest, samples.load(0, channel, posture))
    lit = brightest > LIT_SHARE * samples.limit
    return lit | (samples.labels[:, p] >= 0).any(axis=0) if lit.any() else lit


MOST_LONGER = 100.0  # times that of the samples, an exposure may be

_STEPS = 1000  # of brightness, of lights whose levels are unknown
_MEAN_PX = 5  # side of the squares whose means are compared as well, in which noise is a fifth


@dataclass(frozen=True, kw_only=True)
class ChosenImage:
    """An image to take: lights that are on together, and how long."""

    name: str
    weights: dict[str, float]  # brightness of each light, relative to that in the samples; the greatest is 1
    exposure: float


@dataclass(frozen=True)
class Agreement:
    """A synthesised image against a captured one, at pixels that are not saturated in any image."""

    image: str
    posture: Posture
    exposure: float
    pixels: int
    rms: float  # [sensor level]
    noise: float  # rms that the sensor's noise and rounding alone make of all images that are compared [sensor level]
    means_rms: float  # of means over squares of 5 × 5 px, where all of them are compared [sensor level]


def chosen_images(
    samples: Samples, tops: Sequence[float], weights: Float64, room: float, levels: Mapping[str, int]
) -> tuple[ChosenImage, ...]:
    """The images of weights (N, K) on the samples' images, each as long as saturation allows.

    tops: Of each image of these weights the level above black that 0.1 % of the part's pixels exceed [sensor level]
    room: What it may be
    levels: Controller level of a light at full brightness, where it is known: its weights are whole levels
    Raises InputError: The lights of an image leave the part black.
    """
    exposures = np.array([channel.exposure for channel in samples.channels])
    images: list[ChosenImage] = []
    for number, (row, top) in enumerate(zip(weights, tops, strict=True), start=1):
        brightness = row * exposures  # a light that was exposed longer is darker than its image
        longest = float(brightness.max())
        if not top * MOST_LONGER > room:
            lights = ", ".join(c.light for c, share in zip(samples.channels, row, strict=True) if share)
            black = f"99.9 % of the part's pixels are black under {lights}, or nearly so"
            raise InputError(f"{samples.sets[0].folder}: {black}; ask for fewer images, or leave the light out")
        exposure = room / float(top) * longest
        lit: dict[str, float] = {}
        for channel, share in zip(samples.channels, brightness / brightness.max(), strict=True):
            steps = levels.get(channel.light, _STEPS)
            if whole := round(float(share) * steps):
                lit[channel.light] = round(whole / steps, 6)
        name = next(iter(lit)) if len(lit) == 1 else f"mix-{number}"
        images.append(ChosenImage(name=name, weights=lit, exposure=_rounded_down(exposure)))
    return tuple(images)


def _rounded_down(value: float) -> float:
    # to three digits, so that rounding saturates nothing
    digits = 2 - int(np.floor(np.log10(value)))
    return float(f"{np.floor(value * 10.0**digits + 1e-9) / 10.0**digits:.3g}")


def weights_of(samples: Samples, images: Sequence[ChosenImage]) -> Float64:
    """Weights of the samples' images in chosen images, up to a factor of each, shape (N, K)."""
    return np.array([[image.weights.get(c.light, 0.0) / c.exposure for c in samples.channels] for image in images])


def synthesise(
    samples: Samples, number: int, image: ChosenImage, posture: Posture, *, exposure: float | None = None
) -> tuple[Float32, Bool]:
    """An image of a set as the camera would deliver it, and where a source of it is saturated, shape (H, W).

    The levels Σ w·(I − b)·t/t₀ + b are not rounded or clipped. [sensor level]

    number: Of the set
    exposure: That of `image` by default
    """
    manifest = samples.sets[number].manifest
    total, saturated = np.float32(0.0), np.False_
    for channel in samples.channels:
        if channel.light in image.weights:
            levels = samples.load(number, channel, posture)
            share = image.weights[channel.light] * (exposure or image.exposure) / channel.exposure
            total = total + np.float32(share) * levels
            saturated = saturated | (levels >= samples.unsaturated)
    return np.asarray(total, np.float32) + np.float32(manifest.black_level), np.asarray(saturated, np.bool_)


def quantised(samples: Samples, levels: Float32) -> UInt8 | NDArray[np.uint16]:
    """Levels as the camera delivers them: rounded half up and clipped."""
    whole = np.clip(np.floor(levels + 0.5), 0, samples.manifest.max_level)
    return whole.astype(np.uint8) if samples.manifest.bit_depth <= 8 else whole.astype(np.uint16)


def compare_captured(
    samples: Samples, images: Sequence[ChosenImage], captured: ImageSet, sensor: tuple[float, float]
) -> tuple[str, tuple[Agreement, ...]]:
    """Compare a captured set with the images of the set that shows the same sample: that which agrees best.

    captured: Its lights are the names of `images`.
    sensor: Variance of the sensor's noise, rounding included: at level 0, and its increase per level
    Returns: Name of the samples' set, and each image of it.
    Raises InputError: The captured set has none of the images, or they are of another size or saturated all over.
    """
    known = {image.name: image for image in images}
    entries = [e for e in captured.images if e.light in known and e.posture in samples.postures]
    if not entries:
        found = ", ".join(sorted({entry.light for entry in captured.images}))
        raise InputError(f"{captured.folder}: none of the chosen images: expected {', '.join(known)}, found {found}")
    found = [
        [_agreement(samples, number, known[entry.light], captured, entry, sensor) for entry in entries]
        for number in range(len(samples.sets))
    ]
    best = min(range(len(found)), key=lambda i: _rms_of_all(found[i], "rms"))
    if not any(one.pixels for one in found[best]):
        raise InputError(f"{captured.folder}: each pixel of the part is saturated; expected shorter exposures")
    return samples.names[best], tuple(found[best])


def _variance(sensor: tuple[float, float], levels: Float32) -> Float64:
    return sensor[0] + sensor[1] * np.maximum(levels, 0.0).astype(np.float64)


def _rms_of_all(found: Sequence[Agreement], key: Literal["rms", "noise", "means_rms"]) -> float:
    pixels = sum(one.pixels for one in found)
    return math.sqrt(sum(getattr(one, key) ** 2 * one.pixels for one in found) / pixels) if pixels else math.inf


def _agreement(
    samples: Samples,
    number: int,
    image: ChosenImage,
    captured: ImageSet,
    entry: ImageEntry,
    sensor: tuple[float, float],
) -> Agreement:
    levels, saturated = synthesise(samples, number, image, entry.posture, exposure=entry.exposure)
    taken = captured.load(entry)
    if taken.levels.shape != levels.shape:
        sizes = (f"{shape[1]} × {shape[0]} px" for shape in (taken.levels.shape, levels.shape))
        raise InputError(f"{captured.folder}: images of {next(sizes)}, but the samples' are of {next(sizes)}")
    own = sensor_levels(captured, entry) + np.float32(captured.manifest.black_level)
    used = samples.regions[samples.postures.index(entry.posture)] & ~saturated & ~taken.saturated
    used &= levels < samples.manifest.saturated_from
    off = np.where(used, own - np.asarray(quantised(samples, levels), np.float32), 0.0)
    variance = ROUNDING + _variance(sensor, levels[used] - samples.manifest.black_level)
    for channel in samples.channels:
        share = image.weights.get(channel.light, 0.0) * entry.exposure / channel.exposure
        variance = variance + share**2 * _variance(sensor, samples.load(number, channel, entry.posture)[used])
    whole = ndimage.uniform_filter(used.astype(np.float32), _MEAN_PX) > 0.999
    means = np.asarray(ndimage.uniform_filter(off, _MEAN_PX), np.float32)[whole]
    return Agreement(
        image=image.name,
        posture=entry.posture,
        exposure=entry.exposure,
        pixels=int(used.sum()),
        rms=_rms(off[used]),
        noise=float(np.sqrt(np.mean(variance))) if variance.size else 0.0,
        means_rms=_rms(means),
    )


def _rms(values: Float32) -> float:
    return float(np.sqrt(np.mean(values.astype(np.float64) ** 2))) if values.size else 0.0


def agreement_text(name: str, found: Sequence[Agreement]) -> str:
    pixels = sum(one.pixels for one in found)
    rms, noise, means = (_rms_of_all(found, key) for key in ("rms", "noise", "means_rms"))
    images, own = counted(len(found), "captured image"), f"the sensor's noise makes {noise:.2f}"
    return (
        f"{images} against images synthesised from {name}: {rms:.2f} levels rms, of which {own}; "
        f"{means:.2f} as means of {_MEAN_PX} × {_MEAN_PX} px; at {counted(pixels, 'unsaturated pixel')}"
    )
