"""The noise that the images show themselves, whatever the model makes of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightopt.fit._samples import Samples

__all__ = ["image_noise"]


def image_noise(samples: Samples) -> float:
    """Typical deviation of a lit pixel from the plane through its neighbours [sensor level]; 0 where there is none.

    Immerkær 1996, doi:10.1006/cviu.1996.0060: what a 3 × 3 window leaves of anything that is a plane or a saddle.
    """
    _, response = window_responses(samples)
    return 1.4826 * float(np.median(np.abs(response))) / 6.0 if len(response) else 0.0


def window_responses(samples: Samples) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Observations of lit, unsaturated pixels, and what the window leaves there: 6 times the noise's deviation.

    Parameters
    ----------
    samples
        The observations.
    """
    row = np.concatenate([group.row for group in samples.groups])[samples.sample]
    column = np.concatenate([group.column for group in samples.groups])[samples.sample]
    height, width = samples.images[0].levels.shape
    use = (row > 0) & (row < height - 1) & (column > 0) & (column < width - 1)
    use &= (samples.diffuse[samples.sample] > 0.0) & (samples.level > 0.0) & ~samples.saturated
    index = np.flatnonzero(use)
    response = np.zeros(len(index))
    order = np.argsort(samples.image[index], kind="stable")
    ends = np.searchsorted(samples.image[index][order], np.arange(len(samples.images) + 1))
    for number, image in enumerate(samples.images):
        here = order[ends[number] : ends[number + 1]]
        r, c = row[index[here]], column[index[here]]
        level = image.levels
        for y, x, factor in (*((y, x, 1.0) for y in (-1, 1) for x in (-1, 1)), (0, 0, 4.0)):
            response[here] += factor * level[r + y, c + x]
        for y, x in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            response[here] -= 2.0 * level[r + y, c + x]
    return index, response
