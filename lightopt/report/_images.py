"""Pictures as PNG, the same picture as the same bytes; camera images made small without losing their highlights."""

import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lightopt.core.arrays import Bool, Float64, UInt8
from lightopt.core.errors import InputError
from lightopt.images import write_bytes_atomic


def check_png_path(path: str | Path) -> Path:
    """The path of a picture to write; an InputError where it does not end in ``.png``."""
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: pictures are written as PNG; expected a name that ends in .png")
    return path


def write_picture(path: Path, image: Image.Image, *, overwrite: bool = True) -> Path:
    """Write an RGB picture, whole or not at all."""
    write_bytes_atomic(path, png_bytes(image), overwrite=overwrite)
    return path


def png_bytes(image: Image.Image) -> bytes:
    data = io.BytesIO()
    image.save(data, format="PNG", compress_level=3)
    return data.getvalue()


SATURATED_COLOUR = (225, 29, 42)  # of a cell all of whose pixels are saturated

# how much of that colour a cell with hardly any saturated pixels gets, so that a single one still shows
FAINTEST_MARK = 0.4


@dataclass(frozen=True)
class Thumbnail:
    picture: UInt8  # RGB, shape (rows, columns, 3), read-only
    saturated: int  # number of saturated pixels in the image
    pixels: int  # number of all its pixels


def thumbnail(level: NDArray[np.floating], saturated: Bool, *, limit: int) -> Thumbnail:
    """Shrink an image by averaging square cells of whole pixels; small images are enlarged by repeating pixels.

    level: Share of full scale, shown linearly as grey from black (0 and below) to white (1 and above), shape (rows,
        columns).
    saturated: Where the camera is saturated, same shape. The share of saturated pixels in a cell tints it.
    limit: Neither side becomes longer [px].
    """
    height, width = level.shape
    shrink, enlarge = _factors(width, height, limit)
    grey = _cell_means(np.clip(np.nan_to_num(level), 0.0, 1.0), shrink)
    tint = shade_of_saturation(_cell_means(saturated, shrink))[..., None]
    blend = (1.0 - tint) * (255.0 * grey[..., None]) + tint * np.array(SATURATED_COLOUR)
    picture = np.floor(blend + 0.5).astype(np.uint8).repeat(enlarge, axis=0).repeat(enlarge, axis=1)
    picture.flags.writeable = False
    return Thumbnail(picture, int(np.count_nonzero(saturated)), saturated.size)


def shrunk(picture: UInt8 | NDArray[np.uint8 | np.uint16], *, limit: int) -> UInt8:
    """A colour picture of 8 bits, shape (rows, columns, 3), by means of square cells; no side longer than `limit`."""
    shrink, _ = _factors(picture.shape[1], picture.shape[0], limit)
    channels = [_cell_means(picture[..., k], shrink) for k in range(3)]
    return np.floor(np.stack(channels, axis=-1) + 0.5).astype(np.uint8)


def shade_of_saturation(share: Float64) -> Float64:
    """How strongly :data:`SATURATED_COLOUR` covers a cell, 0 to 1, by the share of its pixels that are saturated."""
    return np.where(share > 0.0, FAINTEST_MARK + (1.0 - FAINTEST_MARK) * share, 0.0)


def _factors(width: int, height: int, limit: int) -> tuple[int, int]:
    longest = max(width, height)
    return max(1, math.ceil(longest / limit)), max(1, limit // longest)


def _cell_means(values: NDArray[Any], side: int) -> Float64:
    """Means over cells of side × side pixels; cells cut by the border are averaged over what is there of them."""
    rows, columns = (np.arange(0, length, side) for length in values.shape)
    cells = np.add.reduceat(values.astype(np.float64), rows, axis=0)
    sums: Float64 = np.add.reduceat(cells, columns, axis=1)
    return sums / np.outer(np.diff(rows, append=values.shape[0]), np.diff(columns, append=values.shape[1]))
