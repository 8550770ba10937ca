"""Overlap of the saturated regions of several images (paper, figure 11): table by pairs of lights, and maps."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.core.arrays import Bool, Float32, Float64, UInt8
from lightopt.core.errors import InputError
from lightopt.core.provenance import provenance
from lightopt.core.transforms import Posture
from lightopt.images._image_files import write_png
from lightopt.images._manifest import ImageEntry, posture_folder
from lightopt.images._result_folder import ResultFolder
from lightopt.images._set_reader import ImageSet

ONE_COLOUR = (70, 110, 190)
SEVERAL_COLOUR = (230, 60, 40)
GREY_SHARE = 0.45  # the images' mean is shown this dim under the colours


@dataclass(frozen=True)
class Overlap:
    """Saturated regions of the images of one posture at one exposure."""

    posture: Posture
    exposure: float
    saturated: Mapping[str, int]  # number of pixels saturated under each light
    pairs: Mapping[tuple[str, str], int]  # number of pixels saturated under both lights of a pair
    count: UInt8  # number of images in which each pixel is saturated, shape (H, W)
    mean: Float32  # mean of the levels, as a share of full scale clipped to 1, shape (H, W)

    @property
    def pixels(self) -> int:
        """Pixels that are saturated in two images or more."""
        return int((self.count >= 2).sum())

    def as_dict(self) -> dict[str, Any]:
        pairs = [{"lights": list(pair), "px": pixels} for pair, pixels in self.pairs.items()]
        figures = {"saturated_px": dict(self.saturated), "overlap_px": pairs}
        image = {"posture": self.posture.as_dict(), "exposure": self.exposure}
        return {**image, **figures, "saturated_in_two_or_more_px": self.pixels}


def find_overlaps(images: ImageSet) -> tuple[Overlap, ...]:
    """Overlaps of each posture and exposure of a set; InputError for fewer than two lights, or different sizes."""
    groups: dict[tuple[Posture, float], list[ImageEntry]] = {}
    for entry in images.manifest.images:
        groups.setdefault((entry.posture, entry.exposure), []).append(entry)
    if not groups:
        raise InputError(f"{images.folder}: the set has no images; expected two lights or more per posture")
    return tuple(_overlap(images, *key, entries) for key, entries in groups.items())


def _overlap(images: ImageSet, posture: Posture, exposure: float, entries: list[ImageEntry]) -> Overlap:
    where = f"{images.folder}: posture {posture}, exposure {exposure:g}"
    if len(entries) < 2:
        raise InputError(f"{where}: expected images under two lights or more, found one ({entries[0].light})")
    masks: dict[str, Bool] = {}
    total: Float64 | None = None
    full = images.manifest.full_scale / exposure
    for entry in entries:
        image = images.load(entry)
        masks[entry.light] = image.saturated
        share = np.clip(image.levels / full, 0.0, 1.0).astype(np.float64)
        if total is not None and total.shape != share.shape:
            size, before = (f"{shape[1]} × {shape[0]}" for shape in (share.shape, total.shape))
            sizes = f"{entry.light} is {size} px, the images before it are {before}"
            raise InputError(f"{where}: {sizes}; expected images of one camera")
        total = share if total is None else total + share
    assert total is not None
    saturated = {light: int(mask.sum()) for light, mask in masks.items()}
    pairs = {(a, b): int((masks[a] & masks[b]).sum()) for a, b in itertools.combinations(masks, 2)}
    count = np.stack(list(masks.values())).sum(axis=0).astype(np.uint8)
    return Overlap(posture, exposure, saturated, pairs, count, (total / len(entries)).astype(np.float32))


def overlap_map_name(posture: Posture, exposure: float = 1.0) -> str:
    """File of the map of a posture and exposure, relative to the folder that it is written to."""
    suffix = "" if exposure == 1 else f"_x{exposure:.6g}"
    return f"{posture_folder(posture)}/overlap{suffix}.png"


def write_overlap_map(overlap: Overlap, path: Path, *, overwrite: bool) -> str:
    """Draw where no image is saturated (grey), one is (blue), and several are (red); returns the SHA-256."""
    grey = np.round(255.0 * GREY_SHARE * overlap.mean).astype(np.uint8)
    picture = np.repeat(grey[..., None], 3, axis=2)
    picture[overlap.count == 1] = ONE_COLOUR
    picture[overlap.count >= 2] = SEVERAL_COLOUR
    return write_png(path, picture, metadata=overlap.as_dict(), overwrite=overwrite)


def write_overlaps(overlaps: Sequence[Overlap], images: ImageSet, folder: Path, *, force: bool) -> list[Path]:
    """Write the maps and at last ``overlap.json``; returns their paths. InputError as of a ResultFolder."""
    maps = {overlap_map_name(one.posture, one.exposure): one for one in overlaps}
    made_from = provenance({"image_sets": [images.fingerprint]}, {})
    kind = {"name": "overlap.json", "format": "lightopt-overlap/1", "what": "overlaps"}
    result = ResultFolder(folder, made_from, **kind, also=tuple(maps), force=force)
    for name, one in maps.items():
        write_overlap_map(one, result.place(name), overwrite=True)
    figures = result.finish({"overlaps": [one.as_dict() for one in overlaps]})
    return [*(folder / name for name in maps), figures]
