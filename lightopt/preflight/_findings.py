"""The rig and scene that are checked, with samples of what the camera sees, and the findings of the checks."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np

from lightopt.config import PartConfig, RigConfig
from lightopt.core.arrays import Bool
from lightopt.core.transforms import Posture
from lightopt.geometry import Hits, RayCaster
from lightopt.lights import PanelLight
from lightopt.rendering import SurfacePoints
from lightopt.scene import Framing, PartView, PinholeCamera, Scene

# from best to worst: as it should be; good to know; will probably disappoint; impossible
Level = Literal["ok", "note", "warning", "error"]


@dataclass(frozen=True)
class Finding:
    level: Level
    topic: str  # what it is about, in a word or two
    text: str  # for people: with numbers, and what to do where something is to be done
    where: str | None = None  # file, line and key it comes from
    values: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", MappingProxyType(dict(self.values)))

    def as_dict(self) -> dict[str, Any]:
        return {**vars(self), "values": dict(self.values)}


@dataclass(frozen=True)
class CheckResult:
    """All findings about a rig, or about a rig and a part, in the order of the checks."""

    findings: tuple[Finding, ...]

    @property
    def worst(self) -> Level:
        levels: list[Level] = ["ok", *(finding.level for finding in self.findings)]
        return max(levels, key=get_args(Level).index)

    def as_dict(self) -> dict[str, Any]:
        return {"worst": self.worst, "findings": [finding.as_dict() for finding in self.findings]}


def percent(share: float) -> str:
    """A share as percent: two digits of a small one, no more than whole percents of a large one."""
    return f"{100.0 * share:.2g} %" if share < 0.095 else f"{100.0 * share:.0f} %"


@dataclass(frozen=True)
class CheckedRig:
    """A rig with its camera and lights in the world frame."""

    rig: RigConfig
    camera: PinholeCamera
    lights: tuple[PanelLight, ...]

    def at(self, *keys: str | int) -> str:
        return self.rig.source.at(*keys)


@dataclass(frozen=True, eq=False)
class PostureSamples:
    """What the camera sees of the part in a posture, at every `step`-th pixel of rows and columns; part frame."""

    posture: Posture
    view: PartView
    framing: Framing
    step: int
    hits: Hits
    surface: SurfacePoints


@dataclass(frozen=True)
class CheckedScene:
    rig: RigConfig
    part: PartConfig
    scene: Scene
    caster: RayCaster
    samples: tuple[PostureSamples, ...]

    def glossy(self, surface: SurfacePoints) -> Bool:
        """Which points have a specular lobe, shape (k,); all of a part without regions."""
        if surface.material is None:
            return np.ones(len(surface), np.bool_)
        return np.array([own.R_s > 0.0 for own in self.scene.reflectances])[surface.material]

    def of_posture(self, sample: PostureSamples, level: Level, topic: str, text: str, **values: Any) -> Finding:
        index = self.samples.index(sample)
        where, values = self.part.source.at("postures", index), {"posture": sample.posture.as_dict(), **values}
        return Finding(level, topic, f"posture {sample.posture}: {text}", where, values)
