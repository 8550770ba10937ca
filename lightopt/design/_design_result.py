"""The result of a design: all that its files, the report and the terminal show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightopt.config import PartConfig, RigConfig
from lightopt.design._options import OptimizeOptions
from lightopt.design._plan_result import PlanResult
from lightopt.design._result import SetResult
from lightopt.design.blind_spots._summary import BlindSpotSummary
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.geometry import RayCaster
from lightopt.rendering import PatchTable
from lightopt.scene import Scene


@dataclass(frozen=True, eq=False, kw_only=True)
class DesignResult:
    """Best light positions for a part, and what was planned beside them.

    folder: Output folder.
    options: With the postures and positions that were chosen, where that was asked for.
    command: The command line that asks for this result.
    provenance: Inputs, options and versions, from :func:`lightopt.core.provenance.provenance`.
    scene, caster: The part in its postures, the lights as the rig file has them.
    patches: None where all matrices were kept and no report was asked for.
    candidates: The positions that `results` are indices into: one of each light where they were chosen with the
        postures.
    all_candidates: The positions that there were to choose from.
    thresholds: Which levels are usable [sensor level].
    results: One per posture, or one for all of them.
    plan: Postures, exposures, tolerances, commands.
    blind: Blind spots, where defects were looked for.
    reused: Number of luminance matrices that were kept from an earlier run.
    warnings: What was repaired or is partly wrong.
    """

    folder: Path
    rig: RigConfig
    part: PartConfig
    options: OptimizeOptions
    command: str
    provenance: Mapping[str, Any]
    scene: Scene
    caster: RayCaster
    patches: PatchTable | None
    candidates: Candidates
    all_candidates: Candidates
    thresholds: LevelThresholds
    results: tuple[SetResult, ...]
    plan: PlanResult
    blind: BlindSpotSummary | None
    reused: int
    warnings: tuple[str, ...]
