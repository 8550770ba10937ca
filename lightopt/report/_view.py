"""A parallel view of the world, and the part as it shows it: ray cast, softly shaded, with its outline and its edges.

What is parallel stays parallel, and lengths along a direction keep their ratio.
"""

from dataclasses import dataclass, replace

import numpy as np
from PIL import Image

from lightopt.core.arrays import Bool, Float64, UInt8, read_only
from lightopt.core.transforms import Posture, azimuth_tangent, direction, elevation_tangent
from lightopt.geometry import RayCaster
from lightopt.rendering import trace_samples
from lightopt.report._drawing import Box, Drawing
from lightopt.scene import PinholeCamera, Scene

# the world frame's origin and axes
ORIGIN = read_only(np.zeros(3))
X, Y, Z = map(read_only, np.eye(3))

FINE = 3  # the part is cast at so many times the resolution of the drawing
_BASE = (206.0, 212.0, 220.0)
_EDGE = (58.0, 66.0, 78.0)
_FAR = 1e4  # distance of the eye in radii of the part: as good as infinite
_BLOCK = 200_000  # rays at once: bounds the memory
_CREASE_COS = 0.94  # neighbouring pixels whose normals differ by more than 20° have an edge between them


@dataclass(frozen=True)
class ParallelView:
    """Orthographic view from (elevation, azimuth) [rad]; vectors are in the world frame, shape (3,)."""

    elevation: float
    azimuth: float
    scale: float  # [px/mm]
    offset: Float64  # where the world's origin lies on the picture [px], shape (2,)

    @property
    def right(self) -> Float64:
        """Unit vector to the right on the picture."""
        return azimuth_tangent(azimuth=self.azimuth)

    @property
    def up(self) -> Float64:
        """Unit vector up on the picture."""
        return elevation_tangent(elevation=self.elevation, azimuth=self.azimuth)

    @property
    def toward(self) -> Float64:
        """Unit vector towards the viewer."""
        return direction(elevation=self.elevation, azimuth=self.azimuth)

    def place(self, points: Float64) -> Float64:
        """Where world points [mm], shape (..., 3), lie on the picture [px], x right and y down, shape (..., 2)."""
        points = np.asarray(points, dtype=np.float64)
        return self.offset + self.scale * np.stack([points @ self.right, -(points @ self.up)], axis=-1)

    def nearness(self, points: Float64) -> Float64:
        """How near world points [mm], shape (..., 3), are to the viewer [mm], shape (...)."""
        return np.asarray(points, dtype=np.float64) @ self.toward


def fit_view(points: Float64, *, elevation: float, azimuth: float, box: Box) -> ParallelView:
    """The largest view that shows all points [mm], shape (n, 3), centred in a box (left, top, right, bottom) [px]."""
    unit = ParallelView(elevation=elevation, azimuth=azimuth, scale=1.0, offset=np.zeros(2))
    flat = unit.place(points)
    low, high = flat.min(axis=0), flat.max(axis=0)
    corners = np.array(box).reshape(2, 2)
    room = corners[1] - corners[0]
    scale = float(np.min(room / np.maximum(high - low, 1e-9)))
    return replace(unit, scale=scale, offset=corners.mean(axis=0) - scale * 0.5 * (low + high))


def arc(centre: Float64, start: Float64, towards: Float64, angle: float, radius: float) -> Float64:
    """Points of an arc [mm], shape (n, 3): from `start` through `angle` [rad] to `towards`, two orthonormal vectors."""
    angles = np.linspace(0.0, angle, max(2, int(abs(angle) * 24)))[:, None]
    return centre + radius * (np.cos(angles) * start + np.sin(angles) * towards)


@dataclass(frozen=True)
class PartPicture:
    """The part seen from one side, :data:`FINE` times as fine as the drawing."""

    view: ParallelView
    left: int  # of the arrays' upper left corner [fine px]
    top: int
    picture: UInt8  # RGBA, shape (rows, columns, 4)
    nearness: Float64  # of the surface to the viewer [mm], shape (rows, columns); −∞ where there is no surface

    def draw(self, drawing: Drawing) -> None:
        """Lay the picture over a drawing."""
        (left, before), (top, above) = divmod(self.left, FINE), divmod(self.top, FINE)
        whole = np.pad(self.picture, ((above, 0), (before, 0), (0, 0)))
        drawing.picture(np.asarray(Image.fromarray(whole).reduce(FINE)), left, top)

    def hides(self, points: Float64) -> Bool:
        """Whether the part stands before world points [mm], shape (n, 3); shape (n,)."""
        flat = self.view.place(points) * FINE
        columns, rows = np.floor(flat).astype(int).T - [[self.left], [self.top]]
        height, width = self.nearness.shape
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        hidden = np.zeros(len(points), dtype=bool)
        surface = self.nearness[rows[inside], columns[inside]]
        hidden[inside] = surface > self.view.nearness(points[inside])
        return hidden


def cast_part(scene: Scene, caster: RayCaster, posture: Posture, view: ParallelView) -> PartPicture:
    """The scene's part at a posture, as a view shows it; `caster` is of the part in its own frame."""
    rotation, translation = scene.stage.transform(posture)
    centre = rotation @ caster.centre + translation
    half = int(np.ceil(caster.radius * view.scale * FINE)) + 2
    middle = np.round(view.place(centre) * FINE).astype(int)
    distance = _FAR * caster.radius
    camera = PinholeCamera(
        position=centre + distance * view.toward,
        right=view.right,
        up=view.up,
        forward=-view.toward,
        width=2 * half,
        height=2 * half,
        pixel_size=1.0 / (view.scale * FINE),
        image_distance=distance,
    ).moved(rotation.T, -rotation.T @ translation)
    # the middle of this image is the centre exactly; on the picture it is rounded to whole fine pixels
    nearness, normals = np.full(4 * half * half, -np.inf), np.zeros((4 * half * half, 3))
    for start in range(0, len(nearness), _BLOCK):
        index = np.arange(start, min(start + _BLOCK, len(nearness)))
        rows, columns = (part.astype(np.float64) + 0.5 for part in np.divmod(index, 2 * half))
        hits, surface = trace_samples(caster, scene.mesh, camera, columns, rows, neighbours=True)
        found = index[hits.ray]
        nearness[found] = view.nearness(surface.points @ rotation.T + translation)
        # backs of faces are shown like fronts: this is a drawing, not an image
        facing = np.where(np.einsum("ij,ij->i", surface.normals, surface.views) < 0.0, -1.0, 1.0)
        normals[found] = (surface.normals * facing[:, None]) @ rotation.T
    nearness = nearness.reshape(2 * half, 2 * half)
    picture = _shade(view, nearness, normals.reshape(2 * half, 2 * half, 3))
    return PartPicture(view, int(middle[0]) - half, int(middle[1]) - half, picture, nearness)


def _shade(view: ParallelView, nearness: Float64, normals: Float64) -> UInt8:
    hit = np.isfinite(nearness)
    lamp = view.toward + 0.9 * view.up - 0.7 * view.right
    light = 0.62 + 0.38 * np.clip(normals @ (lamp / np.linalg.norm(lamp)), 0.0, 1.0)
    edge = _edges(hit, nearness, normals, step=3.0 / (view.scale * FINE))
    colours = np.where(edge[..., None], _EDGE, np.array(_BASE) * light[..., None])
    alpha = np.where(hit | edge, 255.0, 0.0)
    return np.floor(np.concatenate([colours, alpha[..., None]], axis=2) + 0.5).astype(np.uint8)


def _edges(hit: Bool, nearness: Float64, normals: Float64, *, step: float) -> Bool:
    # outline, jumps in depth and creases, FINE pixels wide
    from scipy.ndimage import binary_dilation  # takes long to import

    edge, depth = np.zeros(hit.shape, dtype=bool), np.where(hit, nearness, 0.0)
    for axis in (0, 1):
        edges, hits, depths, facets = (array.swapaxes(0, axis) for array in (edge, hit, depth, normals))
        both = hits[:-1] & hits[1:]
        facing = np.einsum("ijk,ijk->ij", facets[:-1], facets[1:])
        # what lies farther back than the slope of the surface explains is another surface
        jump = np.abs(depths[:-1] - depths[1:]) > 12.0 * step
        edges[:-1] |= (hits[:-1] != hits[1:]) | (both & ((facing < _CREASE_COS) | jump))
    return np.asarray(binary_dilation(edge, np.ones((FINE, FINE), bool)), bool)
