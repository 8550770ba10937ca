"""One linear image from the exposures of a bracket."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightopt.optics import Sensor
from lightopt.rig.capture._frames import Exposed

Float32 = NDArray[np.float32]


def merge_bracket(
    images: Sequence[Exposed],
    *,
    sensor: Sensor,
    full_scale: float,
    dark: Sequence[Float32] | None = None,
) -> dict[str, Float32]:
    """The linear image of a light: every pixel from the longest exposure in which it is not saturated.

    Level at exposure 1 = (sensor level − dark) · full scale / ((2^b − 1) · exposure).

    Parameters
    ----------
    images
        The exposures, of one shape (H, W), the longest first.
    sensor
        That took them; its black level is removed where there is no dark frame.
    full_scale
        Grey level of a full-scale sensor level at exposure 1.
    dark
        Mean frame without light of each exposure [sensor level], shape (H, W).

    Returns
    -------
    dict
        EXR channels, float32 (H, W): ``Y`` [grey level at exposure 1]; ``valid``, 0 where every exposure was saturated
        and `Y` is only a lower bound; ``exposure``, the relative exposure that the pixel came from.
    """
    level = np.zeros(images[0].mean.shape, np.float32)
    came_from = np.zeros(level.shape, np.float32)
    missing = np.ones(level.shape, np.bool_)
    for i, image in enumerate(images):
        last = i == len(images) - 1
        take = missing if last else missing & ~image.saturated
        black = sensor.black_level if dark is None else dark[i]
        scale = full_scale / (sensor.max_level * image.exposure)
        np.copyto(level, ((image.mean - black) * scale).astype(np.float32), where=take)
        came_from[take] = image.exposure
        missing = missing & image.saturated
    return {"Y": level, "valid": (~missing).astype(np.float32), "exposure": came_from}
