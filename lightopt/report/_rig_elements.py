"""The things of a rig: their shapes in the world frame [mm], and a parallel view of them drawn by matplotlib.

What is parallel stays parallel, and lengths along a direction keep their ratio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lightopt.core.arrays import Float64, read_only
from lightopt.core.transforms import Posture, azimuth_tangent, direction, elevation_tangent
from lightopt.geometry import TriangleMesh, face_normals
from lightopt.lights import PanelLight, SurfaceLight, outlines, panel_corners, panel_grid
from lightopt.report._pictures import INK, POINT, SOFT, shortened
from lightopt.report._surface import ColouredSurface, simplified
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

PART = np.array([206.0, 212.0, 220.0]) / 255.0  # colour of the part where it is lit most
MOST_FACES = 30_000  # of the part; more are simplified


@dataclass(frozen=True)
class ParallelView:
    """Orthographic view from (elevation, azimuth) [rad]; vectors are in the world frame, shape (3,)."""

    elevation: float
    azimuth: float

    @property
    def right(self) -> Float64:
        return azimuth_tangent(azimuth=self.azimuth)

    @property
    def up(self) -> Float64:
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
    return np.array([math.cos(light.azimuth), math.sin(light.azimuth), 0.0])


def part_box(scene: Scene, posture: Posture) -> Float64:
    """Corners of the part's own bounding box at a posture [mm], shape (8, 3)."""
    corners = scene.mesh.box_corners
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
    """Draws world shapes [mm] one over the other."""

    axes: Axes  # places on the picture [mm], equal along x and y
    view: ParallelView

    def __post_init__(self) -> None:
        self.axes.set_aspect("equal", adjustable="datalim")

    def line(self, points: Float64, colour: str, width: float = 1.5, dash: str = "-") -> None:
        """Draw a polyline of shape (n, 3); `width` in [px]."""
        style: dict[str, Any] = {"linewidth": width * POINT, "linestyle": dash, "zorder": 2}
        self.axes.plot(*self.view.place(points).T, color=colour, **style)

    def arrow(self, points: Float64, colour: str, width: float = 2.2) -> None:
        """Draw a polyline of shape (n, 3) that ends in an arrow head."""
        self.line(points, colour, width)
        start, tip = self.view.place(np.stack([0.1 * points[-2] + 0.9 * points[-1], points[-1]]))
        head: dict[str, Any] = {"arrowstyle": "-|>,head_length=0.9,head_width=0.27", "mutation_scale": 14.0 * POINT}
        head |= {"color": colour, "linewidth": width * POINT, "shrinkA": 0.0, "shrinkB": 0.0}
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
        for axis, length, name, colour in zip(np.eye(3), lengths, "XYZ", AXIS_COLOURS, strict=True):
            self.named_arrow(ORIGIN, length * axis, name, colour)

    def named_arrow(self, start: Float64, tip: Float64, name: str, colour: str) -> None:
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
        path = arc(ORIGIN, foot_direction(light), Z, light.elevation, radius)
        self.arrow(path, THETA, 1.8)
        self.label(f"θ {degrees(light.elevation)}", path[len(path) // 2], THETA, away_from=ORIGIN)

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

    def part(self, scene: Scene, posture: Posture) -> None:
        """Draw the scene's part at a posture, softly shaded: faces seen from behind first, and the far ones first."""
        from matplotlib.collections import PolyCollection

        whole = ColouredSurface(
            vertices=scene.mesh.vertices, triangles=scene.mesh.faces, layers=(), up=Z, toward=self.view.toward
        )
        surface, _ = simplified(whole, most=MOST_FACES)
        rotation, translation = scene.stage.transform(posture)
        vertices = surface.vertices @ rotation.T + translation
        corners, normals = vertices[surface.triangles], face_normals(TriangleMesh(vertices, surface.triangles))
        # backs of faces are shown like fronts: this is a drawing, not an image
        front = normals @ self.view.toward > 0.0
        normals = np.where(front[:, None], normals, -normals)
        lamp = self.view.toward + 0.9 * self.view.up - 0.7 * self.view.right
        light = 0.62 + 0.38 * np.clip(normals @ (lamp / np.linalg.norm(lamp)), 0.0, 1.0)
        order = np.lexsort((self.view.nearness(corners.mean(axis=1)), front))
        style: dict[str, Any] = {"edgecolors": "face", "linewidths": 0.4 * POINT, "zorder": 2}
        faces = PolyCollection([*self.view.place(corners[order])], facecolors=light[order, None] * PART, **style)
        self.axes.add_collection(faces)


def degrees(angle: float) -> str:
    """An angle [rad] as it is written in files, with a true minus sign."""
    return f"{round(math.degrees(angle), 6) + 0.0:.5g}°".replace("-", "−")
