"""The folder of a dataset: which of its poses are there, and what a previous dataset left."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lightopt.core.errors import InputError
from lightopt.core.provenance import differences
from lightopt.images import make_folder, read_listing, remove_listed, write_text_atomic

MANIFEST, FORMAT = "dataset.json", "lightopt-dataset/1"
INVISIBLE = "invisible"  # folder of images whose defects none can find
TRAIN_DEFECTS = "train_defects"  # folder of images with visible defects in the split train

# folders of a view whose files begin with the number of a sample
_OF_SAMPLES = ("images", "labels", INVISIBLE, TRAIN_DEFECTS)
_NUMBER = "[0-9]" * 6


class DatasetFolder:
    """A dataset that is written pose by pose, and that a later run with the same inputs continues.

    made_from: From :func:`lightopt.core.provenance.provenance`.
    names: Of the files and folders at its top.
    force: Whether a dataset of other inputs is replaced.
    Raises InputError: The folder holds a dataset of other inputs, and `force` is False; or it holds files of others.
    """

    def __init__(self, folder: Path, made_from: Mapping[str, Any], *, names: list[str], force: bool) -> None:
        self.folder = folder
        self._made_from: Mapping[str, Any] = json.loads(json.dumps(made_from))
        old = read_listing(folder / MANIFEST, FORMAT.partition("/")[0])
        if old is not None:
            before = old.get("provenance")
            changed = differences(before if isinstance(before, Mapping) else {}, self._made_from)
            if changed and not force:
                reason = f"already has a dataset of other inputs or with other options ({changed})"
                raise InputError(f"{folder} {reason}; use option 'force' to replace it, or choose another folder")
            self._old, self._replaced = (None, old) if changed else (old, None)
        else:
            there = [name for name in (MANIFEST, *names) if (folder / name).exists()]
            if there:
                raise InputError(f"{folder} has {', '.join(there)}, which no dataset lists; choose another folder")
            self._old = self._replaced = None

    @property
    def complete(self) -> Mapping[str, Any] | None:
        """The manifest, if all files are there that it and the poses list; else None."""
        old = self._old
        if old is None or not old.get("complete") or not isinstance(old.get("poses"), int):
            return None
        poses = [self.record(number) for number in range(old["poses"])]
        return old if all(poses) and self._has_files(old) else None

    def begin(self, views: Sequence[str]) -> None:
        """Write the manifest of a dataset without files, unless one is continued; remove the one that is replaced."""
        make_folder(self.folder)
        if self._replaced is not None:
            self._remove(self._replaced)
        if self._old is None:
            self._write({"complete": False, "views": list(views), "files": []})

    def record(self, number: int) -> dict[str, Any] | None:
        """What is known of a pose; None where any of its files is missing."""
        found = read_listing(self.folder / record_name(number))
        return found if found is not None and self._has_files(found) else None

    def _has_files(self, document: Mapping[str, Any]) -> bool:
        # a file that was edited lists nothing, or anything
        names = document.get("files")
        return isinstance(names, list) and all(isinstance(n, str) and (self.folder / n).is_file() for n in names)

    def write_record(self, number: int, record: Mapping[str, Any]) -> None:
        """Complete a pose, all of whose files are written."""
        self.write_text(record_name(number), json.dumps(record, ensure_ascii=False, separators=(",", ":")) + "\n")

    def write_text(self, name: str, text: str) -> None:
        write_text_atomic(self.path(name), text)

    def path(self, name: str) -> Path:
        """Path of a file by its name; its folder is made."""
        path = self.folder / name
        make_folder(path.parent)
        return path

    def finish(self, content: Mapping[str, Any]) -> None:
        """Write the manifest, which completes the dataset."""
        self._write({"complete": True, **content})

    def _write(self, content: Mapping[str, Any]) -> None:
        document = {"format": FORMAT, **content, "provenance": self._made_from}
        self.write_text(MANIFEST, json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n")

    def _remove(self, old: Mapping[str, Any]) -> None:
        # the records last: they know the files
        names = _entries(old, "files")
        records = sorted((self.folder / "poses").glob("pose-*.json"))
        for record in records:
            names += _entries(read_listing(record) or {}, "files")
        # and of poses that a stopped run did not complete
        views = [f"{view}/{own}/**/{_NUMBER}*" for view in _entries(old, "views") for own in _OF_SAMPLES]
        for pattern in (*views, f"poses/pose-{_NUMBER}.exr", f"stacks/pose-{_NUMBER}.h5"):
            names += [str(path.relative_to(self.folder)) for path in self.folder.glob(pattern) if path.is_file()]
        remove_listed(self.folder, [*names, *(f"poses/{record.name}" for record in records), MANIFEST])


def record_name(number: int) -> str:
    return f"poses/pose-{number:06}.json"


def _entries(document: Mapping[str, Any], key: str) -> list[Any]:
    # of a list in a file that may have been edited
    found = document.get(key)
    return list(found) if isinstance(found, list) else []
