"""What a picture on a screen lights: channels of its display, where it is the sum of theirs, else a light of its own."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.optimize import nnls

from lightopt.config import LightConfig
from lightopt.core.arrays import Float64
from lightopt.lights import PanelLight, SurfaceLight, picture_light
from lightopt.rig.simulated._firmware import SeenPicture
from lightopt.scene import display_picture

COMPARED_COLUMNS = 100  # pixels that pictures are compared in
RENDERED_COLUMNS = 40  # pixels of a picture that is no sum of channels: each becomes an element of a light
MISFIT = 2e-3  # share of the full radiance that a sum of channels may be off, beside the rounding of levels
LEAST_SHARE = 2e-3  # of a channel: less is rounding


def as_channels(picture: SeenPicture, lights: Sequence[LightConfig]) -> dict[str, float] | None:
    """Shares of channels of a display that a picture is the sum of, by name; None where it is no such sum."""
    rows, columns = _coarser(picture.radiance.shape, COMPARED_COLUMNS)
    expected = np.stack([display_picture(light, (columns, rows)).ravel() for light in lights], axis=1)
    seen = _resampled(picture.radiance, (rows, columns)).ravel()
    found, _ = nnls(expected, seen)
    off = np.abs(expected @ found - seen)
    if (off > MISFIT + _resampled(picture.rounding, (rows, columns)).ravel()).any():
        return None
    return {light.name: float(share) for light, share in zip(lights, found, strict=True) if share > LEAST_SHARE}


def as_light(name: str, picture: SeenPicture, display: PanelLight) -> PanelLight:
    """A display of the scene with a picture, coarsened."""
    assert isinstance(display, SurfaceLight)
    coarse = _resampled(picture.radiance, _coarser(picture.radiance.shape, RENDERED_COLUMNS))
    return replace(picture_light(display, coarse), name=name)


def _coarser(shape: tuple[int, ...], columns: int) -> tuple[int, int]:
    factor = max(1.0, max(shape) / columns)
    return max(1, round(shape[0] / factor)), max(1, round(shape[1] / factor))


def _resampled(picture: Float64, shape: tuple[int, int]) -> Float64:
    # means over the pixels of a coarser grid
    rows, columns = (_shares(size, count) for size, count in zip(picture.shape, shape, strict=True))
    return (columns @ (rows @ picture).T).T


def _shares(size: int, count: int) -> sparse.csr_array:
    # share of each of `size` pixels in each of `count` coarser ones
    ends, pixels = np.arange(count + 1) * (size / count), np.arange(size)
    overlap = np.minimum(ends[1:, None], pixels + 1.0) - np.maximum(ends[:-1, None], pixels)
    return sparse.csr_array(np.maximum(overlap, 0.0) * (count / size))
