"""All checks, in the order of their findings."""

from collections.abc import Callable, Iterable

from lightopt.config import PartConfig, RigConfig
from lightopt.preflight import _camera, _highlights, _lights, _part
from lightopt.preflight._findings import CheckedRig, CheckedScene, CheckResult, Finding, sample_posture
from lightopt.rendering import cast_rays_at
from lightopt.scene import build_camera, build_lights, build_scene

RIG_CHECKS: tuple[Callable[[CheckedRig], Iterable[Finding]], ...] = (
    _camera.check_lens,
    _camera.check_resolution,
    _camera.check_field_of_view,
    _camera.check_sensor,
    _lights.check_lights_in_view,
    _lights.check_below_horizon,
    _lights.check_collisions,
)

SCENE_CHECKS: tuple[Callable[[CheckedScene], Iterable[Finding]], ...] = (
    _part.check_size,
    _part.check_mesh,
    _camera.check_depth,
    _camera.check_part_in_view,
    _camera.check_pixels,
    _camera.check_below_table,
    _lights.check_lights_in_part,
    _lights.check_hidden_part,
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
    """Check a rig and a part on it, in all the part's postures.

    Raises InputError: the scene cannot be built (see :func:`lightopt.scene.build_scene`).
    """
    scene = build_scene(rig, part)
    caster = cast_rays_at(scene)
    samples = tuple(sample_posture(scene, posture, caster) for posture in scene.postures)
    checked = CheckedScene(rig, part, scene, caster, samples)
    findings = (finding for check in SCENE_CHECKS for finding in check(checked))
    return CheckResult((*check_rig(rig).findings, *findings))
