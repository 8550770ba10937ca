"""A drawing of the rig as the program understands it; beside it its numbers, and the part on its stage."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from lightopt.core.arrays import Float64
from lightopt.core.transforms import Posture
from lightopt.geometry import RayCaster
from lightopt.lights import outlines
from lightopt.rendering import cast_rays_at
from lightopt.report import _rig_elements as elements
from lightopt.report._drawing import CAP_HEIGHT, FAINT, LINE_HEIGHT, SOFT, Box, Drawing, fit_text, fixed_style, sub
from lightopt.report._images import check_png_path, write_picture
from lightopt.report._rig_elements import (
    STAGE,
    CameraShape,
    Pen,
    degrees,
    number,
    part_box,
    rig_size,
    square,
    table_grid,
)
from lightopt.report._view import ParallelView, X, Y, Z, arc, cast_part, fit_view
from lightopt.scene import Scene, pixel_footprint

MAIN_WIDTH, LEAST_HEIGHT, MARGIN = 1060, 1080, 40
# of more lights than that only a few get arcs, which would hide each other; all angles are in the table
MOST_ARCS, FEW_ARCS = 6, 3
_ARC = 0.4  # radius of elevation arcs, relative to the light's distance
SIDE_WIDTH, EDGE = 500, 30
HEAD, TEXT, LABEL = 20, 16, 17  # sizes of text [px]
LINE = round(LINE_HEIGHT * TEXT)  # distance of lines [px]
STAGE_HEIGHT = 400  # least height of the picture of the stage [px]
MOST_POSTURES = 12  # more than that are only counted
_LIGHT_COLUMNS = (190, 250, 315, 440)  # where the columns of numbers in the table of lights end [px]
_STAGE_VIEW = (np.radians(22.0), np.radians(292.0))  # elevation and azimuth [rad]


def rig_drawing(scene: Scene, path: str | Path, *, overwrite: bool = True) -> Path:
    """Draw camera, panels, table, part and stage at their true places, with the angles that the rig file gives.

    A parallel view, true to scale: the world's axes, the camera with its viewing pyramid down to the table, each
    panel as its true rectangle, the part at its first posture, elevations θ from the table plane, azimuths φ from +X;
    beside it the part with the stage's axes, and the numbers.

    path: The PNG to make or to replace, in a folder that exists; it is returned.
    overwrite: Whether a file of other content may be replaced.
    Raises InputError: The file cannot be written, or one of other content is there and `overwrite` is False.
    """
    return write_picture(check_png_path(path), rig_image(scene), overwrite=overwrite)


@fixed_style()
def rig_image(scene: Scene) -> Image.Image:
    """The picture that :func:`rig_drawing` writes."""
    posture = scene.postures[0] if scene.postures else Posture(0.0, 0.0)
    caster = cast_rays_at(scene)
    shape = elements.camera_shape(scene.camera, 0.13 * rig_size(scene))
    height = max(LEAST_HEIGHT, _stage_top(scene) + STAGE_HEIGHT + EDGE)
    drawing = Drawing(MAIN_WIDTH + SIDE_WIDTH, height)
    pen = Pen(drawing, _view(scene, shape, posture, height), [])
    _draw_rig(scene, caster, shape, posture, pen)
    draw_stage(scene, caster, posture, drawing, MAIN_WIDTH)
    _write_numbers(drawing, scene, MAIN_WIDTH, grid=number(table_grid(scene, posture)[1]))
    drawing.labels(pen.labels, size=19, bounds=(8.0, 8.0, MAIN_WIDTH - 8.0, height - 8.0))
    return drawing.image()


def _view(scene: Scene, shape: CameraShape, posture: Posture, height: int) -> ParallelView:
    half, _ = table_grid(scene, posture)
    camera = scene.camera
    table = square(half, np.zeros(3))
    arrows = camera.position + shape.arrow * np.stack([camera.right, camera.up])
    axes = np.diag(_axis_lengths(scene, half))
    panels = [outlines(light).reshape(-1, 3) for light in scene.lights]
    points = np.concatenate([table, shape.body, arrows, axes, part_box(scene, posture), shape.footprint, *panels])
    # labels stand outside of what they name
    box = (MARGIN + 50.0, MARGIN + 20.0, MAIN_WIDTH - MARGIN - 50.0, height - MARGIN - 20.0)
    elevation, azimuth = _best_side(scene, posture)
    return fit_view(points, elevation=elevation, azimuth=azimuth, box=box)


def _best_side(scene: Scene, posture: Posture) -> tuple[float, float]:
    """From where part, camera and panels stand well apart and no panel edge-on, and X points to the right."""
    middle, size = part_box(scene, posture).mean(axis=0), rig_size(scene)
    things = np.stack([middle, scene.camera.position, *(light.centre for light in scene.lights)])
    best = (-math.inf, 0.0, 0.0)
    for elevation, azimuth in itertools.product((14, 17, 20, 23, 26), range(240, 301, 5)):
        side = ParallelView(math.radians(elevation), math.radians(azimuth), scale=1.0, offset=np.zeros(2))
        flat = side.place(things)
        gaps = np.linalg.norm(flat[:, None] - flat[None], axis=2)[np.triu_indices(len(flat), 1)]
        # from straight ahead, Y would be foreshortened to nothing; half a right angle off, X and Y look alike
        skew = abs(abs(azimuth - 270) - 20) / 45.0
        edge_on = min((abs(float(light.outward @ side.toward)) for light in scene.lights), default=1.0)
        score = min(float(gaps.min()) / size, 0.4) + min(edge_on, 0.3) - 0.05 * skew
        if score > best[0] + 1e-9:
            best = (score, side.elevation, side.azimuth)
    return best[1], best[2]


def _axis_lengths(scene: Scene, half: float) -> tuple[float, float, float]:
    return 1.08 * half, 1.08 * half, 0.45 * rig_size(scene)


def _draw_rig(scene: Scene, caster: RayCaster, shape: CameraShape, posture: Posture, pen: Pen) -> None:
    half, step = table_grid(scene, posture)
    pen.grid(half, step)
    pen.polygon(
        shape.footprint, fill="#45535f20", outline=elements.CAMERA, width=1.2
    )  # what the camera sees of the table
    part = cast_part(scene, caster, posture, pen.view)
    # what lies on the table is drawn around the part, what stands up may pass in front of it
    pen = replace(pen, part=part)
    pen.axes(_axis_lengths(scene, half))
    # channels of one light stand in one place
    first = scene.lights[: _arcs(scene)]
    arcs = list({(light.distance, light.elevation, light.azimuth): light for light in first}.values())
    reach = max(0.5 * half, *(float(np.hypot(*light.centre[:2])) for light in scene.lights), 0.0)
    for i, light in enumerate(arcs):
        pen.azimuth_arc(light, reach * (0.42 + 0.45 * (i + 1) / len(arcs)), spoke=_ARC * light.distance)
    part.draw(pen.drawing)
    devices = [*((light.centre, light) for light in scene.lights), (scene.camera.position, None)]
    for _, light in sorted(devices, key=lambda device: float(pen.view.nearness(device[0]))):
        if light is None:
            pen.camera(scene.camera, shape)
            continue
        pen.panel(light)
        if light in arcs:
            pen.elevation_arc(light, _ARC * light.distance)
    if scene.lights:
        least_foreshortened = max(scene.lights, key=lambda light: abs(float(light.outward @ pen.view.toward)))
        pen.panel_frame(least_foreshortened, 0.24 * rig_size(scene))


def _arcs(scene: Scene) -> int:
    return len(scene.lights) if len(scene.lights) <= MOST_ARCS else FEW_ARCS


def _stage_top(scene: Scene) -> int:
    """Where the numbers end and the picture of the stage begins [px]."""
    lines = len(_camera_lines(scene)) + len(scene.lights) + len(_part_lines(scene))
    return EDGE + round((lines + 6.5) * LINE)


def _write_numbers(drawing: Drawing, scene: Scene, left: int, *, grid: str) -> None:
    """Write the numbers of a rig into the column that starts at `left` [px]."""
    drawing.line(np.array([(left, EDGE), (left, drawing.height - EDGE)]), colour=FAINT, width=1.0)
    x = left + EDGE
    y = EDGE + CAP_HEIGHT * HEAD
    drawing.text(x, y, "Camera", size=HEAD)
    y = _write_lines(drawing, x, y, _camera_lines(scene)) + 2 * LINE
    drawing.text(x, y, "Lights", size=HEAD)
    _write_cells(drawing, x, y, ("θ", "φ", "mm", "panel, mm"))
    for light in scene.lights:
        y += LINE
        size = f"{number(light.size[0])} × {number(light.size[1])}"
        drawing.text(x, y, fit_text(light.name, TEXT, _LIGHT_COLUMNS[0] - 70), size=TEXT, colour=SOFT)
        _write_cells(drawing, x, y, (degrees(light.elevation), degrees(light.azimuth), number(light.distance), size))
    arcs = _arcs(scene)
    note = f"grid {grid} mm" + (f"; arcs of the first {arcs} lights" if arcs < len(scene.lights) else "")
    y = _write_lines(drawing, x, y + 4, [note]) - 4 + 2 * LINE
    drawing.text(x, y, "Part and stage", size=HEAD)
    _write_lines(drawing, x, y, _part_lines(scene))


def _write_lines(drawing: Drawing, x: float, y: float, lines: Sequence[str]) -> float:
    """Write lines below a baseline; the last one's baseline [px]."""
    for line in lines:
        y += LINE
        drawing.text(x, y, fit_text(line, TEXT, SIDE_WIDTH - 2 * EDGE), size=TEXT, colour=SOFT)
    return y


def _write_cells(drawing: Drawing, x: float, y: float, cells: Sequence[str]) -> None:
    for column, cell in zip(_LIGHT_COLUMNS, cells, strict=True):
        drawing.text(x + column, y, cell, size=TEXT, colour=SOFT, align="right")


def _camera_lines(scene: Scene) -> list[str]:
    camera = scene.camera
    distance = float(np.linalg.norm(camera.position))
    return [
        f"pinhole at {_vector(camera.position)} mm",
        f"{number(distance)} mm from the origin",
        f"image right {_vector(camera.right)}",
        f"image up {_vector(camera.up)}",
        f"{camera.width} × {camera.height} px, {number(pixel_footprint(camera, distance))} mm/px at the origin",
    ]


def _vector(values: Float64) -> str:
    return "(" + ", ".join(number(round(float(v), 3)) for v in values) + ")"


def _part_lines(scene: Scene) -> list[str]:
    low, high = scene.mesh.bounds
    size = " × ".join(number(float(f"{side:.3g}")) for side in high - low)
    lines = [f"{size} mm, pivot {_vector(scene.pivot)} mm"]
    for first in scene.postures[:1]:
        elevation, rotation = number(first.elevation_deg), number(first.rotation_deg)
        lines.append(f"drawn at {sub('θ', 'j')} {elevation}°, {sub('φ', 'j')} {rotation}°")
    rest = [str(posture).replace("-", "−") for posture in scene.postures[1:MOST_POSTURES]]
    if len(scene.postures) > MOST_POSTURES:
        rest.append(f"{len(scene.postures) - MOST_POSTURES} more")
    return lines + [("other postures " if i == 0 else "") + ", ".join(rest[i : i + 3]) for i in range(0, len(rest), 3)]


def draw_stage(scene: Scene, caster: RayCaster, posture: Posture, drawing: Drawing, left: int) -> Box:
    """Draw the part at a posture with the stage's axes, in the column from `left` [px] on; the box that it fills."""
    box = (left + EDGE, _stage_top(scene), left + SIDE_WIDTH - EDGE, drawing.height - EDGE)
    corners = part_box(scene, posture)
    radius = 0.5 * float(np.linalg.norm(np.ptp(scene.mesh.bounds, axis=0)))
    reach = 1.25 * float(np.linalg.norm(corners - scene.pivot, axis=1).max())
    (point, tilt), (rotation, translation) = scene.stage.tilt_axis, scene.stage.transform(posture)
    pivot, rotary = rotation @ scene.pivot + translation, rotation[:, 2]
    ends = np.stack([point + reach * tilt, point - 0.8 * reach * tilt])
    ends = np.concatenate([ends, pivot + reach * np.stack([rotary, -0.35 * rotary])])
    inner = (box[0] + 45, box[1] + 20, box[2] - 45, box[3] - 40)
    middle = corners.mean(axis=0)
    half, step = elements.round_up(1.05 * radius)
    shown = np.concatenate([corners, ends, square(half, middle)])
    elevation, azimuth = _STAGE_VIEW
    view = fit_view(shown, elevation=elevation, azimuth=azimuth, box=inner)
    pen = Pen(drawing, view, [])
    pen.grid(half, step, centre=middle)
    part = cast_part(scene, caster, posture, view)
    part.draw(drawing)
    pen = Pen(drawing, view, pen.labels, part)
    _draw_axes(pen, (point, tilt), (pivot, rotary), reach)
    pen.scale_bar(box[0], box[3] - 8, radius)
    drawing.labels(pen.labels, size=LABEL, bounds=box)
    return box


def _draw_axes(pen: Pen, tilt: tuple[Float64, Float64], rotary: tuple[Float64, Float64], reach: float) -> None:
    # a point and the direction of each axis
    pivot, z = rotary
    y = np.asarray(np.cross(z, X), np.float64)
    turned = -np.asarray(np.cross(y, z), np.float64), -y
    for (point, axis), (start, towards), back, letter, name in (
        (tilt, (-Y, -Z), 0.8, "θ", "tilt axis"),
        (rotary, turned, 0.35, "φ", "rotary axis"),
    ):
        pen.line(np.stack([point - back * reach * axis, point + reach * axis]), STAGE, 1.6, dash=(16, 5))
        centre = point + 0.86 * reach * axis
        path = arc(centre, start, towards, 1.6 * np.pi, 0.22 * reach)
        pen.arrow(path, STAGE, 2.2, head=12.0)
        pen.label(f"+{sub(letter, 'j')}", path[-1], STAGE, away_from=centre)
        pen.label(name, point + reach * axis, STAGE, away_from=point)
    flat = pen.view.place(pivot)
    hidden = pen.part is not None and bool(pen.part.hides(pivot[None])[0])
    pen.drawing.disc(flat, 4.0, fill="#ffffffc0" if hidden else STAGE, outline=STAGE)
    pen.label("pivot", pivot, STAGE)
