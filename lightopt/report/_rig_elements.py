"""The things of a rig: their shapes in the world frame [mm], and a parallel view of them drawn by matplotlib.

What is parallel stays parallel, and lengths along a direction keep their ratio. The part is ray cast, softly shaded,
with its outline and its edges.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lightopt.core.arrays import Bool, Float64, UInt8, read_only
from lightopt.core.transforms import Posture, azimuth_tangent, direction, elevation_tangent
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, SurfaceLight, outlines, panel_corners, panel_grid
from lightopt.rendering import trace_samples
from lightopt.report._drawing import INK, POINT, SOFT, shortened
from lightopt.scene import PinholeCamera, Scene, pixel_directions

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# the world frame's origin and axes
ORIGIN = read_only(np.zeros(3))
X, Y, Z = map(read_only, np.eye(3))

CAMERA, LIGHT, THETA, PHI, STAGE = "#45535f", "#b07d04", "#7a2f9b", "#0a8580", "#a8324a"
AXIS_COLOURS = ("#c8321f", "#2c8a3a", "#2458b8")
LABEL = 18  # size of labels [px]
BORDER_STEPS = 24  # points per side of the image's border; a distorted lens bends it on the table
_FARTHEST = 1.5  # rays that rise from the table or graze it are cut at this many camera distances

_BASE, _EDGE = (206.0, 212.0, 220.0), (58.0, 66.0, 78.0)  # colours of the part
_FAR = 1e4  # distance of the eye in radii of the part: as good as infinite
_CREASE_COS = 0.94  # neighbouring pixels whose normals differ by more than 20° have an edge between them


@dataclass(frozen=True)
class ParallelView:
    """Orthographic view from (elevation, azimuth) [rad]; vectors are in the world frame, shape (3,)."""

    elevation: float
    azimuth: float

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
        """Where world points, shape (..., 3), lie on the picture, x right and y up, shape (..., 2); all [mm]."""
        return np.stack([points @ self.right, points @ self.up], axis=-1)

    def nearness(self, points: Float64) -> Float64:
        """How near world points [mm], shape (..., 3), are to the viewer [mm], shape (...)."""
        return points @ self.toward


def arc(centre: Float64, start: Float64, towards: Float64, angle: float, radius: float) -> Float64:
    """Points of an arc [mm], shape (n, 3): from `start` through `angle` [rad] to `towards`, two orthonormal vectors."""
    angles = np.linspace(0.0, angle, max(2, int(abs(angle) * 24)))[:, None]
    return centre + radius * (np.cos(angles) * start + np.sin(angles) * towards)


@dataclass(frozen=True)
class PartPicture:
    """The part seen from one side."""

    view: ParallelView
    corner: Float64  # place of the arrays' upper left corner on the picture [mm], shape (2,)
    pixel: float  # side of a pixel [mm]
    picture: UInt8  # RGBA, shape (side, side, 4)
    nearness: Float64  # of the surface to the viewer [mm], shape (side, side); −∞ where there is no surface

    def draw(self, axes: Axes) -> None:
        """Lay the picture over a drawing."""
        (left, top), side = self.corner, self.pixel * len(self.picture)
        axes.imshow(self.picture, extent=(left, left + side, top - side, top), zorder=2, interpolation="antialiased")

    def hides(self, points: Float64) -> Bool:
        """Whether the part stands before world points [mm], shape (n, 3); shape (n,)."""
        columns, rows = np.floor((self.view.place(points) - self.corner) * [1, -1] / self.pixel).astype(int).T
        side = len(self.nearness)
        inside = (columns >= 0) & (columns < side) & (rows >= 0) & (rows < side)
        hidden = np.zeros(len(points), dtype=bool)
        hidden[inside] = self.nearness[rows[inside], columns[inside]] > self.view.nearness(points[inside])
        return hidden


def cast_part(scene: Scene, caster: RayCaster, posture: Posture, view: ParallelView, *, side: int) -> PartPicture:
    """The scene's part at a posture, in a picture of `side` pixels a side; `caster` is of the part's own frame."""
    rotation, translation = scene.stage.transform(posture)
    centre = rotation @ caster.centre + translation
    pixel, distance = 2.0 * caster.radius / (side - 4), _FAR * caster.radius
    camera = PinholeCamera(
        position=centre + distance * view.toward,
        right=view.right,
        up=view.up,
        forward=-view.toward,
        width=side,
        height=side,
        pixel_size=pixel,
        image_distance=distance,
    ).moved(rotation.T, -rotation.T @ translation)
    nearness, normals = np.full(side * side, -np.inf), np.zeros((side * side, 3))
    rows, columns = (part.astype(np.float64) + 0.5 for part in np.divmod(np.arange(side * side), side))
    hits, surface = trace_samples(caster, scene.mesh, camera, columns, rows, neighbours=True)
    nearness[hits.ray] = view.nearness(surface.points @ rotation.T + translation)
    # backs of faces are shown like fronts: this is a drawing, not an image
    facing = np.where(np.einsum("ij,ij->i", surface.normals, surface.views) < 0.0, -1.0, 1.0)
    normals[hits.ray] = (surface.normals * facing[:, None]) @ rotation.T
    nearness, normals = nearness.reshape(side, side), normals.reshape(side, side, 3)
    corner = view.place(centre) + 0.5 * side * pixel * np.array([-1.0, 1.0])
    return PartPicture(view, corner, pixel, _shade(view, nearness, normals, pixel), nearness)


def _shade(view: ParallelView, nearness: Float64, normals: Float64, pixel: float) -> UInt8:
    from scipy.ndimage import binary_dilation  # takes long to import

    hit = np.isfinite(nearness)
    lamp = view.toward + 0.9 * view.up - 0.7 * view.right
    light = 0.62 + 0.38 * np.clip(normals @ (lamp / np.linalg.norm(lamp)), 0.0, 1.0)
    # outline, jumps in depth and creases
    edge, depth = np.zeros(hit.shape, dtype=bool), np.where(hit, nearness, 0.0)
    for axis in (0, 1):
        edges, hits, depths, facets = (array.swapaxes(0, axis) for array in (edge, hit, depth, normals))
        facing = np.einsum("ijk,ijk->ij", facets[:-1], facets[1:])
        # what lies farther back than the slope of the surface explains is another surface
        jump = np.abs(depths[:-1] - depths[1:]) > 36.0 * pixel
        edges[:-1] |= (hits[:-1] != hits[1:]) | (hits[:-1] & hits[1:] & ((facing < _CREASE_COS) | jump))
    edge = np.asarray(binary_dilation(edge, np.ones((3, 3), bool)), bool)
    colours = np.where(edge[..., None], _EDGE, np.array(_BASE) * light[..., None])
    alpha = np.where(hit | edge, 255.0, 0.0)
    return np.floor(np.concatenate([colours, alpha[..., None]], axis=2) + 0.5).astype(np.uint8)


@dataclass(frozen=True)
class CameraShape:
    """A camera to draw, in the world frame [mm]; corners from the image's top left clockwise."""

    aperture: Float64  # front of its frustum, whose apex is the pinhole, shape (4, 3)
    body: Float64  # corners of the housing behind the pinhole, four at the front, four at the back, shape (8, 3)
    footprint: Float64  # where the image's border meets the table, `BORDER_STEPS` points per side, shape (n, 3)
    arrow: float  # length of the arrows for image right and up


def camera_shape(camera: PinholeCamera, size: float) -> CameraShape:
    """Shapes of a camera whose frustum is `size` long [mm]."""
    ends = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * (camera.width, camera.height)
    t = np.arange(BORDER_STEPS)[:, None] / BORDER_STEPS
    pixels = np.concatenate([(1.0 - t) * ends[i] + t * ends[(i + 1) % 4] for i in range(4)])
    border = pixel_directions(camera, pixels[:, 0], pixels[:, 1])
    distance = float(np.linalg.norm(camera.position))
    slope = np.minimum(border[:, 2], -1e-12)
    reach = np.minimum(-camera.position[2] / slope, _FARTHEST * distance / np.linalg.norm(border, axis=1))
    reach = np.where(reach > 0.0, reach, _FARTHEST * distance)
    footprint = camera.position + reach[:, None] * border
    width, height = camera.width * camera.pixel_size, camera.height * camera.pixel_size
    half = 0.34 * size / max(width, height) * np.array([width, height])
    signs = ((-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0))
    corners = np.array([sx * half[0] * camera.right + sy * half[1] * camera.up for sx, sy in signs])
    front = camera.position + 0.75 * size * camera.forward + corners
    # the housing is as large as the frustum's opening; it is a sign, the true optics are the pyramid
    body = np.concatenate([camera.position + corners * 0.8, camera.position + corners * 0.8 - size * camera.forward])
    return CameraShape(aperture=front, body=body, footprint=footprint, arrow=1.1 * size)


def foot_direction(light: PanelLight) -> Float64:
    """Unit vector in the table plane at the light's azimuth, shape (3,)."""
    return np.array([math.cos(light.azimuth), math.sin(light.azimuth), 0.0])


def part_box(scene: Scene, posture: Posture) -> Float64:
    """Corners of the part's own bounding box at a posture [mm], shape (8, 3)."""
    corners = np.array(list(itertools.product(*scene.mesh.bounds.T)))
    rotation, translation = scene.stage.transform(posture)
    return corners @ rotation.T + translation


def rig_size(scene: Scene) -> float:
    """Distance of the farthest light or, without lights away from the origin, of the camera [mm]: sizes signs."""
    return max((light.distance for light in scene.lights), default=0.0) or float(np.linalg.norm(scene.camera.position))


def square(half: float, centre: Float64) -> Float64:
    """Corners of a square of the table plane around a place [mm], shape (4, 3); `half` a side long."""
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return np.column_stack([centre[:2] + half * signs, np.zeros(4)])


def round_up(half: float) -> tuple[float, float]:
    """Half a side of at least `half`, a multiple of a round step of about a fifth of it, and that step [mm]."""
    power = 10.0 ** math.floor(math.log10(half / 5.0))
    step = next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= half / 5.0 * 0.999)
    return math.ceil(half / step - 1e-9) * step, step


@dataclass(frozen=True)
class Pen:
    """Draws world shapes [mm] one over the other; of lines, what stands behind the part is left out."""

    axes: Axes  # places on the picture [mm], equal along x and y
    view: ParallelView
    part: PartPicture | None = None  # the part's picture, once it is known

    def __post_init__(self) -> None:
        self.axes.set_aspect("equal", adjustable="datalim")

    def line(self, points: Float64, colour: str, width: float = 1.5, dash: str = "-") -> None:
        """Draw a polyline of shape (n, 3); `width` in [px]."""
        for piece in self._visible(np.asarray(points, np.float64)):
            style: dict[str, Any] = {"linewidth": width * POINT, "linestyle": dash, "zorder": 2}
            self.axes.plot(*self.view.place(piece).T, color=colour, **style)

    def arrow(self, points: Float64, colour: str, width: float = 2.2) -> None:
        """Draw a polyline of shape (n, 3) that ends in an arrow head."""
        self.line(points, colour, width)
        start, tip = self.view.place(np.stack([0.1 * points[-2] + 0.9 * points[-1], points[-1]]))
        head: dict[str, Any] = {"arrowstyle": "-|>,head_length=0.9,head_width=0.27", "mutation_scale": 14.0 * POINT}
        head |= {"color": colour, "linewidth": width * POINT, "shrinkA": 0.0, "shrinkB": 0.0}
        if self.part is None or not self.part.hides(points[-1:])[0]:
            self.axes.annotate("", tip.tolist(), start.tolist(), arrowprops=head, zorder=2)

    def polygon(self, points: Float64, *, fill: str, outline: str = "none", width: float = 1.5) -> None:
        """Draw an area of shape (n, 3); a fill of the form ``#rrggbbaa`` is translucent."""
        style: dict[str, Any] = {"facecolor": fill, "edgecolor": outline, "linewidth": width * POINT, "zorder": 2}
        self.axes.fill(*self.view.place(points).T, **style)

    def label(self, text: str, anchor: Float64, colour: str, *, away_from: Float64) -> None:
        """Name a place [mm], shape (3,), on the side turned away from another one."""
        from matplotlib.patheffects import withStroke

        at, other = self.view.place(anchor), self.view.place(away_from)
        away = (at - other) / max(float(np.linalg.norm(at - other)), 1e-9)
        x, y = (int(np.rint(1.2 * side)) for side in away)
        style: dict[str, Any] = {"ha": ("center", "left", "right")[x], "va": ("center", "bottom", "top")[y]}
        style |= {"color": colour, "path_effects": [withStroke(linewidth=0.3 * LABEL * POINT, foreground="#ffffff")]}
        offset = (8.0 * POINT * away).tolist()
        self.axes.annotate(text, at.tolist(), offset, textcoords="offset points", fontsize=LABEL * POINT, **style)

    def grid(self, half: float, step: float, centre: Float64 = ORIGIN) -> None:
        """Draw the table plane around a place as a grid; `half` a side is a multiple of the step [mm]."""
        middle = centre * [1, 1, 0]
        self.polygon(square(half, centre), fill="#f7f8fa")
        for at in np.linspace(-half, half, round(2.0 * half / step) + 1):
            for along, across in ((X, Y), (Y, X)):
                self.line(middle + np.stack([at * along - half * across, at * along + half * across]), "#dfe3e8", 1.0)

    def axes_of_world(self, lengths: Sequence[float]) -> None:
        """Draw the world's axes from the origin."""
        for axis, length, name, colour in zip(np.eye(3), lengths, "XYZ", AXIS_COLOURS, strict=True):
            self.named_arrow(ORIGIN, length * axis, name, colour)

    def named_arrow(self, start: Float64, tip: Float64, name: str, colour: str) -> None:
        """Draw an arrow, and its name at the tip."""
        self.arrow(np.stack([start, tip]), colour, 2.6)
        self.label(name, tip, colour, away_from=start)

    def panel(self, light: PanelLight) -> None:
        """Draw a panel as its true rectangle, its point lights on the side that shines, and the line to the origin."""
        shines_here = float(light.outward @ self.view.toward) < 0.0
        self.line(np.stack([ORIGIN, light.centre]), LIGHT, 1.2)
        if np.hypot(*light.centre[:2]) > 0.02 * light.distance:
            self.line(np.stack([light.centre, light.centre * [1, 1, 0]]), SOFT, 1.0, dash=":")
        if isinstance(light, SurfaceLight):
            self.surface(light)
        else:
            fill = "#ffd766e0" if shines_here else "#cfa54de0"
            self.polygon(panel_corners(light), fill=fill, outline=LIGHT, width=2.0)
        if shines_here and light.points != "auto" and light.points <= 64:
            points = self.view.place(panel_grid(light, light.points))
            self.axes.plot(*points.T, "o", color=LIGHT, markersize=3.4 * POINT, zorder=2)
        outer = max(outlines(light).reshape(-1, 3), key=lambda corner: float(corner @ self.view.up))
        self.label(shortened(light.name, 20), outer, INK, away_from=light.centre)

    def surface(self, light: SurfaceLight) -> None:
        """Draw the pieces of a light's surface, the far ones first; where it shines to the viewer they are brighter."""
        radiance = light.elements[:, 21]
        own = radiance > 0.5 * radiance.max()  # without what a dome's wall scatters
        pieces, sides = outlines(light)[own], light.elements[own, 20]
        for number in np.argsort(self.view.nearness(pieces.mean(axis=1))):
            corners = pieces[number]
            normal = sides[number] * np.cross(corners[2] - corners[0], corners[3] - corners[1])
            fill = "#ffd76680" if float(normal @ self.view.toward) > 0.0 else "#cfa54d60"
            self.polygon(corners, fill=fill, outline="#b07d0480", width=0.8)

    def azimuth_arc(self, light: PanelLight, radius: float, *, spoke: float) -> None:
        """Draw the azimuth φ from +X in the table plane, and its direction as far as `spoke` [mm]."""
        path = arc(ORIGIN, X, Y, light.azimuth, radius)
        for end in (light.centre * [1, 1, 0], max(radius, spoke) * foot_direction(light)):
            self.line(np.stack([ORIGIN, end]), SOFT, 1.0, dash=":")
        self.arrow(path, PHI, 1.8)
        self.label(f"φ {degrees(light.azimuth)}", path[-1], PHI, away_from=ORIGIN)

    def elevation_arc(self, light: PanelLight, radius: float) -> None:
        """Draw the elevation θ from the table plane."""
        path = arc(ORIGIN, foot_direction(light), Z, light.elevation, radius)
        self.arrow(path, THETA, 1.8)
        self.label(f"θ {degrees(light.elevation)}", path[len(path) // 2], THETA, away_from=ORIGIN)

    def panel_frame(self, light: PanelLight, length: float) -> None:
        """Draw the sides' directions e_φ and e_θ at a panel."""
        self.named_arrow(light.centre, light.centre + length * light.across, "e_φ", PHI)
        self.named_arrow(light.centre, light.centre + length * light.along, "e_θ", THETA)

    def camera(self, camera: PinholeCamera, shape: CameraShape) -> None:
        """Draw the camera, its viewing pyramid down to the table and the directions of its image."""
        for corner in shape.footprint[::BORDER_STEPS]:
            self.line(np.stack([camera.position, corner]), CAMERA, 1.1, dash="--")
        front, back = shape.body[:4], shape.body[4:]
        faces = [back, front, *(np.stack([front[i], front[i - 1], back[i - 1], back[i]]) for i in range(4))]
        sides = [np.stack([camera.position, shape.aperture[i - 1], shape.aperture[i]]) for i in range(4)]
        for some, fill in ((faces, "#d9e0e6"), (sides, f"{CAMERA}30")):
            for face in sorted(some, key=lambda f: float(self.view.nearness(f.mean(axis=0)))):
                self.polygon(face, fill=fill, outline=CAMERA, width=1.5)
        self.label("camera", back.mean(axis=0), CAMERA, away_from=camera.position)
        for name, vector in (("image right", camera.right), ("image up", camera.up)):
            self.named_arrow(camera.position, camera.position + shape.arrow * vector, name, CAMERA)

    def _visible(self, points: Float64) -> list[Float64]:
        """Pieces of a polyline that the part does not hide."""
        if self.part is None:
            return [points]
        steps = np.linalg.norm(np.diff(self.view.place(points), axis=0), axis=1)
        travelled = np.concatenate([[0.0], np.cumsum(steps)])
        at = np.union1d(travelled, np.arange(0.0, travelled[-1], self.part.pixel))
        dense = np.stack([np.interp(at, travelled, points[:, axis]) for axis in range(3)], axis=1)
        hidden = self.part.hides(dense)
        breaks = np.flatnonzero(np.diff(hidden.astype(np.int8))) + 1
        pieces = zip(np.split(dense, breaks), np.split(hidden, breaks), strict=True)
        return [piece for piece, out in pieces if not out[0] and len(piece) > 1]


def degrees(angle: float) -> str:
    """An angle [rad] as it is written in files, with a true minus sign."""
    return f"{round(math.degrees(angle), 6) + 0.0:.5g}°".replace("-", "−")
