"""Folders for results."""

from __future__ import annotations

from pathlib import Path

from lightopt.core.errors import InputError


def make_folder(folder: Path) -> None:
    """Make a folder for results, and those that it is in; one that is there stays as it is.

    Raises
    ------
    InputError
        When a file is in the way, or the operating system refuses.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder for the results, found a file; choose another name")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be made: {error.strerror or error}; choose an output folder that can be written"
        ) from error
