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
_EVEN_CELLS = 4

CELLS = 24  # of neighbouring blocks, along the width of an image

BLUR_PX = 1.5  # blur for the difference


@dataclass(frozen=True, kw_only=True)
class Rows:
    """The blocks of all images, n of them, each array of shape (n,); those of the background come last.

    sets: Of each posture the blocks that show the part; numbers: Which images its images are.
    image: Which image each row is of.
    measured, top: Level, black level included, and that from which a pixel is saturated [sensor level].
    unsaturated: Whether no pixel of the block is saturated.
    background: Rows that show black.
    cell: Number of a cell of neighbouring blocks of an image.
    blur: Change of the predicted level per px² of variance of a blur [grey level at exposure 1].
    """

    sets: tuple[PixelSet, ...]
    numbers: tuple[tuple[int, ...], ...]
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
    numbers: list[tuple[int, ...]] = []
    parts: list[tuple[int, Float64, Float64, Bool, Bool, Int32, Float64]] = []
    for posture, prediction in predictions.items():
        mine = tuple(n for n, image in enumerate(images) if image.source.posture == posture)
        row, column = some_blocks(prediction.clean, budget)
        if not len(row):
            continue
        levels = np.stack([images[n].levels[row, column] for n in mine]).astype(np.float64)
        full = np.stack([images[n].saturated[row, column] for n in mine])
        sources = tuple(images[n].source for n in mine)
        sets.append(PixelSet(posture=posture, row=row, column=column, images=sources, levels=levels, saturated=full))
        numbers.append(mine)
        width = max(8, prediction.clean.shape[1] // CELLS)
        cell = (row // width) * np.int32(1000) + column // width
        for own, n in enumerate(mine):
            level = prediction.levels[images[n].source.light]
            change = (blurred(level, BLUR_PX / side) - level)[row, column].astype(np.float64) / BLUR_PX**2
            top = images[n].top[row, column].astype(np.float64)
            parts.append((n, levels[own], top, ~full[own], np.zeros(len(row), np.bool_), cell, change))
    for n, levels in _black_background(images, predictions):
        count, yes = len(levels), np.ones(len(levels), np.bool_)
        parts.append((n, levels, np.full(count, np.inf), yes, yes, np.full(count, -1, np.int32), np.zeros(count)))
    image = np.concatenate([np.full(len(one[1]), one[0], np.int32) for one in parts] or [np.zeros(0, np.int32)])
    columns = [np.concatenate(some) for some in zip(*(one[1:] for one in parts), strict=True)]
    measured, top, unsaturated, background, cell, blur = columns or [np.zeros(0)] * 6
    keys = image.astype(np.int64) * 10_000_000 + cell
    return Rows(
        sets=tuple(sets),
        numbers=tuple(numbers),
        image=image,
        measured=measured,
        top=top,
        unsaturated=unsaturated,
        background=background,
        cell=np.unique(keys, return_inverse=True)[1].astype(np.int32),
        blur=blur,
    )


def _black_background(
    images: Sequence[CoarseImage], predictions: Mapping[Posture, CoarsePrediction]
) -> list[tuple[int, Float64]]:
    # of each image the levels of blocks off the part, if they show nothing but black
    found: list[tuple[int, Float64]] = []
    means: list[float] = []
    for n, image in enumerate(images):
        row, column = some_blocks(predictions[image.source.posture].background, BACKGROUND_BLOCKS)
        if len(row) < BACKGROUND_BLOCKS // 4 or not isinstance(image.source.subtracted, float):
            return []
        levels = image.levels[row, column].astype(np.float64)
        # in four directions about the part
        cell = 2 * (row > np.median(row)) + (column > np.median(column))
        means += [float(levels[cell == c].mean()) for c in range(_EVEN_CELLS) if np.any(cell == c)]
        found.append((n, levels))
    return found if max(means) - min(means) < EVEN_LEVELS else []
