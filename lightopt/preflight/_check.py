"""All checks, in the order of their findings."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from lightopt.config import PartConfig, RigConfig
from lightopt.core.transforms import Posture
from lightopt.geometry import RayCaster
from lightopt.preflight import _camera, _fields, _highlights, _lights, _part
from lightopt.preflight._findings import CheckedRig, CheckedScene, CheckResult, Finding, PostureSamples
from lightopt.rendering import cast_rays_at, trace_samples
from lightopt.scene import Scene, build_camera, build_lights, build_scene, frame_part, screen_window, view_from_part

SAMPLES = 60_000  # camera rays per posture at most: counts of pixels are estimates from these

RIG_CHECKS: tuple[Callable[[CheckedRig], Iterable[Finding]], ...] = (
    _camera.check_lens,
    _camera.check_depth_of_field,
    _camera.check_resolution,
    _camera.check_field_of_view,
    _camera.check_sensor,
    _lights.check_lights_in_view,
    _lights.check_image_count,
    _lights.check_housings,
    _lights.check_below_horizon,
    _lights.check_collisions,
)

SCENE_CHECKS: tuple[Callable[[CheckedScene], Iterable[Finding]], ...] = (
    _part.check_size,
    _part.check_mesh,
    _part.check_regions,
    _part.check_brushing,
    _camera.check_depth,
    _camera.check_focus,
    _camera.check_motion,
    _camera.check_part_in_view,
    _camera.check_pixels,
    _camera.check_below_table,
    _lights.check_lights_in_part,
    _lights.check_hidden_part,
    _fields.check_fields,
    _fields.check_camera_hole,
    _fields.check_mirrored_part,
    _fields.check_stripes,
    _highlights.check_points,
    _highlights.check_levels,
    _highlights.check_facets,
    _part.check_back_faces,
    _part.check_unseen_surface,
)


def check_rig(rig: RigConfig) -> CheckResult:
    """Check a rig alone; InputError when the lens model folds the image over."""
    checked = CheckedRig(rig, build_camera(rig), build_lights(rig))
    return CheckResult(tuple(finding for check in RIG_CHECKS for finding in check(checked)))


def check_scene(rig: RigConfig, part: PartConfig) -> CheckResult:
    """Check a rig and a part on it, in all the part's postures; InputError where the scene cannot be built."""
    scene = build_scene(rig, part)
    caster = cast_rays_at(scene)
    samples = tuple(_sample_posture(scene, posture, caster) for posture in scene.postures)
    checked = CheckedScene(rig, part, scene, caster, samples)
    findings = (finding for check in SCENE_CHECKS for finding in check(checked))
    return CheckResult((*check_rig(rig).findings, *findings))


def _sample_posture(scene: Scene, posture: Posture, caster: RayCaster) -> PostureSamples:
    # cast a grid of camera rays
    view = view_from_part(scene, posture)
    left, top, right, bottom = screen_window(view.camera, scene.mesh)
    step = max(1, math.ceil(math.sqrt((right - left) * (bottom - top) / SAMPLES)))
    columns, rows = np.meshgrid(
        np.arange(left + step // 2, right, step, dtype=np.float64) + 0.5,
        np.arange(top + step // 2, bottom, step, dtype=np.float64) + 0.5,
    )
    whole = replace(view.camera, obstructions=None)
    hits, surface = trace_samples(caster, scene.mesh, whole, columns.ravel(), rows.ravel())
    return PostureSamples(posture, view, frame_part(view.camera, scene.mesh), step, hits, surface)
