"""Reading image sets, rendered or captured alike."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.core.arrays import Bool, Float32
from lightopt.core.errors import InputError, did_you_mean, refuse
from lightopt.core.provenance import file_sha256, files_sha256
from lightopt.images._image_files import Levels, read_exr, read_png
from lightopt.images._manifest import MANIFEST_NAME, GeometryEntry, ImageEntry, Manifest, read_manifest


@dataclass(frozen=True)
class LoadedImage:
    """A loaded image; arrays of shape (H, W), read-only."""

    # [grey level at exposure 1] linear, black level removed; from a PNG (sensor − black level) · full scale /
    # ((2^b − 1) · exposure), so clipped where saturated
    levels: Float32
    saturated: Bool  # where `levels` is a lower bound, or the camera would be saturated at the entry's exposure
    sensor: Levels | None  # levels as delivered; None for an image without PNG


@dataclass(frozen=True)
class ImageSet:
    """An image set on disk: its folder and what its manifest says."""

    folder: Path
    manifest: Manifest

    @property
    def images(self) -> tuple[ImageEntry, ...]:
        return self.manifest.images

    @property
    def geometry(self) -> tuple[GeometryEntry, ...]:
        return self.manifest.geometry

    def path(self, name: str) -> Path:
        return self.folder / name

    @cached_property
    def fingerprint(self) -> dict[str, Any]:
        """Hashes of the manifest, and of the images as they are on disk: what a result of this set depends on.

        The manifest's own hashes of images are not used: a file may have been edited since. Raises OSError.
        """
        read = [name for i in self.images if (name := i.png or i.exr) is not None]
        read += [name for name in self.manifest.files if name.endswith(".png")]  # frames without light
        manifest = file_sha256(self.path(MANIFEST_NAME))
        return {"manifest_sha256": manifest, "images_sha256": files_sha256(self.folder, read)}

    def load(self, entry: ImageEntry) -> LoadedImage:
        """Read an image, by its PNG where there is one; InputError: missing, damaged, or beyond the bit depth."""
        image = self._load_exr(entry) if entry.png is None else self._load_png(entry, entry.png)
        for array in (image.levels, image.saturated, image.sensor):
            if array is not None:
                array.flags.writeable = False
        return image

    def load_geometry(self, entry: GeometryEntry) -> dict[str, Float32]:
        """Read a geometry image: channels by name, each (H, W), world frame [mm]."""
        return read_exr(self.path(entry.exr))

    def _load_png(self, entry: ImageEntry, name: str) -> LoadedImage:
        manifest = self.manifest
        sensor = read_png(self.path(name))
        highest = int(sensor.max())
        if highest > manifest.max_level or np.iinfo(sensor.dtype).max < manifest.max_level:
            expected = f"expected right-aligned levels of {manifest.bit_depth} bits (up to {manifest.max_level})"
            advice = "correct bit_depth in the manifest or deliver the levels unscaled"
            raise InputError(f"{self.path(name)}: {expected}, found {sensor.dtype} up to {highest}; {advice}")
        scale = manifest.full_scale / (manifest.max_level * entry.held_exposure)
        levels = ((sensor.astype(np.float64) - manifest.black_level) * scale).astype(np.float32)
        saturated = sensor >= manifest.saturated_from
        return LoadedImage(levels=levels, saturated=saturated, sensor=sensor)

    def _load_exr(self, entry: ImageEntry) -> LoadedImage:
        manifest = self.manifest
        path = self.path(entry.exr or "")
        channels = read_exr(path)
        if "Y" not in channels:
            raise InputError(f"{path}: expected a channel Y, found {', '.join(channels)}")
        levels = channels["Y"]
        if "valid" in channels:
            saturated = channels["valid"] == 0
        else:
            scale = entry.held_exposure * manifest.max_level / manifest.full_scale
            sensor = np.floor(levels.astype(np.float64) * scale + manifest.black_level + 0.5)
            saturated = np.minimum(sensor, manifest.max_level) >= manifest.saturated_from
        return LoadedImage(levels=levels, saturated=saturated, sensor=None)


def read_image_set(path: str | Path, *, verify: bool = True) -> ImageSet:
    """Open an image set: its folder or its ``manifest.json``.

    With `verify` all files must be there, with the hashes listed where there are any.

    Raises InputError: the manifest is missing or wrong, or files are missing or changed; with one message per problem.
    """
    path = Path(path)
    if not path.exists():
        beside = [one.name for one in path.parent.iterdir()] if path.parent.is_dir() else []
        raise InputError(f"{path}: no such folder; expected an image set{did_you_mean(path.name, beside)}")
    manifest_path = path / MANIFEST_NAME if path.is_dir() else path
    if path.is_dir() and not manifest_path.exists():
        patterns = (f"*/{MANIFEST_NAME}", f"*/*/{MANIFEST_NAME}")
        if below := sorted(found.parent for pattern in patterns for found in path.glob(pattern)):
            raise InputError(f"{path}: no image set, but these folders in it are: {', '.join(map(str, below[:5]))}")
        how = "docs/reference/conventions.md, Image sets, says how to write one for pictures that another program took"
        raise InputError(f"{path}: no {MANIFEST_NAME}, which says what each picture shows; {how}")
    image_set = ImageSet(folder=manifest_path.parent, manifest=read_manifest(manifest_path))
    listed = image_set.manifest.listed_files if verify else ()
    refuse([text for name, digest in listed if (text := _file_problem(image_set.path(name), digest))])
    return image_set


def _file_problem(path: Path, digest: str | None) -> str | None:
    if not path.is_file():
        return f"{path}: missing; the manifest lists it"
    if digest is None:
        return None
    try:
        found = file_sha256(path)
    except OSError as error:
        return f"{path}: cannot be read: {error.strerror or error}"
    if found != digest.lower():
        return f"{path}: changed since it was listed: expected SHA-256 {digest[:12]}…, found {found[:12]}…"
    return None
