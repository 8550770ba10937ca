"""A drawing of the rig as the program understands it, and beside it the part on its stage."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lightopt.core.transforms import Posture
from lightopt.lights import outlines
from lightopt.report import _rig_elements as elements
from lightopt.report._pictures import DPI, INK, POINT, check_png_path, figure_image, fixed_style, write_picture
from lightopt.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from PIL import Image


WIDTH, HEIGHT, TITLE = 1560, 1080, 15  # of the picture, and size of the titles [px]
MOST_ARCS, FEW_ARCS = 6, 3  # of more lights than that only a few get arcs, which would hide each other
RIG_VIEW = elements.ParallelView(elevation=np.radians(20.0), azimuth=np.radians(290.0))
STAGE_VIEW = elements.ParallelView(elevation=np.radians(22.0), azimuth=np.radians(292.0))


def rig_drawing(scene: Scene, path: str | Path, *, overwrite: bool = True) -> Path:
    """Draw camera, panels, table, part and stage at their true places, with the angles that the rig file gives.

    A parallel view, true to scale: the world's axes, the camera with its viewing pyramid down to the table, each
    panel as its true rectangle, the part at its first posture, elevations θ from the table plane, azimuths φ from +X;
    beside it the part with the stage's axes.

    Raises InputError: The file cannot be written, or one of other content is there and `overwrite` is False.
    """
    return write_picture(check_png_path(path), rig_image(scene), overwrite=overwrite)


@fixed_style()
def rig_image(scene: Scene) -> Image.Image:
    """The picture that :func:`rig_drawing` writes."""
    from matplotlib.figure import Figure

    posture = scene.postures[0] if scene.postures else Posture(0.0, 0.0)
    figure = Figure(figsize=(WIDTH / DPI, HEIGHT / DPI), dpi=DPI)
    rig, stage = figure.subplots(1, 2, width_ratios=(2.0, 1.0))
    figure.subplots_adjust(left=0.03, right=0.95, bottom=0.03, top=0.95, wspace=0.03)
    for axes in (rig, stage):
        axes.set_axis_off()
        axes.margins(0.08)  # for labels
    draw_rig(rig, scene, posture)
    draw_stage(stage, scene, posture)
    return figure_image(figure)


def draw_rig(axes: Axes, scene: Scene, posture: Posture) -> None:
    size = elements.rig_size(scene)
    under = [np.abs(outlines(light)[..., :2]).max() for light in scene.lights]
    part = np.abs(elements.part_box(scene, posture)[:, :2]).max()
    half, step = elements.round_up(max([*under, 1.2 * part, 0.4 * size]))
    shape = elements.camera_shape(scene.camera, 0.13 * size)
    pen = elements.Pen(axes, RIG_VIEW)
    pen.grid(half, step)
    axes.set_title(f"grid {step:g} mm", fontsize=TITLE * POINT, color=INK)
    # what the camera sees of the table
    pen.polygon(shape.footprint, fill=f"{elements.CAMERA}20", outline=elements.CAMERA, width=1.2)
    pen.axes_of_world((1.08 * half, 1.08 * half, 0.45 * size))
    # channels of one light stand in one place
    first = scene.lights[: MOST_ARCS if len(scene.lights) <= MOST_ARCS else FEW_ARCS]
    arcs = list({(light.distance, light.elevation, light.azimuth): light for light in first}.values())
    reach = max([0.5 * half, *(float(np.hypot(*light.centre[:2])) for light in scene.lights)])
    for i, light in enumerate(arcs):
        pen.azimuth_arc(light, reach * (0.42 + 0.45 * (i + 1) / len(arcs)), spoke=0.4 * light.distance)
    # what lies on the table is drawn around the part, what stands up passes in front of it
    pen.part(scene, posture)
    for light in sorted(scene.lights, key=lambda one: float(pen.view.nearness(one.centre))):
        pen.panel(light)
        if light in arcs:
            pen.elevation_arc(light, 0.4 * light.distance)
    pen.camera(scene.camera, shape)
    if scene.lights:
        least_foreshortened = max(scene.lights, key=lambda light: abs(float(light.outward @ pen.view.toward)))
        at, length = least_foreshortened.centre, 0.24 * size
        pen.named_arrow(at, at + length * least_foreshortened.across, "e_φ", elements.PHI)
        pen.named_arrow(at, at + length * least_foreshortened.along, "e_θ", elements.THETA)


def draw_stage(axes: Axes, scene: Scene, posture: Posture) -> None:
    corners, pen = elements.part_box(scene, posture), elements.Pen(axes, STAGE_VIEW)
    reach = 1.25 * float(np.linalg.norm(corners - scene.pivot, axis=1).max())
    half, step = elements.round_up(0.525 * float(np.linalg.norm(np.ptp(scene.mesh.bounds, axis=0))))
    pen.grid(half, step, centre=corners.mean(axis=0))
    title = f"the part in posture {posture}, grid {step:g} mm".replace("-", "−")
    axes.set_title(title, fontsize=TITLE * POINT, color=INK)
    (point, tilt), (rotation, translation) = scene.stage.tilt_axis, scene.stage.transform(posture)
    pivot, z = rotation @ scene.pivot + translation, rotation[:, 2]
    y = np.asarray(np.cross(z, elements.X), np.float64)
    for place, axis, start, towards, back, letter, name in (
        (point, tilt, -elements.Y, -elements.Z, 0.8, "θ", "tilt axis"),
        (pivot, z, -np.asarray(np.cross(y, z), np.float64), -y, 0.35, "φ", "rotary axis"),
    ):
        pen.line(np.stack([place - back * reach * axis, place + reach * axis]), elements.STAGE, 1.6, dash="--")
        centre = place + 0.86 * reach * axis
        path = elements.arc(centre, start, towards, 1.6 * np.pi, 0.22 * reach)
        pen.arrow(path, elements.STAGE)
        pen.label(f"+{letter}", path[len(path) // 2], elements.STAGE, away_from=centre)
        pen.label(name, place + reach * axis, elements.STAGE, away_from=place)
    pen.part(scene, posture)
    pen.label("pivot", pivot, elements.STAGE, away_from=pivot + elements.Z)
    pen.axes.plot(*pen.view.place(pivot), "o", color=elements.STAGE, zorder=2)
