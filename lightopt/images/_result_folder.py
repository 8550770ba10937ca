"""A folder of a result's files, with a JSON file that lists them and their provenance."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from lightopt.core.errors import InputError
from lightopt.core.provenance import differences
from lightopt.images._atomic import make_folder, remove_file, write_text_atomic
from lightopt.images._manifest import MANIFEST_NAME


def read_listing(path: Path, kind: str = "") -> dict[str, Any] | None:
    """The JSON object of a file, of a version of the format `kind` (``lightopt-fit``) if given; None for any other."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    fits = isinstance(found, dict) and (not kind or str(found.get("format", "")).startswith(f"{kind}/"))
    return found if fits else None


def paths_inside(folder: Path, names: Iterable[object], *, follow: bool = True) -> Iterator[Path]:
    """The paths in a folder that names lead to; others, and what is no name, are left out.

    follow: Whether a name that is a link is what it leads to, and not the link itself.
    """
    home = folder.resolve()
    for name in names:
        with suppress(OSError, ValueError, RuntimeError):  # NUL, loops of links
            path = folder / name if isinstance(name, str) else home
            path = path.resolve() if follow else path.parent.resolve() / path.name
            if home in path.parents:
                yield path


def remove_listed(folder: Path, names: Iterable[object]) -> int:
    """Remove files by their names in a folder, and folders in it that this leaves empty; returns their number."""
    removed, home = 0, folder.resolve()
    for path in paths_inside(folder, names, follow=False):
        if path.is_file() or path.is_symlink():
            removed += remove_file(path)
        with suppress(OSError):  # something else is in it, or it is gone
            for parent in path.parents[: -len(home.parts)]:
                parent.rmdir()
    return removed


class ResultFolder:
    """A folder for the files of a result; the previous result is removed before the first new file is written.

    made_from: From :func:`lightopt.core.provenance.provenance`: kept under ``provenance`` of the JSON file.
    name, format: The JSON file and its format, such as ``lightopt-fit/1``; the previous file may be of another
        version of it.
    what: The result in words, for messages: ``a fit``.
    also: Names of further files that belong to such a result even where the JSON file does not list them.
    force: Whether files of a result of other inputs are replaced.
    Raises InputError: The folder holds a result of other inputs, and `force` is False; or it is that of an image set.
    """

    def __init__(
        self,
        folder: Path,
        made_from: Mapping[str, Any],
        *,
        name: str,
        format: str,  # noqa: A002 - the key's name in the file
        what: str,
        also: Sequence[str] = (),
        force: bool,
    ) -> None:
        if (folder / MANIFEST_NAME).exists():
            raise InputError(f"{folder} is the folder of an image set; choose another one for {what}")
        self.folder = folder
        self.made_from: Mapping[str, Any] = json.loads(json.dumps(made_from))
        self._name, self._format, self._also = name, format, tuple(also)
        self._files: list[str] = []
        old = self._read_previous()
        there = [one for one in (name, *also) if (folder / one).exists()]
        before = (old or {}).get("provenance")
        changed = differences(before if isinstance(before, Mapping) else {}, self.made_from)
        if there and not force and (old is None or changed):
            raise InputError(
                f"{folder} already has {', '.join(there)} of {what} of other inputs or with other options"
                f"{f' ({changed})' if changed else ''}; use option 'force' to replace it, or choose another folder"
            )

    def place(self, name: str) -> Path:
        """Path for a file of the result, by its name relative to the folder; its own folder is made."""
        if not self._files:
            self._remove_previous()
        if name not in self._files:
            self._files.append(name)
        path = self.folder / name
        make_folder(path.parent)
        return path

    def write_text(self, name: str, text: str) -> Path:
        path = self.place(name)
        write_text_atomic(path, text)
        return path

    def finish(self, content: Mapping[str, Any]) -> Path:
        """Write the JSON file, which completes the result: its format, `content`, the other files, provenance."""
        document = {"format": self._format, **content, "files": sorted(self._files), "provenance": self.made_from}
        text = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        return self.write_text(self._name, text)

    def _read_previous(self) -> dict[str, Any] | None:
        return read_listing(self.folder / self._name, self._format.rpartition("/")[0])

    def _remove_previous(self) -> None:
        # the JSON file first: while it is there, the files that it lists are its own
        listed = (self._read_previous() or {}).get("files", [])
        remove_listed(self.folder, [self._name, *(listed if isinstance(listed, list) else []), *self._also])
