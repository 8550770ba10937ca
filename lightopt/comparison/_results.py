"""What lighting systems show of a part and what they cost, as values, JSON and CSV."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lightopt.config import PartConfig, RigConfig
from lightopt.core.arrays import Bool, Float32
from lightopt.design import OptimizeOptions, WidestTolerance
from lightopt.images import csv_text


@dataclass(frozen=True, eq=False, kw_only=True)
class Picture:
    """What the camera would deliver under a light: share of full scale, and saturated pixels, shape (height, width)."""

    light: str
    level: Float32
    saturated: Bool


@dataclass(frozen=True, eq=False, kw_only=True)
class SystemResult:
    """What a lighting system shows of the part, adjusted as well as it can be, and what it costs."""

    name: str
    rig: RigConfig
    folder: Path  # of its design, with a report
    share: float  # of the surface × the catalogue's defects that are found
    grain: float  # how far the shares may be off since a patch counts as its middle does
    defects: Mapping[str, float]  # share of each kind of defect
    reasons: Mapping[str, float]  # why the others are not found, as shares of the same
    moved: tuple[str, ...]  # lights that stand elsewhere than their file says
    images: int  # of a part
    seconds: float | None  # for these; None where the rig cannot take them
    size_mm: tuple[float, float, float]  # of the box around the lights along X, Y, Z
    footprint_mm: float  # side of a pixel at the origin
    pictures: tuple[Picture, ...]  # of the first posture
    # how far all lights, and the part, may be off while most of the share is kept; None where that was not computed
    mounting: WidestTolerance | None = None
    pose: WidestTolerance | None = None

    @property
    def cost(self) -> float:
        """What it is compared by beside the share: seconds, or images where those are unknown."""
        return float(self.images) if self.seconds is None else self.seconds


@dataclass(frozen=True, kw_only=True)
class UnusableSystem:
    """A lighting system that cannot be used for the part."""

    name: str
    messages: tuple[str, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class LightingComparison:
    """Lighting systems in the order of the share of defects that they find."""

    part: PartConfig
    options: OptimizeOptions
    provenance: Mapping[str, Any]
    systems: tuple[SystemResult, ...]
    unusable: tuple[UnusableSystem, ...]
    warnings: tuple[str, ...]
    paths: tuple[Path, ...]  # of the comparison's files

    @property
    def best(self) -> tuple[SystemResult, ...]:
        """The systems than which no other finds as much in less time, or more in the same (Pareto)."""
        return tuple(
            one
            for one in self.systems
            if not any(
                other.share >= one.share
                and other.cost <= one.cost
                and (other.share, -other.cost) != (one.share, -one.cost)
                for other in self.systems
            )
        )


def comparison_document(comparison: LightingComparison) -> dict[str, Any]:
    """What comparison.json says."""
    best = {one.name for one in comparison.best}
    systems = [
        {
            "system": one.name,
            "rig": {"file": one.rig.source.path.name, "sha256": one.rig.source.sha256},
            "folder": one.folder.name,
            "share": round(one.share, 6),
            "grain": round(one.grain, 6),
            "pareto": one.name in best,
            "defects": dict(one.defects),
            "not_found": {reason: round(share, 6) for reason, share in one.reasons.items()},
            "images": one.images,
            "seconds": None if one.seconds is None else round(one.seconds, 3),
            "mounting_tolerance": _tolerance_dict(one.mounting),
            "pose_tolerance": _tolerance_dict(one.pose),
            "size_mm": [round(side, 3) for side in one.size_mm],
            "footprint_mm": round(one.footprint_mm, 6),
        }
        for one in comparison.systems
    ]
    return {
        "format": "lightopt-lighting-comparison/1",
        "provenance": dict(comparison.provenance),
        "systems": systems,
        "unusable": [asdict(one) for one in comparison.unusable],
    }


def _tolerance_dict(one: WidestTolerance | None) -> dict[str, Any] | None:
    return None if one is None else {"degrees": one.degrees, "or_more": one.open_ended}


def comparison_csv(comparison: LightingComparison) -> str:
    """The systems as a table, the best first."""
    kinds = list(dict.fromkeys(kind for one in comparison.systems for kind in one.defects))
    size = [f"size_{axis}_mm" for axis in "xyz"]
    widest = ["mounting_tolerance_deg", "pose_tolerance_deg"]
    head = ["system", "share", *kinds, "images", "seconds", *widest, *size, "footprint_mm", "pareto"]
    rows: list[list[object]] = [[*head]]
    best = {one.name for one in comparison.best}
    for one in comparison.systems:
        shares = [f"{one.defects.get(kind, 0.0):.6f}" for kind in kinds]
        seconds = "" if one.seconds is None else f"{one.seconds:.3f}"
        sides = [f"{side:.3f}" for side in one.size_mm]
        widest = ["" if tolerance is None else f"{tolerance.degrees:g}" for tolerance in (one.mounting, one.pose)]
        rest = [*widest, *sides, one.footprint_mm, int(one.name in best)]
        rows.append([one.name, f"{one.share:.6f}", *shares, one.images, seconds, *rest])
    return csv_text(rows)
