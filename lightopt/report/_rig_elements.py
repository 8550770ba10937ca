"""The things of a rig: their shapes in the world frame [mm], and how a parallel view shows them."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.transforms import Posture
from lightopt.lights import PanelLight, SurfaceLight, outlines, panel_corners, panel_grid
from lightopt.report._drawing import INK, SOFT, Drawing, Label, sub
from lightopt.report._view import ORIGIN, ParallelView, PartPicture, X, Y, Z, arc
from lightopt.scene import PinholeCamera, Scene, pixel_directions

GRID = "#dfe3e8"
CAMERA, LIGHT, THETA, PHI, STAGE = "#45535f", "#b07d04", "#7a2f9b", "#0a8580", "#a8324a"
AXIS_COLOURS = ("#c8321f", "#2c8a3a", "#2458b8")
BORDER_STEPS = 24  # points per side of the image's border; a distorted lens bends it on the table
_FARTHEST = 1.5  # rays that rise from the table or graze it are cut at this many camera distances


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


def table_grid(scene: Scene, posture: Posture) -> tuple[float, float]:
    """Half the side of the piece of table to draw, below all lights and the part, and the step of its grid [mm]."""
    under = [np.abs(outlines(light)[..., :2]).max() for light in scene.lights]
    part = np.abs(part_box(scene, posture)[:, :2]).max()
    return round_up(float(max([*under, 1.2 * part, 0.4 * rig_size(scene)])))


def round_up(half: float) -> tuple[float, float]:
    """Half a side of at least `half`, a multiple of a round step, and that step [mm]."""
    step = nice_step(2.0 * half)
    return math.ceil(half / step - 1e-9) * step, step


def nice_step(span: float) -> float:
    """A round length (1, 2 or 5 times a power of ten) of about a tenth of a span; both in [mm]."""
    power = 10.0 ** math.floor(math.log10(span / 10.0))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= span / 10.0 * 0.999)


@dataclass(frozen=True)
class Pen:
    """Draws world shapes [mm]; what stands behind the part is left out."""

    drawing: Drawing
    view: ParallelView
    labels: list[Label]  # what is to be written, the important first; collected while drawing
    part: PartPicture | None = None  # the part's picture, once it is known

    def line(self, points: Float64, colour: str, width: float = 1.5, dash: tuple[float, float] | None = None) -> None:
        """Draw a polyline of shape (n, 3), dash and gap in [px]."""
        for piece in self._visible(points):
            self.drawing.line(self.view.place(piece), colour=colour, width=width, dash=dash)

    def arrow(self, points: Float64, colour: str, width: float = 2.2, head: float = 14.0) -> None:
        """Draw a polyline of shape (n, 3) that ends in an arrow head of fixed length [px]."""
        pieces = self._visible(points)
        for piece in pieces[:-1]:
            self.drawing.line(self.view.place(piece), colour=colour, width=width)
        if pieces:
            self.drawing.arrow(self.view.place(pieces[-1]), colour=colour, width=width, head=head)

    def polygon(self, points: Float64, *, fill: str, outline: str = "none", width: float = 1.5) -> None:
        """Draw an area of shape (n, 3)."""
        self.drawing.polygon(self.view.place(points), fill=fill, outline=outline, width=width)

    def label(self, text: str, anchor: Float64, colour: str, *, away_from: Float64 | None = None) -> None:
        """Name a place [mm], shape (3,), on the side turned away from another one."""
        x, y = self.view.place(anchor).tolist()
        away = None
        if away_from is not None:
            from_x, from_y = self.view.place(away_from).tolist()
            away = (x - from_x, y - from_y)
        self.labels.append(Label(text=text, anchor=(x, y), colour=colour, away=away))

    def grid(self, half: float, step: float, centre: Float64 = ORIGIN) -> None:
        """Draw the table plane around a place as a grid; `half` a side is a multiple of the step [mm]."""
        n, middle = round(half / step), centre * [1, 1, 0]
        side = n * step
        self.polygon(square(side, centre), fill="#f7f8fa")
        for i in range(-n, n + 1):
            for along, across in ((X, Y), (Y, X)):
                ends = middle + np.stack([i * step * along - side * across, i * step * along + side * across])
                self.drawing.line(self.view.place(ends), colour=GRID, width=1.0)

    def axes(self, lengths: tuple[float, float, float]) -> None:
        """Draw the world's axes from the origin."""
        for axis, (name, colour) in enumerate(zip("XYZ", AXIS_COLOURS, strict=True)):
            tip = np.zeros(3)
            tip[axis] = lengths[axis]
            self.arrow(np.stack([ORIGIN, tip]), colour, 2.6, head=16.0)
            self.label(name, tip, colour, away_from=ORIGIN)

    def panel(self, light: PanelLight) -> None:
        """Draw a panel as its true rectangle, its point lights on the side that shines, and the line to the origin."""
        shines_here = float(light.outward @ self.view.toward) < 0.0
        self.line(np.stack([ORIGIN, light.centre]), LIGHT, 1.2)
        if np.hypot(*light.centre[:2]) > 0.02 * light.distance:
            self.line(np.stack([light.centre, light.centre * [1, 1, 0]]), SOFT, 1.0, dash=(3, 5))
        if isinstance(light, SurfaceLight):
            self.surface(light)
        else:
            fill = "#ffd766e0" if shines_here else "#cfa54de0"
            self.polygon(panel_corners(light), fill=fill, outline=LIGHT, width=2.0)
        if shines_here and light.points != "auto" and light.points <= 64:
            for point in panel_grid(light, light.points):
                self.drawing.disc(self.view.place(point), 1.7, fill=LIGHT)
        outer = max(outlines(light).reshape(-1, 3), key=lambda corner: float(corner @ self.view.up))
        self.label(light.name, outer, INK, away_from=light.centre)

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
        foot = foot_direction(light)
        path = arc(ORIGIN, X, Y, light.azimuth, radius)
        self.line(np.stack([ORIGIN, light.centre * [1, 1, 0]]), SOFT, 1.0, dash=(3, 5))
        self.line(np.stack([ORIGIN, max(radius, spoke) * foot]), SOFT, 1.0, dash=(3, 5))
        self.arrow(path, PHI, 1.8, head=11.0)
        self.label(f"φ {degrees(light.azimuth)}", path[-1], PHI, away_from=path[-len(path) // 3])

    def elevation_arc(self, light: PanelLight, radius: float) -> None:
        """Draw the elevation θ from the table plane."""
        path = arc(ORIGIN, foot_direction(light), Z, light.elevation, radius)
        self.arrow(path, THETA, 1.8, head=11.0)
        self.label(f"θ {degrees(light.elevation)}", path[len(path) // 2], THETA, away_from=ORIGIN)

    def panel_frame(self, light: PanelLight, length: float) -> None:
        """Draw the sides' directions e_φ and e_θ at a panel."""
        for letter, vector, colour in (("φ", light.across, PHI), ("θ", light.along, THETA)):
            tip = light.centre + length * vector
            self.arrow(np.stack([light.centre, tip]), colour, 2.6)
            self.label(sub("e", letter), tip, colour, away_from=light.centre)

    def camera(self, camera: PinholeCamera, shape: CameraShape) -> None:
        """Draw the camera, its viewing pyramid down to the table and the directions of its image."""
        for corner in shape.footprint[::BORDER_STEPS]:
            self.line(np.stack([camera.position, corner]), CAMERA, 1.1, dash=(7, 4))
        front, back = shape.body[:4], shape.body[4:]
        faces = [back, front, *(np.stack([front[i], front[i - 1], back[i - 1], back[i]]) for i in range(4))]
        sides = [np.stack([camera.position, shape.aperture[i - 1], shape.aperture[i]]) for i in range(4)]
        for some, fill in ((faces, "#d9e0e6"), (sides, "#45535f30")):
            for face in sorted(some, key=lambda f: float(self.view.nearness(f.mean(axis=0)))):
                self.polygon(face, fill=fill, outline=CAMERA, width=1.5)
        self.label("camera", back.mean(axis=0), CAMERA, away_from=camera.position)
        for name, vector in (("image right", camera.right), ("image up", camera.up)):
            tip = camera.position + shape.arrow * vector
            self.arrow(np.stack([camera.position, tip]), CAMERA, 2.6)
            self.label(name, tip, CAMERA, away_from=camera.position)

    def scale_bar(self, left: float, baseline: float, span: float) -> None:
        """Draw a bar of a round length [mm] for a view of about 2·span at a place [px], and name the length."""
        length = nice_step(2.0 * span)
        end = left + length * self.view.scale
        bar = np.array([[left, baseline - 5], [left, baseline], [end, baseline], [end, baseline - 5]])
        self.drawing.line(bar, colour=SOFT, width=1.5)
        anchor = (left + 4, baseline - 6)
        self.labels.append(Label(text=f"{length:g} mm", anchor=anchor, colour=SOFT, away=(0.3, -1.0)))

    def _visible(self, points: Float64) -> list[Float64]:
        """Pieces of a polyline that the part does not hide."""
        points = np.asarray(points, dtype=np.float64)
        if self.part is None:
            return [points]
        steps = np.linalg.norm(np.diff(self.view.place(points), axis=0), axis=1)
        travelled = np.concatenate([[0.0], np.cumsum(steps)])
        at = np.union1d(travelled, np.arange(0.0, travelled[-1], 1.0))
        dense = np.stack([np.interp(at, travelled, points[:, axis]) for axis in range(3)], axis=1)
        hidden = self.part.hides(dense)
        breaks = np.flatnonzero(np.diff(hidden.astype(np.int8))) + 1
        pieces = zip(np.split(dense, breaks), np.split(hidden, breaks), strict=True)
        return [piece for piece, out in pieces if not out[0] and len(piece) > 1]


def degrees(angle: float) -> str:
    """An angle [rad] as it is written in files."""
    return f"{number(round(math.degrees(angle), 6))}°"


def number(value: float) -> str:
    """A number with at most five digits and a true minus sign."""
    return f"{value + 0.0:.5g}".replace("-", "−")
