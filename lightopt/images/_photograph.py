"""Photographs that other programs wrote: PNG, JPEG and TIFF, grey or colour, levels as stored."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import InputError
from lightopt.images._image_files import opened

_FORMATS = ("png", "jpeg", "tiff")
_BITS = {"uint8": 8, "uint16": 16}


@dataclass(frozen=True)
class PhotographFormat:
    """What a photograph's header says; bits per sample."""

    width: int
    height: int
    bits: int

    def __str__(self) -> str:
        return f"{self.width} × {self.height} px, {self.bits} bits"


def photograph_format(path: Path) -> PhotographFormat:
    """Read the header of a photograph.

    Raises InputError: The file is missing, of another format or kind of samples, or stored rotated
    """
    with opened(path, *_FORMATS) as source:
        spec = source.spec()
    if str(spec.format) not in _BITS:
        raise InputError(f"{path}: expected samples of 8 or 16 bits, found {spec.format}; convert the image")
    if (turn := spec.get_int_attribute("Orientation", 1)) != 1:
        raise InputError(
            f"{path}: stored rotated or mirrored (EXIF orientation {turn}); save it as it was calibrated, with "
            "orientation 1"
        )
    return PhotographFormat(spec.width, spec.height, _BITS[str(spec.format)])


def read_photograph(path: Path) -> NDArray[Any]:
    """Samples of a photograph as stored, uint8 or uint16 of shape (H, W, 1 or 3), row 0 at the top, no transparency.

    Raises InputError: As :func:`photograph_format`, or the file is damaged
    """
    shape = photograph_format(path)
    with opened(path, *_FORMATS) as source:
        pixels = source.read_image(f"uint{shape.bits}")
        if pixels is None or source.has_error:
            raise InputError(f"{path}: damaged: {source.geterror().strip().splitlines()[0]}; copy the file anew")
    samples = np.asarray(pixels).reshape(shape.height, shape.width, -1)
    return samples[..., : 3 if samples.shape[2] >= 3 else 1]
