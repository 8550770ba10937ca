"""What an optimisation found, before it says so: all that a report of it may want to show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightopt.config import PartConfig, RigConfig
from lightopt.design._result import SetResult
from lightopt.design.blind_spots._summary import BlindReport
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.geometry import RayCaster
from lightopt.images import Overlap
from lightopt.rendering import PatchTable
from lightopt.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Draft:
    """An optimisation whose files are written but for its report and result.json.

    Attributes
    ----------
    document
        What result.json will say.
    folder
        Where the files are.
    rig, part
        As they were read.
    scene, caster
        Of the part in its postures, the lights as the rig file has them.
    table
        The patches, and which of them the camera sees.
    candidates, offered, thresholds, results
        As in :class:`lightopt.design.Optimum`.
    overlaps
        Saturated regions of the images; none where no images were rendered.
    warnings
        What was repaired or is partly wrong.
    blind
        Blind spots, where defects were looked for.
    """

    document: Mapping[str, Any]
    folder: Path
    rig: RigConfig
    part: PartConfig
    scene: Scene
    caster: RayCaster
    table: PatchTable
    candidates: Candidates
    offered: Candidates
    thresholds: LevelThresholds
    results: tuple[SetResult, ...]
    overlaps: Sequence[Overlap]
    warnings: tuple[str, ...]
    blind: BlindReport | None
