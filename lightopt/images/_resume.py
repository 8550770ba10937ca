"""Whether a folder's image set is the same run, to be continued, or another one, to be replaced."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any

from lightopt.core.errors import InputError
from lightopt.core.provenance import differences
from lightopt.images._manifest import DARK_CHECKED_KEY, EVENTS_KEY, MANIFEST_NAME, REPEATABILITY_KEY, Manifest
from lightopt.images._parse import read_manifest

_CONTENT_KEYS = (
    "images",
    "geometry",
    "patches",
    "files",
    "warnings",
    REPEATABILITY_KEY,
    EVENTS_KEY,
    DARK_CHECKED_KEY,
)


def resumable_manifest(folder: Path, header: Manifest) -> Manifest | None:
    """Manifest to continue, the header's warnings added; None where the folder holds no set.

    Raises
    ------
    InputError
        The folder holds the set of another run, or a damaged one.
    """
    path = folder / MANIFEST_NAME
    if not path.exists():
        return None
    advice = "use --force to replace it, or choose another output folder"
    try:
        existing = read_manifest(path)
    except InputError as error:
        raise InputError(*error.messages, f"{folder}: holds a damaged image set; {advice}") from error
    if told := differences(_header(existing), _header(header)):
        raise InputError(f"{folder}: holds the image set of another run ({told}); {advice}")
    return replace(existing, warnings=tuple(dict.fromkeys((*existing.warnings, *header.warnings))))


def remove_set(folder: Path, header: Manifest) -> int:
    """Remove the files that a folder's manifest lists, and the subfolders that this leaves empty; returns their number.

    Files that the manifest does not list stay, as does everything where there is no manifest or a damaged one.

    Raises
    ------
    InputError
        The folder holds captured images and the header is of others, or a file cannot be removed.
    """
    try:
        manifest = read_manifest(folder / MANIFEST_NAME)
    except InputError:
        return 0
    if manifest.kind == "captured" and header.kind != "captured":
        raise InputError(
            f"{folder}: holds captured images, which are not replaced by {header.kind} ones, not even with --force; "
            "choose another output folder"
        )
    return _remove_files(folder, manifest)


def remove_image_set(folder: Path) -> int:
    """Remove a simulated image set, that is its listed files and the manifest; returns the number of files.

    A folder without a manifest, with a damaged one or with one of captured images stays as it is.

    Raises
    ------
    InputError
        A file cannot be removed.
    """
    try:
        manifest = read_manifest(folder / MANIFEST_NAME)
    except InputError:
        return 0
    if manifest.kind != "simulated":
        return 0
    removed = _remove_files(folder, manifest)
    return removed + remove_file(folder / MANIFEST_NAME)


def remove_file(path: Path) -> bool:
    """Remove a file; returns whether it was there. InputError when the operating system refuses."""
    try:
        path.unlink()
    except FileNotFoundError:
        return False
    except OSError as error:
        raise InputError(
            f"{path}: cannot be removed: {error.strerror or error}; choose another output folder"
        ) from error
    return True


def _remove_files(folder: Path, manifest: Manifest) -> int:
    removed = 0
    paths = [folder / name for name in _listed(manifest)]
    for path in paths:
        removed += remove_file(path)
    for parent in {path.parent for path in paths if path.parent != folder}:
        with contextlib.suppress(OSError):  # something else is in it
            parent.rmdir()
    return removed


def _listed(manifest: Manifest) -> list[str]:
    """All files that a manifest lists, each once."""
    names = [name for entry in manifest.images for name in (entry.png, entry.exr) if name is not None]
    names += [entry.exr for entry in manifest.geometry]
    names += [*manifest.files, *([manifest.patches] if manifest.patches is not None else [])]
    return list(dict.fromkeys(names))


def _header(manifest: Manifest) -> dict[str, Any]:
    """What tells the sets of two runs apart."""
    return {key: value for key, value in manifest.as_dict().items() if key not in _CONTENT_KEYS}
