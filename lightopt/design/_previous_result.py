"""The result of a previous run in the output folder: of the same run, of another one, or of one that was interrupted.

While a run writes its files, ``unfinished.json`` lists those that it will write, and those of a previous run that it
removes; it goes when ``result.json`` is there. So a folder never has a ``result.json`` beside files that contradict
it, and what an interrupted run left is known to the next one.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from lightopt.core.errors import InputError
from lightopt.core.provenance import differences
from lightopt.design.blind_spots._files import BLIND_NAMES
from lightopt.images import remove_image_set, write_text_atomic

RESULT_NAME = "result.json"
RIG_NAME = "rig.optimized.yaml"
REPORT_NAME = "report.html"
PLANNED_PART_NAME = "part.planned.yaml"
UNFINISHED_NAME = "unfinished.json"

# files that a result may list beside rigs, images and maps; with option `force` no others are removed
_FURTHER_NAMES = (REPORT_NAME, PLANNED_PART_NAME, *BLIND_NAMES)

_FORMATS = {RESULT_NAME: "lightopt-optimum/", UNFINISHED_NAME: "lightopt-unfinished/"}


def refuse_other_result(folder: Path, provenance: Mapping[str, Any]) -> None:
    """Raise an :class:`InputError` where a folder holds a result of other inputs, or one that cannot be read.

    `provenance` is that of the run to come, or the part of it that is known already.
    """
    path = folder / RESULT_NAME
    if not path.exists():
        return
    found = _read(path)
    advice = "use option 'force' to replace it, or choose another output folder"
    if found is None:
        raise InputError(f"{path}: exists and is not a result of lightopt optimize; {advice}")
    other = found.get("provenance")
    if changes := differences(other if isinstance(other, dict) else {}, provenance, partly=True):
        raise InputError(f"{path}: the result of another run ({changes}); {advice}")


def begin_writing(folder: Path, listed: Mapping[str, Any], *, force: bool) -> bool:
    """List the files to come and, with `force`, remove result.json and then all that previous runs list.

    Removed are rigs, overlap maps, reports and further files by their names, and image sets by their manifests, inside
    the folder only; captured images, kept matrices and what no list names stay. `listed` is as in result.json.

    Returns whether a report that is there is of a previous run.
    """
    previous = [found for name in _FORMATS if (found := _read(folder / name)) is not None]
    lists = {key: [one for doc in (listed, *previous) for one in _entries(doc, key)] for key in listed}
    document = {"format": "lightopt-unfinished/1", **lists}
    write_text_atomic(folder / UNFINISHED_NAME, json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    ours = any({"file": REPORT_NAME} in _entries(document, "files") for document in previous)
    if not force:
        return ours
    _unlink(folder / RESULT_NAME)
    for document in previous:
        maps = [path for path in _paths(folder, document, "overlaps", "map") if path.match("overlap*.png")]
        files = [path for path in _paths(folder, document, "files", "file") if path.name in _FURTHER_NAMES]
        rigs = [path for path in _paths(folder, document, "rigs", "file") if path.name == RIG_NAME]
        for path in (*maps, *files, *rigs):
            _unlink(path)
            _remove_if_empty(path.parent, folder)
        for path in _paths(folder, document, "images", "folder"):
            remove_image_set(path)
            _remove_if_empty(path, folder)
            _remove_if_empty(path.parent, folder)
    return ours


def end_writing(folder: Path) -> None:
    """Remove the list of files to come: all files are complete, result.json too."""
    _unlink(folder / UNFINISHED_NAME)


def _paths(folder: Path, document: Mapping[str, Any], key: str, name: str) -> Iterator[Path]:
    # what a list names, as far as it is inside the folder; a list can be damaged in any way
    for entry in _entries(document, key):
        given = entry.get(name)
        if not isinstance(given, str):
            continue
        with suppress(OSError, ValueError, RuntimeError):  # NUL, loops of links
            path = (folder / given).resolve()
            if path.is_relative_to(folder.resolve()) and path != folder.resolve():
                yield path


def _entries(document: Mapping[str, Any], key: str) -> list[dict[str, Any]]:
    found = document.get(key)
    return [entry for entry in found if isinstance(entry, dict)] if isinstance(found, list) else []


def _unlink(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be removed: {error.strerror or error}; remove it, or choose another output folder"
        ) from error


def _remove_if_empty(path: Path, folder: Path) -> None:
    if path != folder.resolve():
        with suppress(OSError):  # something else is in it, or it is gone
            path.rmdir()


def _read(path: Path) -> dict[str, Any] | None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    right = isinstance(found, dict) and str(found.get("format", "")).startswith(_FORMATS[path.name])
    return found if right else None
