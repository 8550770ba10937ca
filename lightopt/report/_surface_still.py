"""The still picture of a coloured surface: what paper and browsers without WebGL show."""

import math

import numpy as np
from PIL import Image, ImageColor

from lightopt.core.arrays import Float64
from lightopt.geometry import RayCaster, TriangleMesh, face_normals
from lightopt.report._surface import FIELD_OF_VIEW, ColouredSurface, eye_distance

WIDTH, HEIGHT, FINE = 900, 600, 2
_BLOCK_ROWS = 128
# as in viewer.js: enough to tell the shape, and so little that colours are those of the legend
_AMBIENT, _LAMP = 0.7, 0.3


def surface_still(surface: ColouredSurface) -> Image.Image:
    """The surface in the colours of its first layer, lit from the eye, on white."""
    caster = RayCaster(surface.vertices, surface.triangles)
    eye = caster.centre + eye_distance(surface) * surface.toward
    right = np.cross(surface.up, surface.toward)
    right /= np.linalg.norm(right)
    above = np.cross(surface.toward, right)
    classes = surface.layers[0].of_face
    colours = np.array([ImageColor.getrgb(kind.colour) for kind in surface.layers[0].classes], np.float64)
    normals = face_normals(TriangleMesh(surface.vertices, surface.triangles))
    picture = np.full((HEIGHT * FINE, WIDTH * FINE, 3), 255, np.uint8)
    scale = math.tan(0.5 * FIELD_OF_VIEW) / (0.5 * HEIGHT * FINE)
    # the rectangle that has all of it
    seen = surface.vertices - eye
    depth = -scale * (seen @ surface.toward)
    left, right_end = _span(0.5 * WIDTH * FINE + (seen @ right) / depth, WIDTH * FINE)
    top, bottom = _span(0.5 * HEIGHT * FINE - (seen @ above) / depth, HEIGHT * FINE)
    across = (np.arange(left, right_end) + 0.5 - 0.5 * WIDTH * FINE) * scale
    for row in range(top, bottom, _BLOCK_ROWS):
        rows = np.arange(row, min(row + _BLOCK_ROWS, bottom))
        down = (rows + 0.5 - 0.5 * HEIGHT * FINE) * scale
        rays = (across[:, None] * right - down[:, None, None] * above - surface.toward).reshape(-1, 3)
        face = caster.first_hit(eye, rays)
        hit = np.flatnonzero(face >= 0)
        face, rays = face[hit], rays[hit]
        facing = np.abs(np.einsum("ij,ij->i", normals[face], rays)) / np.linalg.norm(rays, axis=1)
        shade = np.minimum(1.0, _AMBIENT + _LAMP * facing)
        y, x = np.divmod(hit, len(across))
        picture[rows[y], left + x] = np.floor(colours[classes[face]] * shade[:, None] + 0.5)
    return Image.fromarray(picture).reduce(FINE)


def _span(places: Float64, size: int) -> tuple[int, int]:
    # the pixels of a row or column that have all of some places
    low, high = math.floor(places.min()), math.floor(places.max()) + 1
    return min(max(low, 0), size), min(max(high, 0), size)
