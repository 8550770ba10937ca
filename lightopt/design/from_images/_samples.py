"""Image sets of good and defective samples, each with one image per light, and the masks of their defects."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Int32
from lightopt.core.errors import InputError, counted, refuse
from lightopt.core.transforms import Posture
from lightopt.images import ImageEntry, ImageSet, Manifest, posture_folder, read_image_set, read_png

MOST_SATURATED = 0.001  # of several exposures of a light, the longest is used that saturates at most this share
LIT_SHARE = 0.02  # of full scale; without a geometry image, what no light makes brighter is background

_TOUCHING = np.ones((3, 3), np.bool_)


@dataclass(frozen=True)
class Channel:
    """A light whose images are used, and their exposure."""

    light: str
    exposure: float


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Image sets of one rig, which show samples at the same place of the image.

    labels: Per set and posture, shape (sets, postures, H, W): number of the defect that a pixel shows, from 0 in each
        set, −1 for none
    defects: Per set, the names of its defects
    """

    sets: tuple[ImageSet, ...]
    names: tuple[str, ...]
    channels: tuple[Channel, ...]
    postures: tuple[Posture, ...]
    labels: Int32
    defects: tuple[tuple[str, ...], ...]
    regions: tuple[Bool, ...]  # per posture the pixels of the part, shape (H, W)

    @property
    def manifest(self) -> Manifest:
        """Of the first set: sensor and full scale are those of all."""
        return self.sets[0].manifest

    @property
    def limit(self) -> float:
        """Highest level above black that the camera delivers [sensor level]."""
        return self.manifest.max_level - self.manifest.black_level

    def entry(self, number: int, channel: Channel, posture: Posture) -> ImageEntry:
        """The image of a set, a light and a posture."""
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


def read_samples(paths: Sequence[Path], region: Path | None = None) -> Samples:
    """Read image sets, and check that they are of the same lights, exposures, postures and sensor.

    region: PNG that is not 0 where the part is to be inspected, in all postures
    Raises InputError: One message per problem: of a set, of its masks, or what differs between sets.
    """
    sets = tuple(read_image_set(path) for path in paths)
    first = sets[0]
    refuse([f"{path}: given twice" for path, one in zip(paths, sets, strict=True) if _times(one, sets) > 1])
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
    found = [_labels(one, postures, shape, problems) for one in sets]
    shown = None if region is None else _mask(region, shape, problems) > 0
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
    regions = tuple(_region(samples, posture) if shown is None else shown for posture in postures)
    if not all(one.any() for one in regions):
        raise InputError(
            f"{first.folder}: no pixel is brighter than {LIT_SHARE:.0%} of full scale under any light; take longer "
            "exposures, or give a mask with option 'region'"
        )
    return replace(samples, regions=regions)


def _times(one: ImageSet, sets: Sequence[ImageSet]) -> int:
    return sum(other.folder.resolve() == one.folder.resolve() for other in sets)


def _names(sets: Sequence[ImageSet]) -> tuple[str, ...]:
    # of the folders, with a number where two are alike
    names = [one.folder.resolve().name for one in sets]
    return tuple(
        name if names.count(name) == 1 else f"{name}-{1 + names[:i].count(name)}" for i, name in enumerate(names)
    )


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


def _labels(
    one: ImageSet, postures: Sequence[Posture], shape: tuple[int, ...], problems: list[str]
) -> tuple[Int32, tuple[str, ...]]:
    # labels of a set's postures and the names of its defects: those of its masks, else those that it was rendered with
    labels = np.full((len(postures), *shape), -1, np.int32)
    paths = [one.path(f"masks/{posture_folder(posture)}.png") for posture in postures]
    if len(postures) == 1 and not paths[0].is_file():
        paths = [one.path("mask.png")]
    folder = one.path("masks")
    unknown = sorted(set(folder.glob("*.png")) - set(paths)) if folder.is_dir() else []
    problems += [
        f"{path}: the set has no such posture; expected a name such as masks/{posture_folder(postures[0])}.png"
        for path in unknown
    ]
    if any(path.is_file() for path in paths):
        names: list[str] = []
        for number, (path, posture) in enumerate(zip(paths, postures, strict=True)):
            if path.is_file():
                labelled: Any = ndimage.label(_mask(path, shape, problems) > 0, _TOUCHING)
                found, count = labelled
                labels[number] = np.where(found > 0, found - 1 + len(names), -1)
                where = f"{posture} " if len(postures) > 1 else ""
                names += [f"{where}{i + 1}" for i in range(count)]
        return labels, tuple(names)
    listed = one.manifest.extra.get("defects")
    if not isinstance(listed, list):
        return labels, ()
    for entry in one.geometry:
        channels = one.load_geometry(entry)
        if entry.posture in postures and "defect" in channels and channels["defect"].shape == shape:
            labels[postures.index(entry.posture)] = channels["defect"].astype(np.int32)
    return labels, tuple(str(defect.get("name", i + 1)) for i, defect in enumerate(listed))


def _mask(path: Path, shape: tuple[int, ...], problems: list[str]) -> Int32:
    # a PNG of the images' size; zeros, and a problem, where it is of another one
    mask = read_png(path)
    if mask.shape != shape:
        problems.append(
            f"{path}: a mask of {mask.shape[1]} × {mask.shape[0]} px for images of {shape[1]} × {shape[0]} px; "
            "expected one pixel per pixel of the image"
        )
        return np.zeros(shape, np.int32)
    return mask.astype(np.int32)


def _region(samples: Samples, posture: Posture) -> Bool:
    # pixels of the part: by the geometry of a rendered set, else those that some light makes brighter than background
    for one in samples.sets:
        for entry in one.geometry:
            if entry.posture == posture:
                return one.load_geometry(entry)["Z"] > 0.0
    brightest = samples.load(0, samples.channels[0], posture)
    for channel in samples.channels[1:]:
        brightest = np.maximum(brightest, samples.load(0, channel, posture))
    return brightest > LIT_SHARE * samples.limit
