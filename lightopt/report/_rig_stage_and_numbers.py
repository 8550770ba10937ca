"""Beside the drawing of a rig: its numbers, and the part on its stage."""

from collections.abc import Sequence

import numpy as np

from lightopt.core.transforms import Posture, posture_rotation
from lightopt.geometry import RayCaster
from lightopt.report._drawing import CAP_HEIGHT, FAINT, LINE_HEIGHT, SOFT, Box, Drawing, Label, fit_text, sub
from lightopt.report._part_picture import cast_part
from lightopt.report._rig_elements import STAGE, Pen, degrees, number
from lightopt.report._rig_shapes import part_box, round_up, square
from lightopt.report._view import X, Y, Z, arc, fit_view
from lightopt.scene import Scene, pixel_footprint

SIDE_WIDTH, EDGE = 500, 30
HEAD, TEXT, LABEL = 20, 16, 17  # sizes of text [px]
LINE = round(LINE_HEIGHT * TEXT)  # distance of lines [px]
STAGE_HEIGHT = 400  # least height of the picture of the stage [px]
MOST_POSTURES = 12  # more than that are only counted
_LIGHT_COLUMNS = (190, 250, 315, 440)  # where the columns of numbers in the table of lights end [px]

_VIEW = (np.radians(22.0), np.radians(292.0))


def side_height(scene: Scene) -> int:
    """Height that numbers and stage need [px]."""
    return _stage_top(scene) + STAGE_HEIGHT + EDGE


def _stage_top(scene: Scene) -> int:
    """Where the numbers end and the picture of the stage begins [px]."""
    lines = len(_camera_lines(scene)) + len(scene.lights) + len(_part_lines(scene))
    return EDGE + round((lines + 6.5) * LINE)


def write_numbers(drawing: Drawing, scene: Scene, left: int, *, grid: str, arcs: int | None) -> None:
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
    some = arcs is not None and arcs < len(scene.lights)
    note = f"grid {grid} mm" + (f"; arcs of the first {arcs} lights" if some else "")
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


def _vector(values: np.ndarray) -> str:
    return "(" + ", ".join(number(round(float(v), 3)) for v in values) + ")"


def _part_lines(scene: Scene) -> list[str]:
    low, high = scene.mesh.bounds
    size = " × ".join(number(float(f"{side:.3g}")) for side in high - low)
    listed = [_posture_text(posture) for posture in scene.postures[:MOST_POSTURES]]
    lines = [f"{size} mm, pivot {_vector(scene.pivot)} mm"]
    if scene.postures:
        first = scene.postures[0]
        lines.append(
            f"drawn at {sub('θ', 'j')} {_angle(first.elevation_deg)}, {sub('φ', 'j')} {_angle(first.rotation_deg)}"
        )
    rest = listed[1:]
    if len(scene.postures) > MOST_POSTURES:
        rest.append(f"{len(scene.postures) - MOST_POSTURES} more")
    return lines + [("other postures " if i == 0 else "") + ", ".join(rest[i : i + 3]) for i in range(0, len(rest), 3)]


def _posture_text(posture: Posture) -> str:
    return f"({_angle(posture.elevation_deg)}, {_angle(posture.rotation_deg)})"


def _angle(degrees: float) -> str:
    return f"{number(degrees)}°"


def draw_stage(
    scene: Scene, caster: RayCaster, posture: Posture, drawing: Drawing, left: int, *, annotate: bool
) -> Box:
    """Draw the part at a posture with the stage's axes, in the column from `left` [px] on; the box that it fills."""
    box = (left + EDGE, _stage_top(scene), left + SIDE_WIDTH - EDGE, drawing.height - EDGE)
    corners = part_box(scene, posture)
    radius = 0.5 * float(np.linalg.norm(np.ptp(scene.mesh.bounds, axis=0)))
    reach = 1.25 * float(np.linalg.norm(corners - scene.pivot, axis=1).max())
    rotary = posture_rotation(elevation=np.radians(posture.elevation_deg), rotation=0.0)
    ends = scene.pivot + reach * np.stack([X, -0.8 * X, rotary[:, 2], -0.35 * rotary[:, 2]])
    inner = (box[0] + 45, box[1] + 20, box[2] - 45, box[3] - 40)
    middle = corners.mean(axis=0)
    half, step = round_up(1.05 * radius)
    view = fit_view(
        np.concatenate([corners, ends, square(half, middle)]), elevation=_VIEW[0], azimuth=_VIEW[1], box=inner
    )
    pen = Pen(drawing, view, [])
    pen.grid(half, step, centre=middle)
    part = cast_part(scene, caster, posture, view)
    part.draw(drawing)
    pen = Pen(drawing, view, pen.labels, part)
    if annotate:
        _draw_axes(pen, scene, posture, reach)
    length = pen.scale_bar(box[0], box[3] - 8, radius)
    pen.labels.append(Label(text=length, anchor=(box[0] + 4, box[3] - 14), colour=SOFT, away=(0.3, -1.0)))
    drawing.labels(pen.labels, size=LABEL, bounds=box)
    return box


def _draw_axes(pen: Pen, scene: Scene, posture: Posture, reach: float) -> None:
    pivot, ring = scene.pivot, 0.22 * reach
    tilted = posture_rotation(elevation=np.radians(posture.elevation_deg), rotation=0.0)
    x, y, z = tilted.T
    pen.line(np.stack([pivot - 0.8 * reach * X, pivot + reach * X]), STAGE, 1.6, dash=(16, 5))
    pen.line(np.stack([pivot - 0.35 * reach * z, pivot + reach * z]), STAGE, 1.6, dash=(16, 5))
    for axis, start, towards, letter, name in ((X, -Y, -Z, "θ", "tilt axis"), (z, -x, -y, "φ", "rotary axis")):
        centre = pivot + 0.86 * reach * axis
        path = arc(centre, start, towards, 1.6 * np.pi, ring)
        pen.arrow(path, STAGE, 2.2, head=12.0)
        pen.label(f"+{sub(letter, 'j')}", path[-1], STAGE, away_from=centre)
        pen.label(name, pivot + reach * axis, STAGE, away_from=pivot)
    flat = pen.view.place(pivot)
    hidden = pen.part is not None and bool(pen.part.hides(pivot[None])[0])
    pen.drawing.disc(flat, 4.0, fill="#ffffffc0" if hidden else STAGE, outline=STAGE)
    pen.label("pivot", pivot, STAGE)
