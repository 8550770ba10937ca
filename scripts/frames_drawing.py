"""The project's conventions as a drawing for the docs, made with the functions that everything else uses.

Directions, elevation beyond the zenith, panels, camera with roll, pixels, postures: the drawing shows what the program
does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightopt.core.transforms import azimuth_tangent, direction, elevation_tangent, rotation_x, rotation_z
from lightopt.lights import panel_grid, place_light
from lightopt.report._drawing import CAP_HEIGHT, INK, LINE_HEIGHT, SOFT, Box, Drawing, Label, fixed_style, sub
from lightopt.report._images import check_png_path, write_picture
from lightopt.report._rig_elements import (
    AXIS_COLOURS,
    BORDER_STEPS,
    CAMERA,
    LIGHT,
    PHI,
    STAGE,
    THETA,
    Pen,
    camera_shape,
    foot_direction,
    panel_corners,
    square,
)
from lightopt.report._view import ORIGIN, X, Y, Z, arc, fit_view
from lightopt.scene import pixel_directions, place_camera, project

Float64 = NDArray[np.float64]

COLUMNS = 3
PANEL = (590, 560)
MARGIN, HEAD, FOOT = 26, 56, 92
"""Around a panel's picture: its border, its title above and its text below [px]."""

TITLE_SIZE, LABEL_SIZE, TEXT_SIZE = 20, 18, 16
"""[px]."""

RULE = "#dfe3e8"

E_THETA, E_PHI = sub("e", "θ"), sub("e", "φ")
THETA_J, PHI_J = sub("θ", "j"), sub("φ", "j")


@fixed_style()
def frames_drawing(path: str | Path) -> Path:
    """Draw the conventions into a PNG."""
    path = check_png_path(path)
    panels = frame_panels()
    rows = -(-len(panels) // COLUMNS)
    drawing = Drawing(COLUMNS * PANEL[0], rows * PANEL[1])
    for x in range(PANEL[0], drawing.width, PANEL[0]):
        drawing.line(np.array([(x, MARGIN), (x, drawing.height - MARGIN)]), colour=RULE, width=1.0)
    for y in range(PANEL[1], drawing.height, PANEL[1]):
        drawing.line(np.array([(MARGIN, y), (drawing.width - MARGIN, y)]), colour=RULE, width=1.0)
    for i, panel in enumerate(panels):
        left, top = (i % COLUMNS) * PANEL[0], (i // COLUMNS) * PANEL[1]
        box = left + MARGIN, top + HEAD, left + PANEL[0] - MARGIN, top + PANEL[1] - FOOT
        labels = panel.draw(drawing, box)
        write_labels(drawing, labels, box)
        drawing.text(box[0], top + MARGIN + CAP_HEIGHT * TITLE_SIZE, panel.title, size=TITLE_SIZE)
        for k, line in enumerate(panel.text):
            y = box[3] + 14 + (CAP_HEIGHT + k * LINE_HEIGHT) * TEXT_SIZE
            drawing.text(box[0], y, line, size=TEXT_SIZE, colour=SOFT)
    return write_picture(path, drawing.image())


def write_labels(drawing: Drawing, labels: list[Label], box: Box) -> list[Box]:
    """Write the labels of a panel, first those that care for a side: the others give way."""
    ordered = sorted(labels, key=lambda label: label.away is None)
    bounds = (box[0] - 14, box[1] - 8, box[2] + 14, box[3] + 8)
    return drawing.labels(ordered, size=LABEL_SIZE, bounds=bounds)


@dataclass(frozen=True)
class FramePanel:
    """One convention: a title, a picture drawn into a box, which gives its labels, and a few lines of text."""

    title: str
    draw: Callable[[Drawing, Box], list[Label]]
    text: tuple[str, ...]


def frame_panels() -> tuple[FramePanel, ...]:
    """The conventions, in the order of reading."""
    return (
        FramePanel(
            "Direction (elevation θ, azimuth φ)",
            draw_direction,
            (
                "d = (cosθ·cosφ, cosθ·sinφ, sinθ);  table plane Z = 0",
                f"{E_THETA} and {E_PHI}: where d goes as θ, φ grow;  {E_PHI} × {E_THETA} = d",
            ),
        ),
        FramePanel(
            "Elevation passes 90°",
            draw_zenith,
            (
                "θ is measured from the table plane: 90° is straight above, and",
                f"105° leans 15° beyond the zenith, where {E_THETA} carries on smoothly.",
            ),
        ),
        FramePanel(
            "Light",
            draw_light,
            (
                "centred at distance·d, facing the origin; it shines along −d",
                f"size_mm: [along {E_PHI}, along {E_THETA}];  points: k × k cell centres",
            ),
        ),
        FramePanel(
            "Camera with roll ρ",
            draw_camera,
            (
                f"image right = cosρ·{E_PHI} + sinρ·{E_THETA};  at distance·d,",
                f"image up = −sinρ·{E_PHI} + cosρ·{E_THETA};  looking along −d",
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
            f"Posture ({THETA_J}, {PHI_J})",
            draw_posture,
            (
                f"p' = pivot + Rx({THETA_J})·Rz({PHI_J})·(p − pivot): the part turns on the",
                "rotary axis, and the cradle tilts axis and part about X.",
            ),
        ),
    )


def draw_direction(drawing: Drawing, box: Box) -> list[Label]:
    """A direction d with its angles and tangents."""
    angles = {"elevation": np.radians(48.0), "azimuth": np.radians(60.0)}
    d = 100.0 * direction(**angles)
    e_theta = 40.0 * elevation_tangent(**angles)
    e_phi = 40.0 * azimuth_tangent(azimuth=angles["azimuth"])
    points = np.concatenate([square(62.0, ORIGIN), [d + e_theta, d + e_phi, 80 * Z]])
    pen = fit_pen(drawing, box, points, elevation=28.0, azimuth=338.0)
    pen.grid(62.0, 15.5)
    pen.axes((78.0, 78.0, 80.0))
    flat = d * [1.0, 1.0, 0.0]
    foot = flat / np.linalg.norm(flat)
    pen.line(np.stack([ORIGIN, flat]), SOFT, 1.2, dash=(4, 4))
    pen.line(np.stack([d, flat]), SOFT, 1.2, dash=(4, 4))
    azimuth = arc(ORIGIN, X, Y, angles["azimuth"], 46.0)
    pen.arrow(azimuth, PHI, 2.0)
    pen.label("φ", azimuth[len(azimuth) // 2], PHI, away_from=ORIGIN)
    elevation = arc(ORIGIN, foot, Z, angles["elevation"], 52.0)
    pen.arrow(elevation, THETA, 2.0)
    pen.label("θ", elevation[len(elevation) // 2], THETA, away_from=ORIGIN)
    pen.arrow(np.stack([ORIGIN, d]), INK, 3.0)
    pen.label("d", 0.72 * d, INK, away_from=0.5 * flat)
    named_arrow(pen, d, d + e_theta, E_THETA, THETA)
    named_arrow(pen, d, d + e_phi, E_PHI, PHI)
    return pen.labels


def draw_zenith(drawing: Drawing, box: Box) -> list[Label]:
    """Directions of growing elevation, seen from the side."""
    points = np.array([[-58.0, 0.0, -8.0], [118.0, 0.0, -8.0], [0.0, 0.0, 122.0]])
    # seen from −Y, so that the plane of azimuth 0 is the picture's
    pen = fit_pen(drawing, box, points, elevation=0.0, azimuth=270.0)
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
        pen.arrow(np.stack([70.0 * d, 70.0 * d + 17.0 * e_theta]), THETA, 2.0, head=11.0)
    tip = 70.0 * X + 17.0 * Z
    pen.label(E_THETA, tip, THETA, away_from=70.0 * X)
    sweep = arc(ORIGIN, X, Z, np.radians(105.0), 34.0)
    pen.arrow(sweep, THETA, 2.0)
    pen.label("θ", sweep[len(sweep) // 3], THETA, away_from=ORIGIN)
    return pen.labels


def draw_light(drawing: Drawing, box: Box) -> list[Label]:
    """A panel with its points, facing the origin."""
    light = place_light(
        name="panel", distance=100.0, elevation=np.radians(50.0), azimuth=np.radians(75.0), size=(62.0, 44.0), points=9
    )
    corners = panel_corners(light)
    points = np.concatenate([square(42.0, ORIGIN), corners, [light.centre + 52 * light.across]])
    pen = fit_pen(drawing, box, points, elevation=14.0, azimuth=285.0)
    pen.grid(42.0, 21.0)
    pen.axes((50.0, 50.0, 40.0))
    foot = foot_direction(light)
    pen.line(np.stack([ORIGIN, light.centre * [1, 1, 0]]), SOFT, 1.2, dash=(4, 4))
    pen.line(np.stack([light.centre, light.centre * [1, 1, 0]]), SOFT, 1.2, dash=(4, 4))
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
    for point in panel_grid(light, 9):
        pen.drawing.disc(pen.view.place(point), 3.0, fill="#7a5600")
    pen.arrow(np.stack([light.centre, 0.0 * light.centre]), LIGHT, 2.2)
    pen.label("−d", 0.45 * light.centre, LIGHT, away_from=0.45 * light.centre - 10.0 * foot)
    named_arrow(pen, light.centre, light.centre + 50.0 * light.across, E_PHI, PHI)
    named_arrow(pen, light.centre, light.centre + 40.0 * light.along, E_THETA, THETA)
    return pen.labels


def draw_camera(drawing: Drawing, box: Box) -> list[Label]:
    """A camera with roll, between its own and the sphere's directions."""
    roll = np.radians(25.0)
    angles = {"elevation": np.radians(52.0), "azimuth": np.radians(320.0)}
    camera = place_camera(distance=110.0, roll=roll, width=40, height=30, pixel_size=0.3, image_distance=24.0, **angles)
    e_phi = azimuth_tangent(azimuth=angles["azimuth"])
    e_theta = elevation_tangent(**angles)
    shape = camera_shape(camera, 20.0)
    tips = camera.position + 50.0 * np.stack([e_phi, e_theta, camera.up])
    pen = fit_pen(
        drawing, box, np.concatenate([square(46.0, ORIGIN), tips, shape.footprint]), elevation=30.0, azimuth=292.0
    )
    pen.grid(46.0, 23.0)
    pen.polygon(shape.footprint, fill="#45535f20", outline=CAMERA, width=1.2)
    pen.axes((54.0, 54.0, 40.0))
    for corner in shape.footprint[::BORDER_STEPS]:
        pen.line(np.stack([camera.position, corner]), CAMERA, 1.2, dash=(7, 4))
    pen.arrow(np.stack([camera.position, 0.45 * camera.position]), INK, 2.2)
    pen.label("−d", 0.5 * camera.position, INK, away_from=0.5 * camera.position - e_phi)
    pen.line(np.stack([camera.position, tips[0]]), PHI, 1.8, dash=(6, 4))
    pen.label(E_PHI, tips[0], PHI, away_from=camera.position)
    pen.line(np.stack([camera.position, tips[1]]), THETA, 1.8, dash=(6, 4))
    pen.label(E_THETA, tips[1], THETA, away_from=camera.position)
    for start, towards in ((e_phi, e_theta), (e_theta, -e_phi)):
        sweep = arc(camera.position, start, towards, roll, 40.0)
        pen.arrow(sweep, STAGE, 1.8, head=9.0)
        pen.label("ρ", sweep[len(sweep) // 2], STAGE, away_from=camera.position)
    named_arrow(pen, camera.position, camera.position + 46.0 * camera.right, "image right", CAMERA, width=3.0)
    named_arrow(pen, camera.position, camera.position + 46.0 * camera.up, "image up", CAMERA, width=3.0)
    return pen.labels


def draw_pixels(drawing: Drawing, box: Box) -> list[Label]:
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
    side = min((box[2] - box[0] - 120) / camera.width, (box[3] - box[1] - 90) / camera.height)
    corner = np.array([0.5 * (box[0] + box[2] - side * camera.width) + 10, box[1] + 52])

    def place(columns: Float64, rows: Float64) -> Float64:
        return corner + side * np.stack([columns, rows], axis=-1)

    labels: list[Label] = []

    def note(text: str, anchor: Float64, colour: str, away: tuple[float, float]) -> None:
        labels.append(Label(text=text, anchor=(float(anchor[0]), float(anchor[1])), colour=colour, away=away))

    def cell(column: float, row: float) -> Float64:
        return place(column + np.array([0.0, 1.0, 1.0, 0.0]), row + np.array([0.0, 0.0, 1.0, 1.0]))

    drawing.polygon(cell(0, 0), fill="#d9e0e6")
    for column in range(camera.width + 1):
        drawing.line(place(np.array([column] * 2), np.array([0.0, camera.height])), colour="#b9c0c9", width=1.0)
    for row in range(camera.height + 1):
        drawing.line(place(np.array([0.0, camera.width]), np.array([row] * 2)), colour="#b9c0c9", width=1.0)
    # where these image points look on the table, and back through the lens: what is drawn is what the camera does
    seen = np.array([[0.5, 0.5], [7.5, 5.5], [4.0, 3.0]])
    rays = pixel_directions(camera, seen[:, 0], seen[:, 1])
    table = camera.position - rays * (camera.position[2] / rays[:, 2:])
    columns, rows, _ = project(camera, table)
    for at, column, row in zip(place(columns, rows), columns, rows, strict=True):
        drawing.disc(at, 4.5, fill=INK)
        note(f"({column:g}, {row:g})", at, INK, (1.0, 1.0) if row < 5 else (-1.0, -1.0))
    for axis, (name, colour) in enumerate(zip("XY", AXIS_COLOURS, strict=False)):
        points = np.stack([ORIGIN, 19.0 * np.eye(3)[axis]])
        columns, rows, _ = project(camera, points)
        ends = place(columns, rows)
        drawing.arrow(ends, colour=colour, width=2.8, head=15.0)
        note(name, ends[1], colour, (float(ends[1][0] - ends[0][0]), float(ends[1][1] - ends[0][1])))
    for text, end in (("column", (2.2, -0.35)), ("row", (-0.35, 2.2))):
        start = place(np.array(min(end[0], 0.0)), np.array(min(end[1], 0.0)))
        tip = place(np.array(end[0]), np.array(end[1]))
        drawing.arrow(np.stack([start, tip]), colour=SOFT, width=1.8)
        note(text, tip, SOFT, (float(tip[0] - start[0]), float(tip[1] - start[1])))
    return labels


def draw_posture(drawing: Drawing, box: Box) -> list[Label]:
    """A plate turned on the rotary axis, then tilted with it."""
    middle = 0.5 * (box[0] + box[2])
    boxes: tuple[Box, Box] = ((box[0], box[1], middle - 6, box[3]), (middle + 6, box[1], box[2], box[3]))
    theta, phi = np.radians(28.0), np.radians(55.0)
    labels: list[Label] = []
    for half, tilt in zip(boxes, (0.0, theta), strict=True):
        carried = rotation_x(tilt)
        rotation = carried @ rotation_z(phi)
        points = 60.0 * np.stack([X, -0.9 * X, 1.1 * Z, -0.6 * Z, -0.55 * Y])
        inner = (half[0] + 4, half[1] + 30, half[2] - 20, half[3] - 20)
        view = fit_view(points, elevation=np.radians(26.0), azimuth=np.radians(300.0), box=inner)
        pen = Pen(drawing, view, labels)
        before = rotation_z(phi) if tilt else np.eye(3)
        _block(pen, before, ghost=True)
        pen.line(np.stack([-54.0 * X, 60.0 * X]), STAGE, 1.6, dash=(14, 5))
        if tilt:
            pen.line(np.stack([ORIGIN, 66.0 * Z]), SOFT, 1.2, dash=(3, 4))
        pen.line(np.stack([-34.0 * carried[:, 2], ORIGIN]), STAGE, 1.6, dash=(14, 5))
        _block(pen, rotation, ghost=False)
        pen.line(np.stack([12.0 * carried[:, 2], 66.0 * carried[:, 2]]), STAGE, 1.6, dash=(14, 5))
        pen.label("rotary axis", 66.0 * carried[:, 2], STAGE, away_from=ORIGIN)
        pen.label("X", 60.0 * X, AXIS_COLOURS[0], away_from=ORIGIN)
        if tilt:
            centre, name = ORIGIN, THETA_J
            sweep = arc(centre, Z, -Y, tilt, 54.0)
        else:
            centre, name = 46.0 * Z, PHI_J
            sweep = arc(centre, X, Y, phi, 26.0)
            pen.line(arc(centre, X, Y, 2.0 * np.pi, 26.0), "#d9b6be", 1.2)
            for end in (sweep[0], sweep[-1]):
                pen.line(np.stack([centre, end]), STAGE, 1.2, dash=(3, 4))
        pen.arrow(sweep, STAGE, 2.4)
        pen.label(name, sweep[len(sweep) // 2], STAGE, away_from=centre)
    return labels


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
        pen.arrow(arrow @ rotation.T, INK, 3.0, head=15.0)


def fit_pen(drawing: Drawing, box: Box, points: Float64, *, elevation: float, azimuth: float) -> Pen:
    """A pen for a view from (elevation, azimuth) [°] that shows all points [mm] in a box."""
    inner = (box[0] + 40, box[1] + 26, box[2] - 40, box[3] - 20)
    view = fit_view(points, elevation=np.radians(elevation), azimuth=np.radians(azimuth), box=inner)
    return Pen(drawing, view, [])


def named_arrow(pen: Pen, start: Float64, tip: Float64, name: str, colour: str, *, width: float = 2.6) -> None:
    """Draw an arrow and its name at the tip."""
    pen.arrow(np.stack([start, tip]), colour, width)
    pen.label(name, tip, colour, away_from=start)
