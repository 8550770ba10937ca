"""The still picture of a coloured surface: what paper and browsers without WebGL show."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor

from lightopt.raycast import RayCaster
from lightopt.report._surface import ColouredSurface

__all__ = ["eye_distance", "surface_still"]

FIELD_OF_VIEW = math.radians(30.0)
"""From the lower to the upper edge; viewer.js has the same."""

WIDTH, HEIGHT, FINE = 900, 600, 2
_BLOCK = 250_000
_AMBIENT, _LAMP = 0.7, 0.3
"""As in viewer.js: enough to tell the shape, and so little that colours are those of the legend."""


def eye_distance(surface: ColouredSurface) -> float:
    """From the middle of the surface's bounding box to the eye, so that the surface fits however it is turned [mm]."""
    middle = 0.5 * (surface.vertices.min(axis=0) + surface.vertices.max(axis=0))
    radius = float(np.linalg.norm(surface.vertices - middle, axis=1).max())
    return 1.02 * max(radius, 1e-6) / math.sin(0.5 * FIELD_OF_VIEW)


def surface_still(surface: ColouredSurface) -> Image.Image:
    """The surface in the colours of its first layer, lit from the eye, on white."""
    caster = RayCaster(surface.vertices, surface.triangles)
    eye = caster.centre + eye_distance(surface) * surface.toward
    right = np.cross(surface.up, surface.toward)
    right /= np.linalg.norm(right)
    above = np.cross(surface.toward, right)
    classes = surface.layers[0].of_face
    colours = np.array([ImageColor.getrgb(kind.colour) for kind in surface.layers[0].classes], np.float64)
    picture = np.full((WIDTH * HEIGHT * FINE * FINE, 3), 255, np.uint8)
    scale = math.tan(0.5 * FIELD_OF_VIEW) / (0.5 * HEIGHT * FINE)
    for start in range(0, len(picture), _BLOCK):
        index = np.arange(start, min(start + _BLOCK, len(picture)))
        rows, columns = np.divmod(index, WIDTH * FINE)
        across = (columns + 0.5 - 0.5 * WIDTH * FINE) * scale
        down = (rows + 0.5 - 0.5 * HEIGHT * FINE) * scale
        rays = across[:, None] * right - down[:, None] * above - surface.toward
        face = caster.first_hit(eye, rays)
        hit = np.flatnonzero(face >= 0)
        facing = _facing(surface, face[hit], rays[hit])
        shade = np.minimum(1.0, _AMBIENT + _LAMP * facing)
        picture[index[hit]] = np.floor(colours[classes[face[hit]]] * shade[:, None] + 0.5)
    return Image.fromarray(picture.reshape(HEIGHT * FINE, WIDTH * FINE, 3)).reduce(FINE)


def _facing(
    surface: ColouredSurface, face: NDArray[np.int32], rays: NDArray[np.float64]
) -> NDArray[np.float64]:
    a, b, c = np.moveaxis(surface.vertices[surface.triangles[face]], 1, 0)
    normals = np.cross(b - a, c - a)
    cosine = np.abs(np.einsum("ij,ij->i", normals, rays))
    return cosine / np.maximum(np.linalg.norm(normals, axis=1) * np.linalg.norm(rays, axis=1), 1e-300)
