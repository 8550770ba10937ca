"""Conventions of directions and lights, drawn."""

from __future__ import annotations

import numpy as np

from lightopt.core.transforms import azimuth_tangent, direction, elevation_tangent
from lightopt.report._canvas import Canvas
from lightopt.report._frames_pen import E_PHI, E_THETA, fit_pen, named_arrow
from lightopt.report._labels import Box, Label
from lightopt.report._rig_elements import INK, LIGHT, PHI, SOFT, THETA
from lightopt.report._rig_shapes import foot_direction, panel_corners, square
from lightopt.report._view import ORIGIN, X, Y, Z, arc
from lightopt.scene import panel_grid, place_light


def draw_direction(canvas: Canvas, box: Box) -> list[Label]:
    """A direction d with its angles and tangents."""
    angles = {"elevation": np.radians(48.0), "azimuth": np.radians(60.0)}
    d = 100.0 * direction(**angles)
    e_theta = 40.0 * elevation_tangent(**angles)
    e_phi = 40.0 * azimuth_tangent(azimuth=angles["azimuth"])
    points = np.concatenate([square(62.0, ORIGIN), [d + e_theta, d + e_phi, 80 * Z]])
    pen = fit_pen(canvas, box, points, elevation=28.0, azimuth=338.0)
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


def draw_zenith(canvas: Canvas, box: Box) -> list[Label]:
    """Directions of growing elevation, seen from the side."""
    points = np.array([[-58.0, 0.0, -8.0], [118.0, 0.0, -8.0], [0.0, 0.0, 122.0]])
    # seen from −Y, so that the plane of azimuth 0 is the picture's
    pen = fit_pen(canvas, box, points, elevation=0.0, azimuth=270.0)
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


def draw_light(canvas: Canvas, box: Box) -> list[Label]:
    """A panel with its points, facing the origin."""
    light = place_light(
        name="panel",
        distance=100.0,
        elevation=np.radians(50.0),
        azimuth=np.radians(75.0),
        size=(62.0, 44.0),
        points=9,
    )
    corners = panel_corners(light)
    points = np.concatenate([square(42.0, ORIGIN), corners, [light.centre + 52 * light.across]])
    pen = fit_pen(canvas, box, points, elevation=14.0, azimuth=285.0)
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
        pen.canvas.disc(pen.view.place(point), 3.0, fill="#7a5600")
    pen.arrow(np.stack([light.centre, 0.0 * light.centre]), LIGHT, 2.2)
    pen.label("−d", 0.45 * light.centre, LIGHT, away_from=0.45 * light.centre - 10.0 * foot)
    named_arrow(pen, light.centre, light.centre + 50.0 * light.across, E_PHI, PHI)
    named_arrow(pen, light.centre, light.centre + 40.0 * light.along, E_THETA, THETA)
    return pen.labels
