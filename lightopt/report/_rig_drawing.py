"""A drawing of the rig as the program understands it."""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from lightopt.core.transforms import Posture
from lightopt.geometry import RayCaster
from lightopt.rendering import cast_rays_at
from lightopt.report._drawing import Drawing, fixed_style
from lightopt.report._images import check_png_path, write_picture
from lightopt.report._part_picture import cast_part
from lightopt.report._rig_elements import Pen, number
from lightopt.report._rig_shapes import CameraShape, camera_shape, part_box, rig_size, square, table_grid
from lightopt.report._rig_stage_and_numbers import SIDE_WIDTH, draw_stage, side_height, write_numbers
from lightopt.report._view import ParallelView, fit_view
from lightopt.scene import PanelLight, Scene, panel_corners

MAIN_WIDTH, LEAST_HEIGHT, MARGIN = 1060, 1080, 40
# of more lights than that only a few get arcs, which would hide each other; all angles are in the table
MOST_ARCS, FEW_ARCS = 6, 3

_ARC = 0.4  # radius of elevation arcs, relative to the light's distance


def rig_drawing(scene: Scene, path: str | Path, *, annotate: bool = True, overwrite: bool = True) -> Path:
    """Draw camera, panels, table, part and stage at their true places, with the angles that the rig file gives.

    A parallel view, true to scale: the world's axes, the camera with its viewing pyramid down to the table, each
    panel as its true rectangle, the part at its first posture, elevations θ from the table plane, azimuths φ from +X;
    beside it the part with the stage's axes, and the numbers.

    path: The PNG to make or to replace, in a folder that exists; it is returned.
    annotate: Whether angles and axes are drawn and named.
    overwrite: Whether a file of other content may be replaced.
    Raises InputError: The file cannot be written, or one of other content is there and `overwrite` is False.
    """
    path = check_png_path(path)
    return write_picture(path, rig_image(scene, annotate=annotate), overwrite=overwrite)


@fixed_style()
def rig_image(scene: Scene, *, annotate: bool = True) -> Image.Image:
    """The picture that :func:`rig_drawing` writes."""
    posture = scene.postures[0] if scene.postures else Posture(0.0, 0.0)
    caster = cast_rays_at(scene)
    shape = camera_shape(scene.camera, 0.13 * rig_size(scene))
    height = max(LEAST_HEIGHT, side_height(scene))
    drawing = Drawing(MAIN_WIDTH + SIDE_WIDTH, height)
    pen = Pen(drawing, _view(scene, shape, posture, height), [])
    _draw_rig(scene, caster, shape, posture, pen, annotate=annotate)
    draw_stage(scene, caster, posture, drawing, MAIN_WIDTH, annotate=annotate)
    write_numbers(
        drawing, scene, MAIN_WIDTH, grid=number(table_grid(scene, posture)[1]), arcs=_arcs(scene) if annotate else None
    )
    drawing.labels(pen.labels, size=19, bounds=(8.0, 8.0, MAIN_WIDTH - 8.0, height - 8.0))
    return drawing.image()


def _view(scene: Scene, shape: CameraShape, posture: Posture, height: int) -> ParallelView:
    half, _ = table_grid(scene, posture)
    camera = scene.camera
    table = square(half, np.zeros(3))
    arrows = camera.position + shape.arrow * np.stack([camera.right, camera.up])
    axes = np.diag(_axis_lengths(scene, half))
    panels = [panel_corners(light) for light in scene.lights]
    points = np.concatenate([table, shape.body, arrows, axes, part_box(scene, posture), shape.footprint, *panels])
    elevation, azimuth = _best_side(scene, posture)
    # labels stand outside of what they name
    box = (MARGIN + 50.0, MARGIN + 20.0, MAIN_WIDTH - MARGIN - 50.0, height - MARGIN - 20.0)
    return fit_view(points, elevation=elevation, azimuth=azimuth, box=box)


def _best_side(scene: Scene, posture: Posture) -> tuple[float, float]:
    """From where part, camera and panels stand well apart and no panel edge-on, and X points to the right."""
    things = np.stack(
        [part_box(scene, posture).mean(axis=0), scene.camera.position, *(light.centre for light in scene.lights)]
    )
    size = rig_size(scene)
    best = (-math.inf, 0.0, 0.0)
    for elevation, azimuth in itertools.product((14, 17, 20, 23, 26), range(240, 301, 5)):
        side = ParallelView(
            elevation=math.radians(elevation), azimuth=math.radians(azimuth), scale=1.0, offset=np.zeros(2)
        )
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


def _draw_rig(
    scene: Scene, caster: RayCaster, shape: CameraShape, posture: Posture, pen: Pen, *, annotate: bool
) -> None:
    half, step = table_grid(scene, posture)
    pen.grid(half, step)
    pen.footprint(shape)
    part = cast_part(scene, caster, posture, pen.view)
    # what lies on the table is drawn around the part, what stands up may pass in front of it
    pen = replace(pen, part=part)
    pen.axes(_axis_lengths(scene, half))
    arcs = scene.lights[: _arcs(scene)] if annotate else ()
    reach = max(0.5 * half, *(float(np.hypot(*light.centre[:2])) for light in scene.lights), 0.0)
    for i, light in enumerate(arcs):
        pen.azimuth_arc(light, reach * (0.42 + 0.45 * (i + 1) / len(arcs)), spoke=_ARC * light.distance)
    part.draw(pen.drawing)
    devices = [*((light.centre, light) for light in scene.lights), (scene.camera.position, None)]
    for _, light in sorted(devices, key=lambda device: float(pen.view.nearness(device[0]))):
        if light is None:
            pen.camera(scene.camera, shape, annotate=annotate)
            continue
        pen.panel(light)
        if light in arcs:
            pen.elevation_arc(light, _ARC * light.distance)
    if annotate and scene.lights:
        pen.panel_frame(_most_open(scene.lights, pen.view), 0.24 * rig_size(scene))


def _arcs(scene: Scene) -> int:
    return len(scene.lights) if len(scene.lights) <= MOST_ARCS else FEW_ARCS


def _most_open(lights: tuple[PanelLight, ...], view: ParallelView) -> PanelLight:
    """The light whose panel the view shows least foreshortened."""
    return max(lights, key=lambda light: abs(float(light.outward @ view.toward)))
