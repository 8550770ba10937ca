"""What a result depends on: files, options, versions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lightopt.config import PartConfig, RigConfig, input_hashes
from lightopt.core.provenance import provenance
from lightopt.design._options import OptimizeOptions
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.objectives._objective import Objective
from lightopt.scene import Scene


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
    return provenance(
        input_hashes(rig, part),
        {
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
    )


def _defect_options(options: OptimizeOptions, objectives: tuple[Objective, ...]) -> dict[str, Any]:
    # they matter to one objective only
    if not any(isinstance(objective, DetectabilityObjective) for objective in objectives):
        return {}
    return {"seen_in": options.seen_in, "threshold": options.contrast}
