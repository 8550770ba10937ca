"""Checks before rendering: no panel is inside the part, and enough pixels see the part."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lightopt.config import PartConfig, RigConfig
from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError, counted
from lightopt.core.transforms import Posture
from lightopt.geometry import RayCaster, points_inside
from lightopt.lights import PanelLight, SurfaceLight, outlines, panel_grid
from lightopt.rendering._surface import trace_hits
from lightopt.scene import PartView, Scene, pixel_footprint, screen_window, unit_hint, view_from_part

PANEL_POINTS = 25  # points of a panel that are tried
LEAST_PIXELS = 16  # least number of pixels that see the part, in the posture that shows it best
BLOCK_RAYS = 65_536


class PanelInPart(NamedTuple):
    """A panel that is inside the part, wholly or in places."""

    light: str
    posture: Posture
    share: float  # of the panel that is inside
    text: str


def panels_in_part(scene: Scene) -> tuple[PanelInPart, ...]:
    """Panels that are inside the part, posture by posture."""
    found: list[PanelInPart] = []
    low, high = scene.mesh.bounds
    margin = 1e-6 * float(np.linalg.norm(high - low))
    everywhere = [_panel_points(light) for light in scene.lights]
    together = np.concatenate([np.zeros((0, 3)), *everywhere])
    first = np.cumsum([0, *map(len, everywhere)])
    for posture in scene.postures:
        # of thousands of panels, all points at once: hardly any is near the part
        rotation, translation = scene.stage.transform(posture)
        places = (together - translation) @ rotation
        near = np.flatnonzero(np.all((places >= low - margin) & (places <= high + margin), axis=1))
        lights = np.unique(np.searchsorted(first, near, side="right") - 1)
        some = replace(scene, lights=tuple(scene.lights[i] for i in lights))
        for light in view_from_part(some, posture).lights:
            points = _panel_points(light)
            inside = int(np.count_nonzero(points_inside(points, scene.mesh)))
            if inside:
                text = (
                    f"posture {posture}: {inside} of {len(points)} points all over {light.name}'s panel are "
                    "inside the part; check the mesh's units, its placement, and the light's distance of "
                    f"{light.distance:g} mm"
                )
                found.append(PanelInPart(light.name, posture, inside / len(points), text))
    return tuple(found)


def _panel_points(light: PanelLight) -> Float64:
    if isinstance(light, SurfaceLight):
        return np.concatenate([light.targets, outlines(light).reshape(-1, 3)])
    return panel_grid(light, PANEL_POINTS)


def too_few_pixels(scene: Scene, caster: RayCaster) -> tuple[int, str] | None:
    """How many pixels see the part in the posture that shows it best, and a text; None where they are enough."""
    most = 0
    for posture in scene.postures:
        most = max(most, _pixels(scene, view_from_part(scene, posture), caster))
        if most >= LEAST_PIXELS:
            return None
    low, high = scene.mesh.bounds
    size = " × ".join(f"{side:.4g}" for side in high - low)
    distance = float(np.linalg.norm(scene.camera.position))
    pixels = counted(most, "pixel") if most else "no pixel"
    text = (
        f"{pixels} on the part at best, in any posture: it measures {size} mm, and a pixel's footprint is "
        f"{pixel_footprint(scene.camera, distance):.3g} mm; check the mesh's units, the part's placement and the "
        "camera's lens"
    )
    return most, text


def refuse_unusable_scene(scene: Scene, rig: RigConfig, part: PartConfig, caster: RayCaster) -> None:
    """Refuse to render what :func:`panels_in_part` or :func:`too_few_pixels` finds.

    Raises InputError: With one message for each thing found, and where it comes from
    """
    index = {light.name: i for i, light in enumerate(rig.lights)}
    problems = [f"{rig.source.at('lights', index[panel.light])}: {panel.text}" for panel in panels_in_part(scene)]
    unseen = too_few_pixels(scene, caster)
    if unseen is not None:
        problems += [f"{part.source.at('mesh', 'file')}: {unseen[1]}", *unit_hint(part, scene)]
    if problems:
        raise InputError(*problems)


def _pixels(scene: Scene, view: PartView, caster: RayCaster) -> int:
    # from the middle of the part's window outwards, until enough pixels are found
    left, top, right, bottom = screen_window(view.camera, scene.mesh)
    step = max(1, BLOCK_RAYS // max(1, right - left))
    starts = sorted(range(top, bottom, step), key=lambda row: abs(row + 0.5 * step - 0.5 * (top + bottom)))
    count = 0
    for start in starts:
        columns, rows = np.meshgrid(
            np.arange(left, right, dtype=np.float64) + 0.5,
            np.arange(start, min(start + step, bottom), dtype=np.float64) + 0.5,
        )
        hits = trace_hits(caster, scene.mesh, view.camera, columns.ravel(), rows.ravel())
        count += len(hits.ray)
        if count >= LEAST_PIXELS:
            break
    return count
