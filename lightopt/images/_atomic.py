"""Writing files whole or not at all (temporary name, flush, fsync, rename); making folders and removing files."""

import contextlib
import csv
import io
import os
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import InputError
from lightopt.core.provenance import file_sha256
from lightopt.core.threads import blocks, in_threads

_ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)
_PACKED_AT_ONCE = 2  # arrays of an archive that are compressed at the same time
# an array of which so many elements are not compressed to less than this share of their size is stored as it is
_SAMPLE, _WORTHWHILE = 50_000, 0.85


def write_atomically(path: str | Path, write: Callable[[Path], object], *, overwrite: bool = True) -> str:
    """Let `write` fill a temporary file beside `path`, then rename it; returns the SHA-256 in hex.

    Whatever happens (disk full, Ctrl-C, an exception of `write`), no temporary file is left and `path` holds
    either its old content or the whole new one. A killed process can leave ``.<name>.partial``, which the
    next write of the same file replaces.

    Raises InputError: the operating system refuses, or a file of other content is there and `overwrite` is False.
    """
    path = Path(path)
    if os.path.isdir(path):  # noqa: PTH112  (False, and no error, where the system does not let one look)
        raise InputError(f"{path}: expected the name of a file to write, found a folder")
    temporary = path.with_name(f".{path.name}.partial")
    try:
        temporary.open("wb").close()
        write(temporary)
        with temporary.open("rb+") as file:  # Windows only syncs files that are open for writing
            os.fsync(file.fileno())
        digest = file_sha256(temporary)
        if not overwrite and path.exists() and not (path.is_file() and file_sha256(path) == digest):
            raise InputError(f"{path}: exists with other content; use option 'force' to replace it, or another name")
        os.replace(temporary, path)  # noqa: PTH105 - one name to patch in fault tests, on every platform
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            advice = "check that the folder exists, is writable and has room, or choose another one"
            raise InputError(f"{path}: cannot be written: {error.strerror or error}; {advice}") from error
        raise
    return digest


def write_bytes_atomic(path: str | Path, data: bytes, *, overwrite: bool = True) -> str:
    """Write bytes as a whole file or not at all; returns the SHA-256 in hex. Errors as :func:`write_atomically`."""
    return write_atomically(path, lambda temporary: temporary.write_bytes(data), overwrite=overwrite)


def write_text_atomic(path: str | Path, text: str, *, overwrite: bool = True) -> str:
    """Write text as a whole UTF-8 file or not at all, line ends as given; returns the SHA-256 in hex."""
    return write_bytes_atomic(path, text.encode("utf-8"), overwrite=overwrite)


def write_npz_atomic(path: str | Path, arrays: Mapping[str, NDArray[Any]]) -> str:
    """Write a compressed ``.npz`` whole or not at all, same arrays same bytes; returns the SHA-256 in hex."""
    names = list(arrays)

    def write(temporary: Path) -> None:
        with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
            # a few at once: what is packed waits in memory
            for start, end in blocks(len(names), _PACKED_AT_ONCE):
                some = [np.asarray(arrays[name], order="C") for name in names[start:end]]
                packed = in_threads(_deflated, some)
                for name, array, content in zip(names[start:end], some, packed, strict=True):
                    entry = zipfile.ZipInfo(f"{name}.npy", _ZIP_EPOCH)
                    entry.compress_type = zipfile.ZIP_DEFLATED
                    entry.create_system = 3  # else the bytes would differ between Windows and Linux
                    with archive.open(entry, "w", force_zip64=True) as file:
                        file._compressor = content  # pyright: ignore[reportAttributeAccessIssue]
                        np.lib.format.write_array(file, array, allow_pickle=False)

    return write_atomically(path, write)


class _Packed(list[bytes]):
    """What a thread has compressed of an array, in the place of the compressor of an archive."""

    def compress(self, _: bytes) -> bytes:
        return b""

    def flush(self) -> bytes:
        return b"".join(self)


def _deflated(array: NDArray[Any]) -> _Packed:
    level = 1 if _is_compressible(array) else 0
    compressor, packed = zlib.compressobj(level, zlib.DEFLATED, -zlib.MAX_WBITS), _Packed()

    class Target:
        def write(self, data: bytes) -> None:
            packed.append(compressor.compress(data))

    np.lib.format.write_array(Target(), array, allow_pickle=False)  # pyright: ignore[reportArgumentType]
    packed.append(compressor.flush())
    return packed


def _is_compressible(array: NDArray[Any]) -> bool:
    # by a sample from the middle: the digits of measured numbers look random
    begin = max(0, array.size - _SAMPLE) // 2
    sample = array.reshape(-1)[begin : begin + _SAMPLE].tobytes()
    return len(zlib.compress(sample, 1)) < _WORTHWHILE * len(sample)


def csv_text(rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def make_folder(folder: Path) -> None:
    """Make a folder for results where there is none; InputError when a file is in the way, or the system refuses."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder for the results, found a file; choose another name")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = error.strerror or error
        raise InputError(f"{folder}: cannot be made: {why}; choose an output folder that can be written") from error


def remove_file(path: Path) -> bool:
    """Remove a file; returns whether it was there. InputError when the operating system refuses."""
    try:
        path.unlink()
    except FileNotFoundError:
        return False
    except OSError as error:
        why = error.strerror or error
        raise InputError(f"{path}: cannot be removed: {why}; choose another output folder") from error
    return True
