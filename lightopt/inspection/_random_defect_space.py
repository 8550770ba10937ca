"""Whether a defect would lie whole and in the open where an image shows it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from lightopt.defects import PlacedDefect, radial_place, surface_coordinates
from lightopt.rendering import PosturePixels
from lightopt.scene import pixel_footprint, project

MARGIN_PX = 2.0
"""Around the outline of a defect this much must be in the open, too."""

LEAST_COSINE = math.cos(math.radians(30.0))
"""The surface turns by no more than this over a defect: beyond, the tangent plane is a poor stand-in for it."""

NEAR_PX = 4.0
"""A place is the one that a pixel sees where they are no further apart than this."""


class PixelMap:
    """The pixels of a posture's image, and which of them see what.

    Parameters
    ----------
    pixels
        From :func:`lightopt.rendering.trace_pixels`.
    """

    def __init__(self, pixels: PosturePixels) -> None:
        self.pixels = pixels
        self.index = np.full(pixels.shape, -1, np.int32)
        self.index[pixels.row, pixels.column] = np.arange(len(pixels.row), dtype=np.int32)


def lies_in_the_open(defect: PlacedDefect, seen: PixelMap) -> bool:
    """Whether an image shows all of a defect and a margin around it, off silhouettes, creases and grazing views.

    Parameters
    ----------
    defect
        Part frame.
    seen
        The image's pixels.
    """
    pixels, camera = seen.pixels, seen.pixels.view.camera
    surface = pixels.surface
    columns, rows, depth = project(camera, defect.position[None])
    if not depth[0] > 0.0 or not (np.isfinite(columns[0]) and np.isfinite(rows[0])):
        return False
    footprint = pixel_footprint(camera, float(depth[0]))
    column, row = math.floor(columns[0]), math.floor(rows[0])
    half = math.ceil(defect.reach / footprint + 2.0 * MARGIN_PX)
    height, width = pixels.shape
    if column < half or row < half or column + half >= width or row + half >= height:
        return False
    centre = seen.index[row, column]
    if centre < 0 or not pixels.clean[centre]:
        return False
    if np.linalg.norm(surface.points[centre] - defect.position) > NEAR_PX * footprint:
        return False
    window = seen.index[row - half : row + half + 1, column - half : column + half + 1]
    near = window[window >= 0]
    x, y, same = surface_coordinates(defect, surface.points[near], surface.normals[near])
    margin = 2.0 * MARGIN_PX * footprint
    wider = replace(defect.shape, length=defect.shape.length + margin, width=defect.shape.width + margin)
    own = near[same & (radial_place(wider, x, y) < 1.0)]
    return bool(
        len(own) and pixels.clean[own].all() and (surface.normals[own] @ defect.normal >= LEAST_COSINE).all()
    )
