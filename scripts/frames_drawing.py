"""The project's conventions as a drawing for the docs, made with the functions that everything else uses.

Directions, elevation beyond the zenith, panels, camera with roll, pixels, postures: the drawing shows what the program
does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lightopt.core.transforms import azimuth_tangent, direction, elevation_tangent, rotation_x, rotation_z
from lightopt.lights import panel_grid, place_light
from lightopt.report._pictures import DPI, INK, POINT, SOFT, check_png_path, figure_image, fixed_style, write_picture
from lightopt.report._rig_elements import (
    AXIS_COLOURS,
    BORDER_STEPS,
    CAMERA,
    LIGHT,
    ORIGIN,
    PHI,
    STAGE,
    THETA,
    ParallelView,
    Pen,
    X,
    Y,
    Z,
    arc,
    camera_shape,
    foot_direction,
    panel_corners,
)
from lightopt.scene import pixel_directions, place_camera, project

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Float64 = NDArray[np.float64]

COLUMNS = 3
PANEL = (590, 560)  # size of a panel [px]
TITLE_SIZE, TEXT_SIZE = 20, 16  # [px]


@fixed_style()
def frames_drawing(path: str | Path) -> Path:
    """Draw the conventions into a PNG."""
    from matplotlib.figure import Figure

    path = check_png_path(path)
    panels = frame_panels()
    rows = -(-len(panels) // COLUMNS)
    size = COLUMNS * PANEL[0] / DPI, rows * PANEL[1] / DPI
    figure = Figure(figsize=size, dpi=DPI)
    figure.subplots_adjust(left=0.02, right=0.98, bottom=0.08, top=0.94, wspace=0.06, hspace=0.28)
    for axes, panel in zip(figure.subplots(rows, COLUMNS).flat, panels, strict=True):
        axes.set_axis_off()
        axes.margins(0.08)  # for labels
        axes.set_title(panel.title, loc="left", fontsize=TITLE_SIZE * POINT, color=INK)
        text = "\n".join(panel.text)
        axes.text(0.0, -0.02, text, va="top", transform=axes.transAxes, fontsize=TEXT_SIZE * POINT, color=SOFT)
        panel.draw(axes)
    return write_picture(path, figure_image(figure))


@dataclass(frozen=True)
class FramePanel:
    """One convention: a title, what draws its picture, and a few lines of text."""

    title: str
    draw: Callable[[Axes], None]
    text: tuple[str, ...]


def frame_panels() -> tuple[FramePanel, ...]:
    """The conventions, in the order of reading."""
    return (
        FramePanel(
            "Direction (elevation θ, azimuth φ)",
            draw_direction,
            (
                "d = (cosθ·cosφ, cosθ·sinφ, sinθ);  table plane Z = 0",
                "e_θ and e_φ: where d goes as θ, φ grow;  e_φ × e_θ = d",
            ),
        ),
        FramePanel(
            "Elevation passes 90°",
            draw_zenith,
            (
                "θ is measured from the table plane: 90° is straight above, and",
                "105° leans 15° beyond the zenith, where e_θ carries on smoothly.",
            ),
        ),
        FramePanel(
            "Light",
            draw_light,
            (
                "centred at distance·d, facing the origin; it shines along −d",
                "size_mm: [along e_φ, along e_θ];  points: k × k cell centres",
            ),
        ),
        FramePanel(
            "Camera with roll ρ",
            draw_camera,
            (
                "image right = cosρ·e_φ + sinρ·e_θ;  at distance·d,",
                "image up = −sinρ·e_φ + cosρ·e_θ;  looking along −d",
            ),
        ),
        FramePanel(
            "Pixels",
            draw_pixels,
            (
                "Pixel (column, row) = (0, 0) is the top left one; centres at +0.5.",
                "Elevation 90°, azimuth 270°, roll 0: X to the right, Y up.",
            ),
        ),
        FramePanel(
            "Posture (θⱼ, φⱼ)",
            draw_posture,
            (
                "p' = pivot + Rx(θⱼ)·Rz(φⱼ)·(p − pivot): the part turns on the",
                "rotary axis, and the cradle tilts axis and part about X.",
            ),
        ),
    )


def draw_direction(axes: Axes) -> None:
    """A direction d with its angles and tangents."""
    angles = {"elevation": np.radians(48.0), "azimuth": np.radians(60.0)}
    d = 100.0 * direction(**angles)
    e_theta = 40.0 * elevation_tangent(**angles)
    e_phi = 40.0 * azimuth_tangent(azimuth=angles["azimuth"])
    pen = pen_from(axes, elevation=28.0, azimuth=338.0)
    pen.grid(62.0, 15.5)
    pen.axes_of_world((78.0, 78.0, 80.0))
    flat = d * [1.0, 1.0, 0.0]
    foot = flat / np.linalg.norm(flat)
    pen.line(np.stack([ORIGIN, flat]), SOFT, 1.2, dash=":")
    pen.line(np.stack([d, flat]), SOFT, 1.2, dash=":")
    azimuth = arc(ORIGIN, X, Y, angles["azimuth"], 46.0)
    pen.arrow(azimuth, PHI, 2.0)
    pen.label("φ", azimuth[len(azimuth) // 2], PHI, away_from=ORIGIN)
    elevation = arc(ORIGIN, foot, Z, angles["elevation"], 52.0)
    pen.arrow(elevation, THETA, 2.0)
    pen.label("θ", elevation[len(elevation) // 2], THETA, away_from=ORIGIN)
    pen.arrow(np.stack([ORIGIN, d]), INK, 3.0)
    pen.label("d", 0.72 * d, INK, away_from=0.5 * flat)
    pen.named_arrow(d, d + e_theta, "e_θ", THETA)
    pen.named_arrow(d, d + e_phi, "e_φ", PHI)


def draw_zenith(axes: Axes) -> None:
    """Directions of growing elevation, seen from the side."""
    # seen from −Y, so that the plane of azimuth 0 is the picture's
    pen = pen_from(axes, elevation=0.0, azimuth=270.0)
    table = np.array([[-58.0, 0.0, 0.0], [118.0, 0.0, 0.0]])
    below = [0.0, 0.0, -5.0]
    pen.polygon(np.concatenate([table, table[::-1] + below]), fill="#e9ecf0")
    pen.line(table, SOFT, 1.6)
    pen.label("table", table[0] + [14.0, 0.0, -5.0], SOFT, away_from=table[0] + [14.0, 0.0, 0.0])
    for degrees in (0, 30, 60, 90, 105):
        angles = {"elevation": np.radians(degrees), "azimuth": 0.0}
        d, e_theta = direction(**angles), elevation_tangent(**angles)
        last = degrees == 105
        pen.arrow(np.stack([ORIGIN, 92.0 * d]), INK if last else "#8d95a0", 3.0 if last else 1.8)
        pen.label(f"{degrees}°", 92.0 * d, INK if last else SOFT, away_from=ORIGIN)
        pen.arrow(np.stack([70.0 * d, 70.0 * d + 17.0 * e_theta]), THETA, 2.0)
    tip = 70.0 * X + 17.0 * Z
    pen.label("e_θ", tip, THETA, away_from=70.0 * X)
    sweep = arc(ORIGIN, X, Z, np.radians(105.0), 34.0)
    pen.arrow(sweep, THETA, 2.0)
    pen.label("θ", sweep[len(sweep) // 3], THETA, away_from=ORIGIN)


def draw_light(axes: Axes) -> None:
    """A panel with its points, facing the origin."""
    light = place_light(
        name="panel", distance=100.0, elevation=np.radians(50.0), azimuth=np.radians(75.0), size=(62.0, 44.0), points=9
    )
    corners = panel_corners(light)
    pen = pen_from(axes, elevation=14.0, azimuth=285.0)
    pen.grid(42.0, 21.0)
    pen.axes_of_world((50.0, 50.0, 40.0))
    foot = foot_direction(light)
    pen.line(np.stack([ORIGIN, light.centre * [1, 1, 0]]), SOFT, 1.2, dash=":")
    pen.line(np.stack([light.centre, light.centre * [1, 1, 0]]), SOFT, 1.2, dash=":")
    sweep = arc(ORIGIN, foot, Z, light.elevation, 30.0)
    pen.arrow(sweep, THETA, 2.0)
    pen.label("θ", sweep[len(sweep) // 2], THETA, away_from=ORIGIN)
    pen.polygon(corners, fill="#ffd766", outline=LIGHT, width=2.0)
    for k in (-1, 1):
        for half, along in (
            (0.5 * light.size[1] * light.along, light.across * light.size[0]),
            (0.5 * light.size[0] * light.across, light.along * light.size[1]),
        ):
            middle = light.centre + k * along / 6.0
            pen.line(np.stack([middle - half, middle + half]), "#d9ab2b", 1.0)
    pen.axes.plot(*pen.view.place(panel_grid(light, 9)).T, "o", color="#7a5600", markersize=6.0 * POINT, zorder=2)
    pen.arrow(np.stack([light.centre, 0.0 * light.centre]), LIGHT, 2.2)
    pen.label("−d", 0.45 * light.centre, LIGHT, away_from=0.45 * light.centre - 10.0 * foot)
    pen.named_arrow(light.centre, light.centre + 50.0 * light.across, "e_φ", PHI)
    pen.named_arrow(light.centre, light.centre + 40.0 * light.along, "e_θ", THETA)


def draw_camera(axes: Axes) -> None:
    """A camera with roll, between its own and the sphere's directions."""
    roll = np.radians(25.0)
    angles = {"elevation": np.radians(52.0), "azimuth": np.radians(320.0)}
    camera = place_camera(distance=110.0, roll=roll, width=40, height=30, pixel_size=0.3, image_distance=24.0, **angles)
    e_phi = azimuth_tangent(azimuth=angles["azimuth"])
    e_theta = elevation_tangent(**angles)
    shape = camera_shape(camera, 20.0)
    tips = camera.position + 50.0 * np.stack([e_phi, e_theta, camera.up])
    pen = pen_from(axes, elevation=30.0, azimuth=292.0)
    pen.grid(46.0, 23.0)
    pen.polygon(shape.footprint, fill="#45535f20", outline=CAMERA, width=1.2)
    pen.axes_of_world((54.0, 54.0, 40.0))
    for corner in shape.footprint[::BORDER_STEPS]:
        pen.line(np.stack([camera.position, corner]), CAMERA, 1.2, dash="--")
    pen.arrow(np.stack([camera.position, 0.45 * camera.position]), INK, 2.2)
    pen.label("−d", 0.5 * camera.position, INK, away_from=0.5 * camera.position + e_phi)
    pen.line(np.stack([camera.position, tips[0]]), PHI, 1.8, dash="--")
    pen.label("e_φ", tips[0], PHI, away_from=camera.position)
    pen.line(np.stack([camera.position, tips[1]]), THETA, 1.8, dash="--")
    pen.label("e_θ", tips[1], THETA, away_from=camera.position)
    for start, towards in ((e_phi, e_theta), (e_theta, -e_phi)):
        sweep = arc(camera.position, start, towards, roll, 40.0)
        pen.arrow(sweep, STAGE, 1.8)
        pen.label("ρ", sweep[len(sweep) // 2], STAGE, away_from=camera.position)
    pen.named_arrow(camera.position, camera.position + 46.0 * camera.right, "image right", CAMERA)
    pen.named_arrow(camera.position, camera.position + 46.0 * camera.up, "image up", CAMERA)


def draw_pixels(axes: Axes) -> None:
    """The pixels of a camera in plan view, with the world's axes."""
    camera = place_camera(
        distance=100.0,
        elevation=np.radians(90.0),
        azimuth=np.radians(270.0),
        roll=0.0,
        width=8,
        height=6,
        pixel_size=1.0,
        image_distance=10.0,
    )
    # image points lie on the picture as on the image, rows from the top down: a view straight at it
    pen = pen_from(axes, elevation=90.0, azimuth=270.0)

    def place(columns: Float64, rows: Float64) -> Float64:
        return np.stack([columns, -rows, np.zeros_like(columns)], axis=-1)

    pen.polygon(place(np.array([0.0, 1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0, 1.0])), fill="#d9e0e6")
    for column in range(camera.width + 1):
        pen.line(place(np.array([column] * 2), np.array([0.0, camera.height])), "#b9c0c9", 1.0)
    for row in range(camera.height + 1):
        pen.line(place(np.array([0.0, camera.width]), np.array([row] * 2)), "#b9c0c9", 1.0)
    # where these image points look on the table, and back through the lens: what is drawn is what the camera does
    seen = np.array([[0.5, 0.5], [7.5, 5.5], [4.0, 3.0]])
    rays = pixel_directions(camera, seen[:, 0], seen[:, 1])
    table = camera.position - rays * (camera.position[2] / rays[:, 2:])
    columns, rows, _ = project(camera, table)
    for at, column, row in zip(place(columns, rows), columns, rows, strict=True):
        pen.axes.plot(*pen.view.place(at), "o", color=INK, zorder=2)
        pen.label(f"({column:g}, {row:g})", at, INK, away_from=at + (Y - X if row < 5 else X - Y))
    for name, axis, colour in zip("XY", (X, Y), AXIS_COLOURS, strict=False):
        columns, rows, _ = project(camera, np.stack([ORIGIN, 19.0 * axis]))
        start, tip = place(columns, rows)
        pen.named_arrow(start, tip, name, colour)
    for text, ends in (("column", ((0.0, -0.35), (2.2, -0.35))), ("row", ((-0.35, 0.0), (-0.35, 2.2)))):
        start, tip = place(*np.array(ends).T)
        pen.named_arrow(start, tip, text, SOFT)


def draw_posture(axes: Axes) -> None:
    """A plate turned on the rotary axis, then tilted with it."""
    theta, phi = np.radians(28.0), np.radians(55.0)
    view = ParallelView(elevation=np.radians(26.0), azimuth=np.radians(300.0))
    for number, tilt in enumerate((0.0, theta)):
        carried = rotation_x(tilt)
        rotation = carried @ rotation_z(phi)
        # the second plate stands beside the first
        pen = Pen(axes, ShiftedView(view.elevation, view.azimuth, 130.0 * number * view.right))
        before = rotation_z(phi) if tilt else np.eye(3)
        _block(pen, before, ghost=True)
        pen.line(np.stack([-54.0 * X, 60.0 * X]), STAGE, 1.6, dash="--")
        if tilt:
            pen.line(np.stack([ORIGIN, 66.0 * Z]), SOFT, 1.2, dash=":")
        pen.line(np.stack([-34.0 * carried[:, 2], ORIGIN]), STAGE, 1.6, dash="--")
        _block(pen, rotation, ghost=False)
        pen.line(np.stack([12.0 * carried[:, 2], 66.0 * carried[:, 2]]), STAGE, 1.6, dash="--")
        if not tilt:
            pen.label("rotary axis", 66.0 * carried[:, 2], STAGE, away_from=ORIGIN)
        pen.label("X", 60.0 * X, AXIS_COLOURS[0], away_from=ORIGIN)
        if tilt:
            centre, name = ORIGIN, "θⱼ"
            sweep = arc(centre, Z, -Y, tilt, 54.0)
        else:
            centre, name = 46.0 * Z, "φⱼ"
            sweep = arc(centre, X, Y, phi, 26.0)
            pen.line(arc(centre, X, Y, 2.0 * np.pi, 26.0), "#d9b6be", 1.2)
            for end in (sweep[0], sweep[-1]):
                pen.line(np.stack([centre, end]), STAGE, 1.2, dash=":")
        pen.arrow(sweep, STAGE, 2.4)
        pen.label(name, sweep[len(sweep) // 2], STAGE, away_from=centre)


def _block(pen: Pen, rotation: Float64, *, ghost: bool) -> None:
    """A plate with an arrow along the part's own X on its top."""
    size = np.array([34.0, 20.0, 9.0])
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = sign * rotation[:, axis]
            if normal @ pen.view.toward <= 0.0:
                continue
            u, v = (axis + 1) % 3, (axis + 2) % 3
            face = np.array([[a, b] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))], dtype=np.float64)
            corners = np.zeros((4, 3))
            corners[:, axis] = sign * size[axis]
            corners[:, u], corners[:, v] = face[:, 0] * size[u], face[:, 1] * size[v]
            shade = int(232 - 34 * (1.0 - max(0.0, float(normal @ (0.3 * pen.view.toward + 0.7 * Z)))))
            fill = "#ffffff00" if ghost else f"#{shade:02x}{shade + 3:02x}{shade + 8:02x}"
            pen.polygon(corners @ rotation.T, fill=fill, outline="#b9c0c9" if ghost else "#4a5460", width=1.4)
    if not ghost:
        arrow = np.array([[-24.0, 0.0, size[2]], [26.0, 0.0, size[2]]])
        pen.arrow(arrow @ rotation.T, INK, 3.0)


@dataclass(frozen=True)
class ShiftedView(ParallelView):
    """A view of things that are moved first [mm]."""

    shift: Float64

    def place(self, points: Float64) -> Float64:
        return super().place(points + self.shift)


def pen_from(axes: Axes, *, elevation: float, azimuth: float) -> Pen:
    """A pen for a view from (elevation, azimuth) [°]."""
    return Pen(axes, ParallelView(elevation=np.radians(elevation), azimuth=np.radians(azimuth)))
