"""All checks, in the order of their findings."""

from collections.abc import Callable, Iterable

from lightopt.config import PartConfig, RigConfig
from lightopt.preflight._camera import (
    check_below_table,
    check_depth,
    check_field_of_view,
    check_lens,
    check_part_in_view,
    check_pixels,
    check_resolution,
    check_sensor,
)
from lightopt.preflight._findings import CheckedRig, CheckedScene, CheckResult, Finding, prepare_scene
from lightopt.preflight._highlights import check_facets, check_levels, check_points
from lightopt.preflight._lights import (
    check_below_horizon,
    check_collisions,
    check_hidden_part,
    check_lights_in_part,
    check_lights_in_view,
)
from lightopt.preflight._part import check_back_faces, check_mesh, check_size, check_unseen_surface
from lightopt.scene import build_camera, build_lights, build_scene

RIG_CHECKS: tuple[Callable[[CheckedRig], Iterable[Finding]], ...] = (
    check_lens,
    check_resolution,
    check_field_of_view,
    check_sensor,
    check_lights_in_view,
    check_below_horizon,
    check_collisions,
)

SCENE_CHECKS: tuple[Callable[[CheckedScene], Iterable[Finding]], ...] = (
    check_size,
    check_mesh,
    check_depth,
    check_part_in_view,
    check_pixels,
    check_below_table,
    check_lights_in_part,
    check_hidden_part,
    check_points,
    check_levels,
    check_facets,
    check_back_faces,
    check_unseen_surface,
)


def check_rig(rig: RigConfig) -> CheckResult:
    """Check a rig alone; InputError when the lens model folds the image over."""
    return CheckResult(_run_rig(rig))


def check_scene(rig: RigConfig, part: PartConfig) -> CheckResult:
    """Check a rig and a part on it, in all the part's postures.

    Raises InputError: the scene cannot be built (see :func:`lightopt.scene.build_scene`).
    """
    checked = prepare_scene(rig, part, build_scene(rig, part))
    return CheckResult((*_run_rig(rig), *(finding for check in SCENE_CHECKS for finding in check(checked))))


def _run_rig(rig: RigConfig) -> tuple[Finding, ...]:
    checked = CheckedRig(rig, build_camera(rig), build_lights(rig))
    return tuple(finding for check in RIG_CHECKS for finding in check(checked))
