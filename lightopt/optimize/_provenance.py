"""What a result depends on: files, options, versions."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from lightopt import __version__
from lightopt.config import PartConfig, RigConfig
from lightopt.images import file_sha256
from lightopt.optimize._detectability import Detectability
from lightopt.optimize._objective import Objective
from lightopt.optimize._options import OptimizeOptions
from lightopt.scene import Scene

__all__ = ["provenance_of", "versions"]


def provenance_of(
    rig: RigConfig,
    part: PartConfig,
    scene: Scene,
    options: OptimizeOptions,
    objectives: tuple[Objective, ...],
    *,
    report: bool,
) -> Mapping[str, Any]:
    """What ``result.json`` says a run depends on; the same whatever the folders that its files lie in.

    Parameters
    ----------
    rig, part, scene, options, objectives
        Of the run.
    report
        Whether report.html is part of it.
    """
    return {
        "versions": versions(),
        # names only, so that the same files give the same result wherever they lie
        "rig": {"file": rig.source.path.name, "sha256": rig.source.sha256},
        "part": {"file": part.source.path.name, "sha256": part.source.sha256},
        "mesh_sha256": file_sha256(part.source.resolve(part.mesh.file)),
        "options": {
            "objectives": [objective.name for objective in objectives],
            "step_deg": options.step_deg,
            "common_elevation": options.common_elevation,
            "common_lights": options.common_lights,
            "shade_below": options.shade_below,
            "postures": [posture.as_dict() for posture in scene.postures],
            "points": options.points,
            "shadows": options.shadows,
            "patch_budget": options.patch_budget,
            "max_combinations": options.limit,
            "ranking_rows": options.rows,
            "images": options.images,
            **_defect_options(options, objectives),
            "report": report,
            **options.plan,
        },
    }


def _defect_options(options: OptimizeOptions, objectives: tuple[Objective, ...]) -> dict[str, Any]:
    # they matter to one objective only
    if not any(isinstance(objective, Detectability) for objective in objectives):
        return {}
    return {"seen_in": options.seen_in, "threshold": options.contrast}


def versions() -> dict[str, str]:
    """Of lightopt, and of the packages that levels and rays depend on."""
    packages = ("cascadio", "embreex", "numba", "numpy", "trimesh")
    return {"lightopt": __version__, **{name: version(name) for name in packages}}
