"""Images of several lights from images of single ones, which add up; and how well they agree with captured images."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Float64, UInt8
from lightopt.core.errors import InputError, counted
from lightopt.core.transforms import Posture
from lightopt.design.from_images._evidence import Evidence
from lightopt.design.from_images._samples import Samples, sensor_levels
from lightopt.images import ImageEntry, ImageSet

USED_RANGE = 0.95  # of the range up to saturation that 99.9 % of the part's pixels of an image may reach
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
    means_rms: float  # of means over squares of 5 × 5 px, where all of them are compared [sensor level]


def chosen_images(
    samples: Samples, evidence: Evidence, weights: Float64, levels: Mapping[str, int]
) -> tuple[ChosenImage, ...]:
    """The images of weights (N, K) on the samples' images, each as long as saturation allows.

    levels: Controller level of a light at full brightness, where it is known: its weights are whole levels
    Raises InputError: The lights of an image leave the part black.
    """
    exposures = np.array([channel.exposure for channel in samples.channels])
    room = USED_RANGE * (samples.manifest.saturated_from - samples.manifest.black_level)
    images: list[ChosenImage] = []
    for number, row in enumerate(weights, start=1):
        brightness = row * exposures  # a light that was exposed longer is darker than its image
        brightest = float(row @ evidence.brightest)
        longest = float(brightness.max())
        if not brightest * MOST_LONGER > room:
            lights = ", ".join(c.light for c, share in zip(samples.channels, row, strict=True) if share)
            raise InputError(
                f"{samples.sets[0].folder}: 99.9 % of the part's pixels are black under {lights}, or nearly so: more "
                f"than {MOST_LONGER:g} times the exposure is needed. Ask for fewer images, or leave the light out"
            )
        exposure = room / brightest * longest
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
            saturated = saturated | (levels >= manifest.saturated_from - manifest.black_level - 0.5)
    return np.asarray(total, np.float32) + np.float32(manifest.black_level), np.asarray(saturated, np.bool_)


def quantised(samples: Samples, levels: Float32) -> UInt8 | NDArray[np.uint16]:
    """Levels as the camera delivers them: rounded half up and clipped."""
    whole = np.clip(np.floor(levels + 0.5), 0, samples.manifest.max_level)
    return whole.astype(np.uint8) if samples.manifest.bit_depth <= 8 else whole.astype(np.uint16)


def compare_captured(
    samples: Samples, images: Sequence[ChosenImage], captured: ImageSet
) -> tuple[str, tuple[Agreement, ...]]:
    """Compare a captured set with the images of the set that shows the same sample: that which agrees best.

    captured: Its lights are the names of `images`.
    Returns: Name of the samples' set, and each image of it.
    Raises InputError: The captured set has none of the images, or they are of another size or saturated all over.
    """
    known = {image.name: image for image in images}
    entries = [e for e in captured.images if e.light in known and e.posture in samples.postures]
    if not entries:
        raise InputError(
            f"{captured.folder}: none of the chosen images: expected {', '.join(known)} in a posture of the samples, "
            f"found {', '.join(sorted({entry.light for entry in captured.images}))}"
        )
    found = [
        [_agreement(samples, number, known[entry.light], captured, entry) for entry in entries]
        for number in range(len(samples.sets))
    ]
    best = min(range(len(found)), key=lambda i: _rms_of_all(found[i], "rms"))
    if not any(one.pixels for one in found[best]):
        raise InputError(f"{captured.folder}: each pixel of the part is saturated; expected shorter exposures")
    return samples.names[best], tuple(found[best])


def _rms_of_all(found: Sequence[Agreement], key: Literal["rms", "means_rms"]) -> float:
    pixels = sum(one.pixels for one in found)
    return math.sqrt(sum(getattr(one, key) ** 2 * one.pixels for one in found) / pixels) if pixels else math.inf


def _agreement(samples: Samples, number: int, image: ChosenImage, captured: ImageSet, entry: ImageEntry) -> Agreement:
    levels, saturated = synthesise(samples, number, image, entry.posture, exposure=entry.exposure)
    taken = captured.load(entry)
    if taken.levels.shape != levels.shape:
        sizes = (f"{shape[1]} × {shape[0]} px" for shape in (taken.levels.shape, levels.shape))
        raise InputError(f"{captured.folder}: images of {next(sizes)}, but the samples' are of {next(sizes)}")
    own = sensor_levels(captured, entry) + np.float32(captured.manifest.black_level)
    used = samples.regions[samples.postures.index(entry.posture)] & ~saturated & ~taken.saturated
    used &= levels < samples.manifest.saturated_from
    off = np.where(used, own - np.asarray(quantised(samples, levels), np.float32), 0.0)
    whole = ndimage.uniform_filter(used.astype(np.float32), _MEAN_PX) > 0.999
    means = np.asarray(ndimage.uniform_filter(off, _MEAN_PX), np.float32)[whole]
    return Agreement(
        image=image.name,
        posture=entry.posture,
        exposure=entry.exposure,
        pixels=int(used.sum()),
        rms=_rms(off[used]),
        means_rms=_rms(means),
    )


def _rms(values: Float32) -> float:
    return float(np.sqrt(np.mean(values.astype(np.float64) ** 2))) if values.size else 0.0


def agreement_text(name: str, found: Sequence[Agreement]) -> str:
    """The agreement in a sentence."""
    pixels = sum(one.pixels for one in found)
    return (
        f"{counted(len(found), 'captured image')} against images synthesised from {name}: "
        f"{_rms_of_all(found, 'rms'):.2f} levels rms, {_rms_of_all(found, 'means_rms'):.2f} as means of {_MEAN_PX} × "
        f"{_MEAN_PX} px, at {counted(pixels, 'unsaturated pixel')}"
    )
