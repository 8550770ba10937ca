"""The blocks of pixels that are compared: where they are, and what was measured there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Bool, Float64, Int32
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import PixelSet
from lightopt.estimate.verification._coarse import CoarseImage, CoarsePrediction, blurred, some_blocks

BACKGROUND_BLOCKS = 300  # of each image

# the background shows the black level if its mean is the same in all images, and even, to so many sensor levels
EVEN_LEVELS = 0.3

CELLS = 24  # of neighbouring blocks, along the width of an image

BLUR_PX = 1.5  # blur for the difference


@dataclass(frozen=True, kw_only=True)
class Rows:
    """The blocks of all images, n of them, each array of shape (n,); those of the background come last.

    sets: Of each posture the blocks that show the part.
    image: Which image each row is of.
    measured, top: Level, black level included, and that from which a pixel is saturated [sensor level].
    unsaturated: Whether no pixel of the block is saturated.
    background: Rows that show black.
    cell: Number of a cell of neighbouring blocks of an image.
    blur: Change of the predicted level per px² of variance of a blur [grey level at exposure 1].
    """

    sets: tuple[PixelSet, ...]
    image: Int32
    measured: Float64
    top: Float64
    unsaturated: Bool
    background: Bool
    cell: Int32
    blur: Float64


def choose_rows(
    images: Sequence[CoarseImage], predictions: Mapping[Posture, CoarsePrediction], *, budget: int, side: int
) -> Rows:
    """Choose blocks at random, the same ones each time.

    budget: Blocks of each posture; side: Of the blocks [px].
    """
    sets: list[PixelSet] = []
    # image, measured, top, unsaturated, background, cell, blur
    columns: list[list[Float64]] = []

    def add(n: int, levels: Float64, *rest: object) -> None:
        columns.append([np.broadcast_to(np.asarray(one, np.float64), levels.shape) for one in (n, levels, *rest)])

    for posture, prediction in predictions.items():
        mine = [n for n, image in enumerate(images) if image.source.posture == posture]
        row, column = some_blocks(prediction.clean, budget)
        if not len(row):
            continue
        levels = np.stack([images[n].levels[row, column] for n in mine]).astype(np.float64)
        full = np.stack([images[n].saturated[row, column] for n in mine])
        sources = tuple(images[n].source for n in mine)
        sets.append(PixelSet(posture=posture, row=row, column=column, images=sources, levels=levels, saturated=full))
        width = max(8, prediction.clean.shape[1] // CELLS)
        cell = (row // width) * 1000 + column // width
        for own, n in enumerate(mine):
            level = prediction.levels[images[n].source.light]
            change = (blurred(level, BLUR_PX / side) - level)[row, column].astype(np.float64) / BLUR_PX**2
            add(n, levels[own], images[n].top[row, column], ~full[own], False, cell, change)
    for n, levels in enumerate(_black_background(images, predictions)):
        add(n, levels, np.inf, True, True, -1, 0.0)
    image, measured, top, unsaturated, background, cell, blur = np.concatenate(
        [np.zeros((7, 0)), *(np.stack(some) for some in columns)], axis=1
    )
    return Rows(
        sets=tuple(sets),
        image=image.astype(np.int32),
        measured=measured,
        top=top,
        unsaturated=unsaturated > 0.0,
        background=background > 0.0,
        cell=np.unique(image * 1e7 + cell, return_inverse=True)[1].astype(np.int32),
        blur=blur,
    )


def _black_background(images: Sequence[CoarseImage], predictions: Mapping[Posture, CoarsePrediction]) -> list[Float64]:
    # of each image the levels of blocks off the part; none if one of them shows more than black
    found: list[Float64] = []
    means: list[float] = []
    for image in images:
        row, column = some_blocks(predictions[image.source.posture].background, BACKGROUND_BLOCKS)
        if len(row) < BACKGROUND_BLOCKS // 4 or not isinstance(image.source.subtracted, float):
            return []
        levels = image.levels[row, column].astype(np.float64)
        # in four directions about the part
        cell = 2 * (row > np.median(row)) + (column > np.median(column))
        means += [float(levels[cell == c].mean()) for c in range(4) if np.any(cell == c)]
        found.append(levels)
    return found if max(means) - min(means) < EVEN_LEVELS else []
