"""What a result depends on: files, options, versions; the same whatever the folders that its files lie in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lightopt.config import PartConfig, RigConfig, input_hashes
from lightopt.core.provenance import provenance
from lightopt.design._options import OptimizeOptions, PlanOptions
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.objectives._objective import Objective
from lightopt.scene import Scene


def run_provenance(
    rig: RigConfig,
    part: PartConfig,
    scene: Scene,
    options: OptimizeOptions,
    plan: PlanOptions,
    objectives: tuple[Objective, ...],
) -> Mapping[str, Any]:
    """What ``result.json`` says a run depends on."""
    of_defects = any(isinstance(objective, DetectabilityObjective) for objective in objectives)
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
            **(_defect_facts(options) if of_defects else {}),
            "report": options.report,
            **_plan_facts(options, plan),
        },
    )


def known_provenance(
    rig: RigConfig, part: PartConfig, options: OptimizeOptions, plan: PlanOptions
) -> Mapping[str, Any]:
    """The part of it that is known before postures are chosen."""
    return provenance(
        input_hashes(rig, part),
        {
            "step_deg": options.step_deg,
            "common_elevation": options.common_elevation,
            "points": options.points,
            "shadows": options.shadows,
            "patch_budget": options.patch_budget,
            **_plan_facts(options, plan),
        },
    )


def _defect_facts(options: OptimizeOptions) -> dict[str, Any]:
    return {"seen_in": options.seen_in, "threshold": options.contrast}


def _plan_facts(options: OptimizeOptions, plan: PlanOptions) -> dict[str, Any]:
    # postures and exposures are planned for defects, whatever the objective
    return {**(_defect_facts(options) if plan.chooses or plan.exposures else {}), **plan.facts()}
