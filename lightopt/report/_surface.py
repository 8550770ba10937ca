"""A surface whose faces belong to classes: a value object, made small for a page, as text and as a still picture.

Paper and browsers without WebGL show the still picture, all others what viewer.js makes of the text.

The text is a head in JSON, and base64 of a zlib stream of, little-endian and in this order: the faces' corners as
int32, the vertices as int16 in steps of ``step_mm`` from the middle of the bounding box, and one uint8 per face and
layer. Corners and vertices are written column after column, each value as the difference from the one before, which
packs well.
"""

import base64
import json
import math
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor

from lightopt.core.arrays import Float64, Int32, UInt8, read_only
from lightopt.core.errors import InputError
from lightopt.geometry import RayCaster, TriangleMesh, face_normals
from lightopt.scene import PinholeCamera

FIELD_OF_VIEW = math.radians(30.0)  # of the first view, from the lower to the upper edge; viewer.js has the same
_STEPS = 32767  # of a vertex's place in the data, to either side of the middle
STILL_WIDTH, STILL_HEIGHT, FINE = 900, 600, 2  # size of the still picture [px], which is cast so many times as fine
_BLOCK_ROWS = 128
# as in viewer.js: enough to tell the shape, and so little that colours are those of the legend
_AMBIENT, _LAMP = 0.7, 0.3

# of more than these a report shows a simplified surface, so that the file stays small and the view turns smoothly
MOST_TRIANGLES = 500_000


@dataclass(frozen=True, kw_only=True)
class SurfaceClass:
    """What some faces have in common, as the legend shows it."""

    label: str
    colour: str  # #rrggbb
    amount: str = ""  # how much of the surface it is; may be empty


def surface_classes(kinds: Iterable[tuple[str, str]], amounts: Iterable[str]) -> tuple[SurfaceClass, ...]:
    """Classes of these labels and colours, and how much of the surface each is."""
    pairs = zip(kinds, amounts, strict=True)
    return tuple(SurfaceClass(label=label, colour=colour, amount=amount) for (label, colour), amount in pairs)


@dataclass(frozen=True, kw_only=True)
class SurfaceLayer:
    name: str
    classes: tuple[SurfaceClass, ...]
    of_face: UInt8  # class of each face, index into `classes`, shape (m,)
    group: str = ""  # heading above neighbouring layers of one kind; may be empty

    def __post_init__(self) -> None:
        if self.of_face.dtype != np.uint8 or (self.of_face.size and int(self.of_face.max()) >= len(self.classes)):
            found = f"{self.of_face.dtype} up to {self.of_face.max() if self.of_face.size else 'nothing'}"
            raise InputError(f"layer {self.name}: expected uint8 below {len(self.classes)}, found {found}")
        object.__setattr__(self, "of_face", read_only(self.of_face))


@dataclass(frozen=True, kw_only=True)
class ColouredSurface:
    """A triangle mesh and the ways to colour it."""

    vertices: Float64  # in any right-handed frame [mm], shape (n, 3)
    triangles: Int32  # corners of the faces, indices into `vertices`, shape (m, 3)
    layers: tuple[SurfaceLayer, ...]  # at least one; the first is shown first
    up: Float64  # unit vector of what points up, shape (3,)
    toward: Float64  # unit vector to where the surface is seen from first, shape (3,)

    def __post_init__(self) -> None:
        for layer in self.layers:
            if len(layer.of_face) != len(self.triangles):
                raise InputError(f"layer {layer.name}: {len(layer.of_face)} classes for {len(self.triangles)} faces")
        for name in ("vertices", "triangles", "up", "toward"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


def simplified(surface: ColouredSurface, *, most: int = MOST_TRIANGLES) -> tuple[ColouredSurface, float]:
    """The surface with `most` faces or fewer, and the grid that its vertices were moved to [mm]; 0 where they were not.

    Vertices are clustered on a cubic grid (Rossignac and Borrel, 1993), as fine as the number of faces allows; faces
    whose corners fall together go, the others keep their classes.
    """
    if len(surface.triangles) <= most:
        return surface, 0.0
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    # a face of the size of a grid's cell: so many cover the surface about once
    cell = float(np.linalg.norm(high - low)) / math.sqrt(2.0 * most)
    while True:
        places = np.rint((surface.vertices - low) / cell).astype(np.int64)
        sides = places.max(axis=0) + 1
        keys = (places[:, 0] * sides[1] + places[:, 1]) * sides[2] + places[:, 2]
        _, first, cluster = np.unique(keys, return_index=True, return_inverse=True)
        moved = cluster.reshape(-1).astype(np.int32)[surface.triangles]
        a, b, c = moved.T
        left = np.flatnonzero((a != b) & (b != c) & (c != a))
        # faces that fell onto each other: the first one stays
        _, unique = np.unique(np.sort(moved[left], axis=1), axis=0, return_index=True)
        left = left[np.sort(unique)]
        if len(left) <= most:
            break
        cell *= max(1.05, math.sqrt(len(left) / most))
    layers = tuple(replace(layer, of_face=layer.of_face[left]) for layer in surface.layers)
    return replace(surface, vertices=low + places[first] * cell, triangles=moved[left], layers=layers), cell


def eye_distance(surface: ColouredSurface) -> float:
    """From the middle of the surface's bounding box to the eye, so that the surface fits however it is turned [mm]."""
    radius = float(np.linalg.norm(surface.vertices - _middle(surface), axis=1).max())
    return 1.02 * max(radius, 1e-6) / math.sin(0.5 * FIELD_OF_VIEW)


def standing_surface(
    vertices: Float64, triangles: Int32, layers: tuple[SurfaceLayer, ...], camera: PinholeCamera
) -> ColouredSurface:
    """A surface in the world frame, seen first towards the camera, but a third aside, which shows sides, too."""
    mixed = camera.position / np.linalg.norm(camera.position) + np.array([0.35, -0.9, 0.0])
    toward, up = mixed / np.linalg.norm(mixed), np.array([0.0, 0.0, 1.0])
    return ColouredSurface(vertices=vertices, triangles=triangles, layers=layers, up=up, toward=toward)


def surface_head(surface: ColouredSurface) -> str:
    """What the viewer has to know before it unpacks the data, JSON without ``<``."""
    head = {
        "triangles": len(surface.triangles),
        "vertices": len(surface.vertices),
        "step_mm": _step(surface),
        "distance_mm": eye_distance(surface),
        "up": surface.up.tolist(),
        "toward": surface.toward.tolist(),
        "layers": [[kind.colour for kind in layer.classes] for layer in surface.layers],
    }
    return json.dumps(head)


def surface_data(surface: ColouredSurface) -> str:
    places = np.rint((surface.vertices - _middle(surface)) / _step(surface)).astype(np.int16)
    columns = _differences(surface.triangles.astype(np.int32)).astype("<i4"), _differences(places).astype("<i2")
    data = b"".join(array.tobytes() for array in (*columns, *(layer.of_face for layer in surface.layers)))
    return base64.b64encode(zlib.compress(data, 6)).decode("ascii")


def _differences(values: NDArray[np.signedinteger]) -> NDArray[np.signedinteger]:
    # int16 wraps round, here and in the viewer, and so comes back right
    columns = np.ascontiguousarray(values.T)
    return np.diff(columns, axis=1, prepend=np.zeros((3, 1), columns.dtype))


def _middle(surface: ColouredSurface) -> Float64:
    return 0.5 * (surface.vertices.min(axis=0) + surface.vertices.max(axis=0))


def _step(surface: ColouredSurface) -> float:
    return max(0.5 * float(np.ptp(surface.vertices, axis=0).max()), 1e-9) / _STEPS


def surface_still(surface: ColouredSurface) -> Image.Image:
    """The surface in the colours of its first layer, lit from the eye, on white."""
    width, height = STILL_WIDTH * FINE, STILL_HEIGHT * FINE
    caster = RayCaster(surface.vertices, surface.triangles)
    eye = caster.centre + eye_distance(surface) * surface.toward
    right = np.cross(surface.up, surface.toward)
    right /= np.linalg.norm(right)
    above = np.cross(surface.toward, right)
    classes = surface.layers[0].of_face
    colours = np.array([ImageColor.getrgb(kind.colour) for kind in surface.layers[0].classes], np.float64)
    normals = face_normals(TriangleMesh(surface.vertices, surface.triangles))
    picture = np.full((height, width, 3), 255, np.uint8)
    scale = math.tan(0.5 * FIELD_OF_VIEW) / (0.5 * height)
    # the rectangle that has all of it
    seen = surface.vertices - eye
    depth = -scale * (seen @ surface.toward)
    left, right_end = _span(0.5 * width + (seen @ right) / depth, width)
    top, bottom = _span(0.5 * height - (seen @ above) / depth, height)
    across = (np.arange(left, right_end) + 0.5 - 0.5 * width) * scale
    for row in range(top, bottom, _BLOCK_ROWS):
        rows = np.arange(row, min(row + _BLOCK_ROWS, bottom))
        down = (rows + 0.5 - 0.5 * height) * scale
        rays = (across[:, None] * right - down[:, None, None] * above - surface.toward).reshape(-1, 3)
        face = caster.first_hit(eye, rays, neighbours=True)
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
