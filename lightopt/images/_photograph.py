"""Photographs that other programs wrote: PNG, JPEG, TIFF and EXR, grey or colour, levels as stored."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import InputError
from lightopt.images._image_files import opened

if TYPE_CHECKING:
    import OpenImageIO

_FORMATS = ("png", "jpeg", "tiff", "openexr")
_BITS = {"uint8": 8, "uint16": 16, "half": None, "float": None}
_COLOURS = ("R", "G", "B")


@dataclass(frozen=True)
class PhotographFormat:
    """What a photograph's header says.

    bits: Bits per sample; None for floating point
    colour: Whether it has red, green and blue
    compressed: Whether it was stored with losses (JPEG)
    """

    width: int
    height: int
    bits: int | None
    colour: bool
    compressed: bool


def photograph_format(path: Path) -> PhotographFormat:
    """Read the header of a photograph.

    Raises InputError: the file is missing, of another format, of an unknown kind of samples or channels, or stored
        rotated.
    """
    with opened(path, *_FORMATS) as source:
        return _format(path, source)


def read_photograph(path: Path) -> NDArray[Any]:
    """Samples of a photograph as stored, uint8, uint16 or float32 of shape (H, W, 1 or 3), row 0 at the top.

    Samples of 10 to 14 bits are right-aligned. Transparency is left out.

    Raises InputError: as :func:`photograph_format`, or the file is damaged
    """
    with opened(path, *_FORMATS) as source:
        found, spec = _format(path, source), source.spec()
        pixels = source.read_image("float" if found.bits is None else str(spec.format))
        if pixels is None or source.has_error:
            raise InputError(f"{path}: damaged: {source.geterror().strip().splitlines()[0]}; copy the file anew")
        pixels = np.asarray(pixels).reshape(spec.height, spec.width, -1)
        samples = pixels[..., _channels(path, list(spec.channelnames))]
    if found.bits is not None:
        samples = samples >> (8 * samples.dtype.itemsize - found.bits)  # the reader scales to whole bytes
    return samples


def _format(path: Path, source: OpenImageIO.ImageInput) -> PhotographFormat:
    spec = source.spec()
    kind = str(spec.format)
    if kind not in _BITS:
        raise InputError(f"{path}: expected samples of 8 or 16 bits, half or float, found {kind}; convert the image")
    if (turn := spec.get_int_attribute("Orientation", 1)) != 1:
        raise InputError(
            f"{path}: stored rotated or mirrored (EXIF orientation {turn}); save it as it was calibrated, with "
            "orientation 1"
        )
    bits = _BITS[kind]
    if bits is not None:
        bits = spec.get_int_attribute("oiio:BitsPerSample", bits)
    return PhotographFormat(
        width=spec.width,
        height=spec.height,
        bits=bits,
        colour=len(_channels(path, list(spec.channelnames))) == len(_COLOURS),
        compressed=source.format_name() == "jpeg",
    )


def _channels(path: Path, names: list[str]) -> list[int]:
    if set(_COLOURS) <= set(names):
        return [names.index(name) for name in _COLOURS]
    if "Y" in names or len(names) == 1:
        return [names.index("Y") if "Y" in names else 0]
    raise InputError(f"{path}: expected grey (Y) or colour (R, G, B), found the channels {', '.join(names)}")
