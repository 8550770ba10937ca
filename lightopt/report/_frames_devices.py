"""Conventions of camera, pixels and stage, drawn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightopt.core.transforms import azimuth_tangent, elevation_tangent, posture_rotation
from lightopt.report._canvas import Canvas
from lightopt.report._frames_pen import E_PHI, E_THETA, PHI_J, THETA_J, fit_pen, named_arrow
from lightopt.report._labels import Box, Label
from lightopt.report._rig_elements import AXIS_COLOURS, CAMERA, INK, PHI, SOFT, STAGE, THETA, Pen
from lightopt.report._rig_shapes import camera_shape, square
from lightopt.report._view import ORIGIN, X, Y, Z, arc, fit_view
from lightopt.scene import pixel_directions, place_camera, project

Float64 = NDArray[np.float64]


def draw_camera(canvas: Canvas, box: Box) -> list[Label]:
    """A camera with roll, between its own and the sphere's directions."""
    roll = np.radians(25.0)
    angles = {"elevation": np.radians(52.0), "azimuth": np.radians(320.0)}
    camera = place_camera(
        distance=110.0, roll=roll, width=40, height=30, pixel_size=0.3, image_distance=24.0, **angles
    )
    e_phi = azimuth_tangent(azimuth=angles["azimuth"])
    e_theta = elevation_tangent(**angles)
    shape = camera_shape(camera, 20.0)
    tips = camera.position + 50.0 * np.stack([e_phi, e_theta, camera.up])
    pen = fit_pen(
        canvas,
        box,
        np.concatenate([square(46.0, ORIGIN), tips, shape.footprint]),
        elevation=30.0,
        azimuth=292.0,
    )
    pen.grid(46.0, 23.0)
    pen.footprint(shape)
    pen.axes((54.0, 54.0, 40.0))
    for corner in shape.corners:
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


def draw_pixels(canvas: Canvas, box: Box) -> list[Label]:
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

    canvas.polygon(cell(0, 0), fill="#d9e0e6")
    for column in range(camera.width + 1):
        canvas.line(
            place(np.array([column] * 2), np.array([0.0, camera.height])), colour="#b9c0c9", width=1.0
        )
    for row in range(camera.height + 1):
        canvas.line(place(np.array([0.0, camera.width]), np.array([row] * 2)), colour="#b9c0c9", width=1.0)
    # where these image points look on the table, and back through the lens: what is drawn is what the camera does
    seen = np.array([[0.5, 0.5], [7.5, 5.5], [4.0, 3.0]])
    rays = pixel_directions(camera, seen[:, 0], seen[:, 1])
    table = camera.position - rays * (camera.position[2] / rays[:, 2:])
    columns, rows, _ = project(camera, table)
    for at, column, row in zip(place(columns, rows), columns, rows, strict=True):
        canvas.disc(at, 4.5, fill=INK)
        note(f"({column:g}, {row:g})", at, INK, (1.0, 1.0) if row < 5 else (-1.0, -1.0))
    for axis, (name, colour) in enumerate(zip("XY", AXIS_COLOURS, strict=False)):
        points = np.stack([ORIGIN, 19.0 * np.eye(3)[axis]])
        columns, rows, _ = project(camera, points)
        ends = place(columns, rows)
        canvas.arrow(ends, colour=colour, width=2.8, head=15.0)
        note(name, ends[1], colour, (float(ends[1][0] - ends[0][0]), float(ends[1][1] - ends[0][1])))
    for text, end in (("column", (2.2, -0.35)), ("row", (-0.35, 2.2))):
        start = place(np.array(min(end[0], 0.0)), np.array(min(end[1], 0.0)))
        tip = place(np.array(end[0]), np.array(end[1]))
        canvas.arrow(np.stack([start, tip]), colour=SOFT, width=1.8)
        note(text, tip, SOFT, (float(tip[0] - start[0]), float(tip[1] - start[1])))
    return labels


def draw_posture(canvas: Canvas, box: Box) -> list[Label]:
    """A plate turned on the rotary axis, then tilted with it."""
    middle = 0.5 * (box[0] + box[2])
    boxes: tuple[Box, Box] = ((box[0], box[1], middle - 6, box[3]), (middle + 6, box[1], box[2], box[3]))
    theta, phi = np.radians(28.0), np.radians(55.0)
    labels: list[Label] = []
    for half, tilt in zip(boxes, (0.0, theta), strict=True):
        rotation = posture_rotation(elevation=tilt, rotation=phi)
        carried = posture_rotation(elevation=tilt, rotation=0.0)
        points = 60.0 * np.stack([X, -0.9 * X, 1.1 * Z, -0.6 * Z, -0.55 * Y])
        inner = (half[0] + 4, half[1] + 30, half[2] - 20, half[3] - 20)
        view = fit_view(points, elevation=np.radians(26.0), azimuth=np.radians(300.0), box=inner)
        pen = Pen(canvas, view, labels)
        before = posture_rotation(elevation=0.0, rotation=phi) if tilt else np.eye(3)
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
