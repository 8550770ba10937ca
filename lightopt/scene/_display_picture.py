"""The picture that a display shows for a channel of its light: the one place that makes it from the rig's file."""

from pathlib import Path

import numpy as np

from lightopt.config import LightConfig
from lightopt.core.arrays import Float64
from lightopt.lights import pattern_picture
from lightopt.scene._lights import _pattern


def display_picture(light: LightConfig, pixels: tuple[int, int], *, folder: Path = Path()) -> Float64:
    """Share of the full radiance of each pixel, shape (rows, columns), as :func:`lightopt.lights.picture_light` has it.

    light: A channel of a display; white without a pattern
    pixels: Columns and rows as seen from the part, with `along` upwards
    folder: Of the rig's file, which names of pictures are relative to
    """
    if light.pattern is None:
        return np.ones(pixels[::-1])
    assert light.size_mm is not None
    return pattern_picture(_pattern(folder, light), light.size_mm, pixels)
