"""Reading an image of either format for comparison."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import InputError
from lightopt.images import read_exr, read_exr_metadata, read_png, read_png_metadata

LEVELS = "levels"
"""Name given to a grey PNG's only channel."""

_EXR_MAGIC = b"\x76\x2f\x31\x01"
_PNG_MAGIC = b"\x89PNG"
_DEFAULT_FULL_SCALE = 255.0


@dataclass(frozen=True)
class LoadedFile:
    """An image's channels (H, W) by name, what it is, and its levels of saturation and of background."""

    channels: dict[str, NDArray[Any]]
    kind: str
    saturation: float
    black: float = 0.0

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W)."""
        return next(iter(self.channels.values())).shape

    @property
    def is_geometry(self) -> bool:
        """Whether this is a geometry image, where pixels may miss the part."""
        return {"Z", "N.X"} <= self.channels.keys()


def load_file(path: Path) -> LoadedFile:
    """Read an EXR or PNG, told apart by content.

    Raises
    ------
    InputError
        When the file is missing, damaged, or neither.
    """
    try:
        with path.open("rb") as file:
            magic = file.read(4)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if magic == _EXR_MAGIC:
        full_scale = _number(read_exr_metadata(path).get("full_scale"), _DEFAULT_FULL_SCALE)
        return LoadedFile(channels=dict(read_exr(path)), kind="EXR of floats", saturation=full_scale)
    if magic != _PNG_MAGIC:
        raise InputError(f"{path}: expected an EXR or PNG image, found neither")
    pixels = read_png(path, colour=True)
    grey = pixels.ndim == 2
    channels = {LEVELS: pixels} if grey else {name: pixels[..., i] for i, name in enumerate("RGB")}
    top = float(np.iinfo(pixels.dtype).max)
    metadata = read_png_metadata(path)
    saturation = _number(metadata.get("saturation_level"), top)
    black = _number(metadata.get("black_level"), 0.0)
    return LoadedFile(dict(channels), f"PNG of {pixels.dtype}", saturation, black)


def _number(value: object, default: float) -> float:
    return float(value) if isinstance(value, (int, float)) and value > 0 else default


def hit_mask(image: LoadedFile) -> NDArray[np.bool_]:
    """Where the rays of a geometry image hit the part: everything is 0 where they miss."""
    return image.channels["Z"] != 0


def lit_mask(image: LoadedFile, channel: str) -> NDArray[np.bool_]:
    """Where a channel is not background: 0, or the black level as the camera rounds it."""
    return image.channels[channel] != math.floor(image.black + 0.5)
