"""What a picture on a screen lights: channels of its display whose sum it is, or else a light of its own."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from lightopt.config import LightConfig
from lightopt.core.arrays import Float64
from lightopt.lights import PanelLight, SurfaceLight, picture_patterns
from lightopt.rig.simulated._firmware import SeenPicture
from lightopt.scene import display_picture

COMPARED_COLUMNS = 100  # pixels that pictures are compared in
MISFIT = 2e-3  # share of the full radiance that a sum of channels may be off, beside the rounding of levels
LEAST_SHARE = 2e-3  # of a channel: less is rounding


def as_channels(
    picture: SeenPicture, lights: Sequence[LightConfig], *, folder: Path = Path()
) -> dict[str, float] | None:
    """Shares of channels of a display that a picture is the sum of, by name; None where it is no such sum.

    folder: Of the rig's file, which names of pictures are relative to
    """
    rows, columns = picture.radiance.shape
    # blocks of whole pixels, whose means are those of the pattern
    common = math.gcd(rows, columns)
    side = max(k for k in range(1, common + 1) if common % k == 0 and k <= max(1, columns // COMPARED_COLUMNS))
    shape = rows // side, columns // side
    expected = np.stack([display_picture(light, shape[::-1], folder=folder).ravel() for light in lights], axis=1)
    seen, rounding = (_block_means(one, shape).ravel() for one in (picture.radiance, picture.rounding))
    found, _ = nnls(expected, seen)
    if (np.abs(expected @ found - seen) > MISFIT + rounding).any():
        return None
    return {light.name: float(share) for light, share in zip(lights, found, strict=True) if share > LEAST_SHARE}


def as_light(name: str, picture: SeenPicture, display: PanelLight) -> PanelLight:
    """A display of the scene with a picture on it."""
    assert isinstance(display, SurfaceLight)
    [pattern] = picture_patterns([picture.radiance], display.size)
    return replace(display, name=name, pattern=pattern)


def _block_means(picture: Float64, shape: tuple[int, int]) -> Float64:
    # means over so many rows and columns of blocks of whole pixels
    for axis, count in enumerate(shape):
        edges = np.arange(count + 1) * picture.shape[axis] // count
        sums = np.add.reduceat(picture, edges[:-1], axis=axis)
        picture = sums / np.expand_dims(np.diff(edges), 1 - axis)
    return picture
