"""PNG images of camera levels (grey, 8 or 16 bit) and of illustrations (RGB)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import UInt8
from lightopt.core.errors import InputError
from lightopt.images.formats._openimageio import open_input, openimageio, read_metadata, write_image

Levels = UInt8 | NDArray[np.uint16]

# of a noisy camera image of 1600 × 1200, on a busy machine: 21 ms and 0.71 MB; level 2 takes 43 ms for 0.69 MB
_COMPRESSION_LEVEL = 1

# libpng's number. Choosing a filter row by row takes 76 ms instead of 21, and noise is packed no better by any.
_NO_FILTER = 8

_END_CHUNK = b"\0\0\0\0IEND\xaeB`\x82"
_COLOUR_TYPES = {0: "grey", 2: "RGB", 3: "palette", 4: "grey with alpha", 6: "RGB with alpha"}


def write_png(path: str | Path, levels: Levels, *, metadata: Mapping[str, Any], overwrite: bool = True) -> str:
    """Write a PNG, whole or not at all: values exactly as given, no colour transform, same input same bytes.

    Returns the SHA-256 in hex.

    levels: Camera levels (H, W) uint8 or uint16 (10 to 16 bit, right-aligned), or a picture (H, W, 3) uint8; row 0
        at the top.
    metadata: JSON-able values, kept in one text chunk ``lightopt:json``.
    overwrite: Whether a file of other content may be replaced.
    Raises InputError: The array is of another type or shape, or the file cannot be written
    """
    grey = levels.ndim == 2 and str(levels.dtype) in ("uint8", "uint16")
    picture = levels.ndim == 3 and levels.shape[2] == 3 and levels.dtype == np.uint8
    if not (grey or picture) or not levels.size:
        raise InputError(
            f"{path}: expected uint8 or uint16 of shape (H, W), or uint8 of shape (H, W, 3), "
            f"found {levels.dtype} of shape {levels.shape}"
        )
    pixels = levels if picture else levels[:, :, np.newaxis]
    OpenImageIO = openimageio()
    spec = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], str(levels.dtype))
    spec.attribute("png:compressionLevel", _COMPRESSION_LEVEL)
    if grey:
        spec.attribute("png:filter", _NO_FILTER)
    spec.attribute("oiio:ColorSpace", "unknown")  # else sRGB and gamma chunks are added, which are not true
    rows = iter([pixels])
    return write_image(path, "png", spec, rows, metadata=metadata, is_complete=_is_complete, overwrite=overwrite)


def _is_complete(path: Path) -> bool:
    """Whether the file ends as every PNG ends."""
    size = path.stat().st_size
    if size < len(_END_CHUNK):
        return False
    with path.open("rb") as file:
        file.seek(size - len(_END_CHUNK))
        return file.read() == _END_CHUNK


def read_png(path: str | Path, *, colour: bool = False) -> Levels:
    """Levels of a PNG exactly as stored: uint8 or uint16 of shape (H, W), row 0 at the top.

    With `colour` RGB is accepted as well, as (H, W, 3).

    Raises InputError: the file is missing, damaged or no PNG, has fewer than 8 bits, a palette, transparency, or
    colour without `colour`.
    """
    path = Path(path)
    with open_input(path, file_format="png") as source:
        with path.open("rb") as file:
            header = file.read(26)
        bits, kind = header[24], header[25]
        # refused by the header, because the decoder expands 1, 2 and 4 bits and palettes, which changes the levels
        if bits not in (8, 16) or kind not in ((0, 2) if colour else (0,)):
            found = f"{bits}-bit {_COLOUR_TYPES.get(kind, 'unknown')}"
            expected = "8- or 16-bit grey" + (" or RGB" if colour else "")
            raise InputError(f"{path}: expected {expected}, found {found}; convert the image first")
        spec = source.spec()
        pixels = source.read_image(str(spec.format))
        if pixels is None or source.has_error:
            raise InputError(f"{path}: damaged: {source.geterror().strip().splitlines()[0]}; write the file anew")
        values = np.ascontiguousarray(pixels).reshape(spec.height, spec.width, -1)
    if values.shape[2] == 1:
        return values[:, :, 0]
    if values.shape[2] == 3 and colour:
        return values
    raise InputError(f"{path}: has a transparent colour; expected plain {'grey or RGB' if colour else 'grey'}")


def read_png_metadata(path: str | Path) -> dict[str, Any]:
    """Metadata that :func:`write_png` put into the file; empty for files of other programs.

    Raises InputError: the file is missing or no PNG, or its metadata are damaged.
    """
    return read_metadata(Path(path), file_format="png")
