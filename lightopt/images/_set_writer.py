"""Writing an image set file by file, so that a killed run leaves a valid set; resuming and removing such sets."""

import contextlib
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Float32
from lightopt.core.errors import InputError
from lightopt.core.provenance import differences, file_sha256
from lightopt.core.transforms import Posture
from lightopt.images import _manifest as names
from lightopt.images._atomic import make_folder, remove_file, write_bytes_atomic, write_npz_atomic, write_text_atomic
from lightopt.images._image_files import Levels, write_exr, write_png
from lightopt.images._manifest import GeometryEntry, ImageEntry, Manifest, read_manifest
from lightopt.images._result_folder import remove_listed

_PATCHES_NAME = "patches.npz"


class ImageSetWriter:
    """Writes an image set file by file.

    The manifest is on disk from the start and is rewritten after each file that it names, so whenever the run
    stops the folder holds a valid set of what was finished. Opened again with the same header, it resumes:
    `done` says what need not be made again. Threads may add files of their own at the same time. Every method that
    writes raises InputError when a file of others is in the way or the disk refuses.

    header: The manifest without its entries. Two runs with equal headers (rig and part by their SHA-256) are the
        same run.
    force: Replace the set of another run, all of whose files are removed first, and files that belong to none.
    plan: Light, posture and exposure of the images that the run will make, so that names which clash and files in
        the way are found before any work.

    manifest: What is on disk so far.
    replaced: Number of files of the set of another run that were removed.
    Raises InputError: The folder cannot be written, holds the set of another run or files in the way (without `force`),
        or two images of the plan would share a file; with `force`, the folder holds captured images and the run makes
        others.
    """

    def __init__(
        self, folder: str | Path, header: Manifest, *, force: bool = False, plan: Iterable[names.ImageKey] = ()
    ) -> None:
        self.folder = Path(folder)
        self._lock = threading.Lock()
        self._names = names.FileNames()
        self._verified: dict[str, str] = {}
        plan = tuple(plan)
        self._names.claim_images(plan)
        existing = None if force else resumable_manifest(self.folder, header)
        self.replaced = remove_set(self.folder, header) if force else 0
        self._may_overwrite = force or existing is not None
        for light, posture, exposure in plan:
            self._writable(names.png_name(light, posture, exposure))
            self._writable(names.exr_name(light, posture))
            self._writable(names.geometry_name(posture))
        self.manifest = existing or replace(header, images=(), geometry=(), patches=None, files={})
        self._names.claim_images(entry.key for entry in self.manifest.images)
        make_folder(self.folder)
        self._save()

    def done(self, light: str, posture: Posture, exposure: float) -> bool:
        """Whether an image is listed and its files are there with the hashes listed."""
        found = (e for e in self.manifest.images if e.key == (light, posture, exposure))
        return any(all(self._intact(name, digest) for name, digest in entry.files) for entry in found)

    def linear_done(self, light: str, posture: Posture) -> bool:
        """Whether the linear image of a light and posture is listed and intact."""
        entry = self._linear(light, posture)
        return entry is not None and self._intact(entry.exr or "", entry.sha256.get("exr"))

    def geometry_done(self, posture: Posture) -> bool:
        """Whether the geometry of a posture is listed and intact."""
        entries = [e for e in self.manifest.geometry if e.posture == posture]
        return any(self._intact(e.exr, e.sha256.get("exr")) for e in entries)

    def file_done(self, name: str = _PATCHES_NAME) -> bool:
        """Whether a further file (the patch table unless named) is listed and intact."""
        return self._intact(name, self.manifest.files.get(name))

    def add_image(
        self, entry: ImageEntry, *, png: Levels | None = None, exr: Mapping[str, Float32] | None = None
    ) -> ImageEntry:
        """Write an image's files, then list it; returns the entry as listed, which replaces one of the same key.

        The linear image belongs to light and posture: all exposures of them list the same EXR.

        entry: What was imaged; its `png`, `exr` and `sha256` are filled in here.
        png: Camera levels (H, W), as :func:`write_png` takes them.
        exr: Channels (H, W) of the linear image at exposure 1 [grey level], as :func:`write_exr` takes them.
        """
        self._names.claim_images([entry.key])
        shared = self._linear(entry.light, entry.posture)
        if png is None and exr is None and shared is None:
            raise InputError(f"light {entry.light!r}: an image needs camera levels or linear channels")
        files: dict[str, str | None] = {}
        hashes: dict[str, str] = {}
        if png is not None:
            wanted, top = np.dtype(np.uint8 if self.manifest.bit_depth <= 8 else np.uint16), self.manifest.max_level
            if png.dtype != wanted or int(png.max()) > top:
                expected = f"expected {wanted} levels up to {top} ({self.manifest.bit_depth} bits)"
                raise InputError(f"light {entry.light!r}: {expected}, found {png.dtype} up to {png.max()}")
            name = files["png"] = names.png_name(*entry.key)
            facts = self._metadata(entry, linear=False)
            hashes["png"] = self._write(name, lambda path: write_png(path, png, metadata=facts))
        if exr is not None:
            files["exr"], hashes["exr"] = self._write_linear(entry, exr)
        elif shared is not None:
            files["exr"] = shared.exr
            hashes |= {kind: digest for kind, digest in shared.sha256.items() if kind == "exr"}
        listed = replace(entry, png=files.get("png"), exr=files.get("exr"), sha256=dict(sorted(hashes.items())))
        with self._lock:
            images = self.manifest.images if exr is None else self._images_sharing(entry, hashes["exr"])
            self._save(images=tuple({**{e.key: e for e in images}, listed.key: listed}.values()))
        return listed

    def add_linear(self, light: str, posture: Posture, channels: Mapping[str, Float32]) -> None:
        """Write the linear image (H, W) [grey level at exposure 1] of a light and posture, and list it."""
        first = next((e for e in self.manifest.images if e.key[:2] == (light, posture)), None)
        if first is None:
            raise InputError(f"light {light!r} at {posture}: a linear image needs an image that is listed")
        _, digest = self._write_linear(first, channels)
        with self._lock:
            self._save(images=self._images_sharing(first, digest))

    def _linear(self, light: str, posture: Posture) -> ImageEntry | None:
        # an image of the light and posture that lists their linear image
        return next((e for e in self.manifest.images if e.key[:2] == (light, posture) and e.exr), None)

    def _write_linear(self, entry: ImageEntry, channels: Mapping[str, Float32]) -> tuple[str, str]:
        name, facts = names.exr_name(entry.light, entry.posture), self._metadata(entry, linear=True)
        return name, self._write(name, lambda path: write_exr(path, channels, metadata=facts))

    def _images_sharing(self, entry: ImageEntry, digest: str) -> tuple[ImageEntry, ...]:
        # the listed images; those of the entry's light and posture with the linear image that was written for it
        exr = names.exr_name(entry.light, entry.posture)
        images = list(self.manifest.images)
        for i, e in enumerate(images):
            if e.key[:2] == entry.key[:2]:
                images[i] = replace(e, exr=exr, sha256=dict(sorted({**e.sha256, "exr": digest}.items())))
        return tuple(images)

    def add_levels(self, name: str, levels: Levels, *, metadata: Mapping[str, Any]) -> None:
        """Write camera levels (H, W) that are no image of a light (a dark frame) as a further file, then list it."""
        facts = {**self._origin(), "bit_depth": self.manifest.bit_depth, **metadata}
        self._add_further(name, lambda path: write_png(path, levels, metadata=facts))

    def add_geometry(
        self, posture: Posture, channels: Mapping[str, Float32], *, metadata: Mapping[str, Any] | None = None
    ) -> None:
        """Write a posture's geometry image, then list it.

        Channels, float32 (H, W): ``P.X P.Y P.Z`` [mm] and ``N.X N.Y N.Z`` in the world frame, ``Z`` [mm along the ray],
        ``patch`` and, for parts with defects, ``defect``.
        """
        name = names.geometry_name(posture)
        self._names.claim(name, f"the geometry of {name.partition('/')[0]}")
        facts = {**self._origin(), "posture": posture.as_dict(), **(metadata or {})}
        digest = self._write(name, lambda path: write_exr(path, channels, metadata=facts))
        listed = GeometryEntry(posture=posture, exr=name, sha256={"exr": digest})
        with self._lock:
            entries = {e.posture: e for e in self.manifest.geometry}
            self._save(geometry=tuple({**entries, posture: listed}.values()))

    def add_patches(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write the patch table as ``patches.npz``, then list it."""
        self._add_further(_PATCHES_NAME, lambda path: write_npz_atomic(path, arrays), patches=_PATCHES_NAME)

    def add_file(self, name: str, data: bytes | str) -> None:
        """Write a further file of the set (a report, a contact sheet; text as UTF-8), then list it."""
        content = data.encode("utf-8") if isinstance(data, str) else data
        self._add_further(name, lambda path: write_bytes_atomic(path, content))

    def drop(
        self,
        *,
        images: Iterable[tuple[str, Posture]] = (),
        files: Iterable[str] = (),
        extra: Mapping[str, Any] | None = None,
    ) -> None:
        """Take images and further files off the list, then from the disk, so that no listed file is ever written anew.

        Of `images` (light and posture) all exposures go, and their linear image. `extra` are keys of the manifest that
        change together with the list, as for :meth:`add_extra`.
        """
        of_them, others = set(images), set(files)
        with self._lock:
            entries = self.manifest.images
            gone = [e for e in entries if e.key[:2] in of_them]
            listed = [name for e in gone for name, _ in e.files]
            listed += [name for name in others if name in self.manifest.files]
            changed = {**self.manifest.extra, **(extra or {})}
            if listed or changed != self.manifest.extra:
                kept = tuple(e for e in entries if e.key[:2] not in of_them)
                hashes = {name: digest for name, digest in self.manifest.files.items() if name not in others}
                self._save(images=kept, files=hashes, extra=changed)
        for name in listed:
            self._verified.pop(name, None)
            remove_file(self.folder / name)

    def add_warnings(self, warnings: Iterable[str]) -> None:
        with self._lock:
            merged = tuple(dict.fromkeys((*self.manifest.warnings, *warnings)))
            if merged != self.manifest.warnings:
                self._save(warnings=merged)

    def add_extra(self, key: str, value: Any) -> None:
        """Put a JSON-able value under a key of the manifest: a finding of the run, not an option."""
        with self._lock:
            self._save(extra={**self.manifest.extra, key: value})

    def _add_further(self, name: str, write: Callable[[Path], str], **changes: Any) -> None:
        # write a file that is no image and list it, with other changes of the manifest
        if problem := names.inside_problem(name):
            raise InputError(f"{name!r}: {problem}")
        self._names.claim(name, f"the file {name}")
        digest = self._write(name, write)
        with self._lock:
            self._save(files={**self.manifest.files, name: digest}, **changes)

    def _write(self, name: str, write: Callable[[Path], str]) -> str:
        # write a file, its folder made; its SHA-256
        path = self._writable(name)
        make_folder(path.parent)
        digest = self._verified[name] = write(path)
        return digest

    def _writable(self, name: str) -> Path:
        # path of a file, refused where one that this run has not written may not be overwritten
        path = self.folder / name
        if not self._may_overwrite and name not in self._verified and path.exists():
            advice = "use option 'force' to overwrite it, or choose another output folder"
            raise InputError(f"{path}: exists but belongs to no image set; {advice}")
        return path

    def _intact(self, name: str, digest: str | None) -> bool:
        if digest is not None and name not in self._verified:
            with contextlib.suppress(OSError):
                self._verified[name] = file_sha256(self.folder / name)
        return digest is not None and self._verified.get(name) == digest

    def _origin(self) -> dict[str, Any]:
        return {"lightopt": self.manifest.lightopt, "kind": self.manifest.kind}

    def _metadata(self, entry: ImageEntry, *, linear: bool) -> dict[str, Any]:
        """What a file says of itself when it is found alone."""
        facts = {**self._origin(), **replace(entry, png=None, exr=None, sha256={}).as_dict()}
        facts["full_scale"] = self.manifest.full_scale
        if linear:  # the same whatever the exposure
            return {key: value for key, value in facts.items() if key != "exposure" and key not in entry.extra}
        saturation, black = self.manifest.saturated_from, self.manifest.black_level
        sensor = {"bit_depth": self.manifest.bit_depth, "saturation_level": saturation, "black_level": black}
        return {**facts, **sensor}

    def _save(self, **changes: Any) -> None:
        manifest = replace(self.manifest, **changes)
        write_text_atomic(self.folder / names.MANIFEST_NAME, manifest.to_json())
        self.manifest = manifest


def resumable_manifest(folder: Path, header: Manifest) -> Manifest | None:
    """Manifest to continue, the header's warnings added; None for no set. InputError for another run's, or damaged."""
    path = folder / names.MANIFEST_NAME
    if not path.exists():
        return None
    advice = "use option 'force' to replace it, or choose another output folder"
    try:
        existing = read_manifest(path)
    except InputError as error:
        raise InputError(*error.messages, f"{folder}: holds a damaged image set; {advice}") from error
    if changed := differences(existing.run_facts, header.run_facts):
        raise InputError(f"{folder}: holds the image set of another run ({changed}); {advice}")
    return replace(existing, warnings=tuple(dict.fromkeys((*existing.warnings, *header.warnings))))


def remove_set(folder: Path, header: Manifest) -> int:
    """Remove the files that a folder's manifest lists, and the subfolders that this leaves empty; returns their number.

    Files that the manifest does not list stay, as does everything where there is no manifest or a damaged one.

    Raises InputError: the folder holds captured images and the header is of others, or a file cannot be removed.
    """
    manifest = _readable_manifest(folder)
    if manifest is None:
        return 0
    if manifest.kind == "captured" and header.kind != "captured":
        why = f"holds captured images, which {header.kind} ones never replace"
        raise InputError(f"{folder}: {why}; choose another output folder")
    return remove_listed(folder, [name for name, _ in manifest.listed_files])


def remove_image_set(folder: Path) -> int:
    """Remove a simulated image set (listed files, manifest) and no captured one; returns the number of files."""
    manifest = _readable_manifest(folder)
    if manifest is None or manifest.kind != "simulated":
        return 0
    return remove_listed(folder, [*(name for name, _ in manifest.listed_files), names.MANIFEST_NAME])


def _readable_manifest(folder: Path) -> Manifest | None:
    try:
        return read_manifest(folder / names.MANIFEST_NAME)
    except InputError:
        return None
