"""What EXR and PNG share of OpenImageIO: opening, writing, error texts, metadata in one JSON attribute."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import InputError
from lightopt.images._atomic import write_atomically

if TYPE_CHECKING:
    import OpenImageIO


_METADATA_KEY = "lightopt:json"  # the attribute that carries all metadata: the only kind that both EXR and PNG keep

_PROBE_BYTES = 1 << 20
_FORMAT_NAMES = {"openexr": "an OpenEXR image", "png": "a PNG image", "jpeg": "a JPEG image", "tiff": "a TIFF image"}


def openimageio() -> Any:
    """Import OpenImageIO on first use, so that `--help` does not pay for it.

    An interrupt that reaches OpenImageIO while it is imported aborts the process, so it is held back until then.
    """
    if threading.current_thread() is not threading.main_thread():
        import OpenImageIO

        return OpenImageIO
    held: list[tuple[int, FrameType | None]] = []
    handler = signal.signal(signal.SIGINT, lambda number, frame: held.append((number, frame)))
    try:
        import OpenImageIO
    finally:
        signal.signal(signal.SIGINT, handler)
    if held and callable(handler):
        handler(*held[0])
    return OpenImageIO


def write_image(
    path: str | Path,
    file_format: str,
    spec: OpenImageIO.ImageSpec,
    rows: Iterator[NDArray[Any]],
    *,
    metadata: Mapping[str, Any],
    is_complete: Callable[[Path], bool],
    overwrite: bool = True,
) -> str:
    """Encode an image block by block, whole or not at all; returns the SHA-256 in hex.

    `rows` are blocks from the top down, each (rows, W, C) in the spec's sample type. `is_complete` says whether a
    file has its end: a disk that fills up at the last flush is reported by no encoder.
    """
    # ASCII JSON with sorted keys: equal metadata are equal bytes, and PNG's Latin-1 text holds them
    text = json.dumps(dict(metadata), sort_keys=True, allow_nan=False, separators=(",", ":"))
    spec.attribute(_METADATA_KEY, text)

    def encode(path: Path) -> None:
        # raises OSError with the system's reason
        OpenImageIO = openimageio()
        output = OpenImageIO.ImageOutput.create(file_format)
        if output is None:
            raise OSError(f"OpenImageIO has no {file_format} writer: {OpenImageIO.geterror()}")
        if not output.open(str(path), spec):  # writing after a failed open crashes the process
            raise OSError(output.geterror())
        top, done = 0, True
        for block in rows:
            done = output.write_scanlines(top, top + block.shape[0], 0, np.ascontiguousarray(block))
            if not done:
                break
            top += block.shape[0]
        closed = output.close()
        # The PNG writer reports success on a full disk; only its error text shows it.
        message = output.geterror()
        if not (done and closed) or message or not is_complete(path):
            with path.open("ab") as file:  # appended, so that the system says why it refuses (no space left, quota, …)
                file.write(bytes(_PROBE_BYTES))
            raise OSError(message.strip().split("\n")[0] or "the file came out incomplete")

    return write_atomically(path, encode, overwrite=overwrite)


@contextmanager
def open_input(path: Path, *, file_format: str | Sequence[str]) -> Generator[OpenImageIO.ImageInput, None, None]:
    """Open an image for reading; InputError when it is missing, unreadable or of none of the formats given."""
    OpenImageIO = openimageio()
    formats = (file_format,) if isinstance(file_format, str) else tuple(file_format)
    expected = " or ".join(_FORMAT_NAMES[name] for name in formats)
    try:
        path.open("rb").close()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    hints = OpenImageIO.ImageSpec()
    hints.attribute("oiio:UnassociatedAlpha", 1)  # else colours are multiplied by a PNG's transparency
    source = OpenImageIO.ImageInput.open(str(path), hints)
    if source is None:
        reason = OpenImageIO.geterror().strip()
        raise InputError(f"{path}: expected {expected}, found something else or a damaged file: {reason}")
    try:
        if source.format_name() not in formats:
            raise InputError(f"{path}: expected {expected}, found {source.format_name()}")
        yield source
    finally:
        source.close()


def read_metadata(path: Path, *, file_format: str) -> dict[str, Any]:
    """Metadata of an image as written by lightopt; empty for files of other programs."""
    with open_input(path, file_format=file_format) as source:
        text = source.spec().getattribute(_METADATA_KEY)
    if text is None:
        return {}
    try:
        metadata = json.loads(text)
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: attribute {_METADATA_KEY} is not valid JSON: {error}") from error
    if not isinstance(metadata, dict):
        raise InputError(f"{path}: attribute {_METADATA_KEY}: expected a JSON object, found {type(metadata).__name__}")
    return metadata
