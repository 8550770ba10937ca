"""The things of a rig, drawn in a parallel view."""

import math
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.report._drawing import INK, SOFT, Drawing, Label, sub
from lightopt.report._part_picture import PartPicture
from lightopt.report._rig_shapes import CameraShape, foot_direction, nice_step, square
from lightopt.report._view import ORIGIN, ParallelView, X, Y, Z, arc
from lightopt.scene import PanelLight, PinholeCamera, panel_corners, panel_grid

GRID = "#dfe3e8"
CAMERA, LIGHT, THETA, PHI, STAGE = "#45535f", "#b07d04", "#7a2f9b", "#0a8580", "#a8324a"
AXIS_COLOURS = ("#c8321f", "#2c8a3a", "#2458b8")


@dataclass(frozen=True)
class Pen:
    """Draws world shapes [mm]; what stands behind the part is left out.

    labels: What is to be written, the important first; collected while drawing
    part: The part's picture, once it is known
    """

    drawing: Drawing
    view: ParallelView
    labels: list[Label]
    part: PartPicture | None = None

    def line(
        self, points: Float64, colour: str, width: float = 1.5, *, dash: tuple[float, float] | None = None
    ) -> None:
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
        x, y = self.view.place(anchor)
        away = None
        if away_from is not None:
            ax, ay = self.view.place(away_from)
            away = (float(x - ax), float(y - ay))
        self.labels.append(Label(text=text, anchor=(float(x), float(y)), colour=colour, away=away))

    def grid(self, half: float, step: float, centre: Float64 = ORIGIN) -> None:
        """Draw the table plane around a place as a grid; `half` a side is a multiple of the step [mm]."""
        n = round(half / step)
        cx, cy = centre[:2]
        side = n * step
        self.polygon(square(side, centre), fill="#f7f8fa")
        for i in range(-n, n + 1):
            for a, b in (((i * step, -side), (i * step, side)), ((-side, i * step), (side, i * step))):
                ends = np.array([[cx + a[0], cy + a[1], 0.0], [cx + b[0], cy + b[1], 0.0]])
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
        self.polygon(panel_corners(light), fill="#ffd766e0" if shines_here else "#cfa54de0", outline=LIGHT, width=2.0)
        if shines_here and light.points != "auto" and light.points <= 64:
            for point in panel_grid(light, light.points):
                self.drawing.disc(self.view.place(point), 1.7, fill=LIGHT)
        outer = max(panel_corners(light), key=lambda corner: float(corner @ self.view.up))
        self.label(light.name, outer, INK, away_from=light.centre)

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

    def camera(self, camera: PinholeCamera, shape: CameraShape, *, annotate: bool) -> None:
        """Draw the camera, its viewing pyramid down to the table and the directions of its image."""
        for corner in shape.corners:
            self.line(np.stack([camera.position, corner]), CAMERA, 1.1, dash=(7, 4))
        front, back = shape.body[:4], shape.body[4:]
        faces = [back, front, *(np.stack([front[i], front[i - 1], back[i - 1], back[i]]) for i in range(4))]
        for face in sorted(faces, key=lambda f: float(self.view.nearness(f.mean(axis=0)))):
            self.polygon(face, fill="#d9e0e6", outline=CAMERA, width=1.5)
        sides = [np.stack([camera.position, shape.aperture[i - 1], shape.aperture[i]]) for i in range(4)]
        for face in sorted(sides, key=lambda f: float(self.view.nearness(f.mean(axis=0)))):
            self.polygon(face, fill="#45535f30", outline=CAMERA, width=1.5)
        self.label("camera", back.mean(axis=0), CAMERA, away_from=camera.position)
        if not annotate:
            return
        for name, vector in (("image right", camera.right), ("image up", camera.up)):
            tip = camera.position + shape.arrow * vector
            self.arrow(np.stack([camera.position, tip]), CAMERA, 2.6)
            self.label(name, tip, CAMERA, away_from=camera.position)

    def footprint(self, shape: CameraShape) -> None:
        """Draw what the camera sees of the table."""
        self.polygon(shape.footprint, fill="#45535f20", outline=CAMERA, width=1.2)

    def scale_bar(self, left: float, baseline: float, span: float) -> str:
        """Draw a bar of a round length [mm] for a view of about 2·span at a place [px]; what to write on it."""
        length = nice_step(2.0 * span)
        end = left + length * self.view.scale
        bar = np.array([[left, baseline - 5], [left, baseline], [end, baseline], [end, baseline - 5]])
        self.drawing.line(bar, colour=SOFT, width=1.5)
        return f"{length:g} mm"

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
