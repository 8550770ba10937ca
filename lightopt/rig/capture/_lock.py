"""One capture into a folder at a time."""

import contextlib
import os
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from lightopt.core.errors import InputError
from lightopt.images import make_folder

LOCK_NAME = ".capture.lock"

_FAR = 1 << 20  # Windows keeps others from reading what is locked, so that a byte behind the text is


@contextmanager
def lock_folder(folder: Path) -> Generator[None]:
    """Keep other captures out of a folder, which is created if it does not exist.

    The operating system holds the lock: that of a killed process is gone, even if its file still exists.
    InputError when another process captures into the folder, or it cannot be written.
    """
    path = folder / LOCK_NAME
    file = _open_locked(path)
    try:
        while not _has_path(file, path):  # its previous owner has just removed it
            file.close()
            file = _open_locked(path)
        file.seek(0)
        file.truncate()
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield
    finally:
        if sys.platform != "win32":  # which removes no open file
            with contextlib.suppress(OSError):
                path.unlink()
        file.close()


def _open_locked(path: Path) -> IO[str]:
    """Open and lock the file."""
    make_folder(path.parent)
    try:
        file = path.open("a+", encoding="ascii")
    except OSError as error:
        raise InputError(
            f"{path.parent}: cannot be written: {error.strerror or error}; choose another output folder"
        ) from error
    try:
        _lock_file(file)
    except OSError as error:
        file.seek(0)
        owner = file.read(20).strip()
        file.close()
        raise InputError(
            f"{path.parent}: another capture writes into this folder{f' (process {owner})' if owner else ''}; wait for "
            "it to end, or choose another output folder"
        ) from error
    return file


def _lock_file(file: IO[str]) -> None:
    if sys.platform == "win32":
        import msvcrt

        file.seek(_FAR)
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _has_path(file: IO[str], path: Path) -> bool:
    """Whether the locked file is the one that has the name."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False
