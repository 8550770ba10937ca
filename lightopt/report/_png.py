"""Pictures as PNG: the same picture gives the same bytes."""

from __future__ import annotations

import io
from pathlib import Path

from PIL import Image

from lightopt.core.errors import InputError
from lightopt.images import write_bytes_atomic


def check_png_path(path: str | Path) -> Path:
    """The path of a picture to write; an InputError where it does not end in ``.png``."""
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: pictures are written as PNG; expected a name that ends in .png")
    return path


def write_picture(path: Path, image: Image.Image, *, overwrite: bool = True) -> Path:
    """Write an RGB picture, whole or not at all.

    Raises
    ------
    InputError
        When the file cannot be written, or one of other content is there and `overwrite` is False.
    """
    write_bytes_atomic(path, png_bytes(image), overwrite=overwrite)
    return path


def png_bytes(image: Image.Image) -> bytes:
    """The bytes of a PNG file."""
    data = io.BytesIO()
    image.save(data, format="PNG", compress_level=6)
    return data.getvalue()
