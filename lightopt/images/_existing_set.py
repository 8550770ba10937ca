"""The image set that a folder already holds: of the same run, to be continued, or of another one, to be removed."""

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any

from lightopt.core.errors import InputError
from lightopt.core.provenance import differences
from lightopt.images._atomic import remove_file
from lightopt.images._file_names import MANIFEST_NAME
from lightopt.images._manifest import DARK_CHECKED_KEY, EVENTS_KEY, REPEATABILITY_KEY, Manifest, read_manifest

# keys of what a run makes and finds; the others say which run it is
_RESULT_KEYS = ("images", "geometry", "patches", "files", "warnings", REPEATABILITY_KEY, EVENTS_KEY, DARK_CHECKED_KEY)


def resumable_manifest(folder: Path, header: Manifest) -> Manifest | None:
    """Manifest to continue, the header's warnings added; None where the folder holds no set.

    Raises InputError: the folder holds the set of another run, or a damaged one.
    """
    path = folder / MANIFEST_NAME
    if not path.exists():
        return None
    advice = "use option 'force' to replace it, or choose another output folder"
    try:
        existing = read_manifest(path)
    except InputError as error:
        raise InputError(*error.messages, f"{folder}: holds a damaged image set; {advice}") from error
    if changed := differences(_header(existing), _header(header)):
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
        raise InputError(
            f"{folder}: holds captured images, which {header.kind} ones never replace; choose another output folder"
        )
    return _remove_files(folder, manifest)


def remove_image_set(folder: Path) -> int:
    """Remove a simulated image set, that is its listed files and the manifest; returns the number of files.

    A folder without a manifest, with a damaged one or with one of captured images stays as it is.

    Raises InputError: a file cannot be removed.
    """
    manifest = _readable_manifest(folder)
    if manifest is None or manifest.kind != "simulated":
        return 0
    return _remove_files(folder, manifest) + remove_file(folder / MANIFEST_NAME)


def _readable_manifest(folder: Path) -> Manifest | None:
    try:
        return read_manifest(folder / MANIFEST_NAME)
    except InputError:
        return None


def _remove_files(folder: Path, manifest: Manifest) -> int:
    paths = [folder / name for name in dict.fromkeys(name for name, _ in manifest.listed_files)]
    removed = sum(map(remove_file, paths))
    for parent in {path.parent for path in paths if path.parent != folder}:
        with contextlib.suppress(OSError):  # something else is in it
            parent.rmdir()
    return removed


def _header(manifest: Manifest) -> dict[str, Any]:
    return {key: value for key, value in manifest.as_dict().items() if key not in _RESULT_KEYS}
