"""What a caller of the optimisation adds to its result, knowing what was found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.transforms import Posture
from lightopt.design._result import SetResult
from lightopt.design.blind_spots._files import BLIND_NAMES
from lightopt.design.blind_spots._summary import Looked
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.geometry import RayCaster
from lightopt.rendering import PatchTable
from lightopt.scene import Scene

APPENDED_NAMES = ("part.planned.yaml", *BLIND_NAMES)
"""Files that an appendix may have; with ``--force`` no others are removed."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """What was found, before it is written.

    Attributes
    ----------
    scene, caster
        The part in its postures.
    candidates, thresholds
        What there was to choose from, and which levels are usable.
    results
        One per posture, or one for all of them.
    table
        Makes the patches, or gives those that are made.
    """

    scene: Scene
    caster: RayCaster
    candidates: Candidates
    thresholds: LevelThresholds
    results: tuple[SetResult, ...]
    table: Callable[[], PatchTable]


def _nothing() -> Mapping[Any, Any]:
    return {}


@dataclass(frozen=True, kw_only=True)
class Appendix:
    """More for the output folder.

    Attributes
    ----------
    sections
        Of result.json, beside its own.
    files
        Further files by path inside the folder: text, bytes, or a picture of shape (height, width, 3); the name is one
        of :data:`APPENDED_NAMES`.
    results
        In place of the outcome's, where more is known of them; None otherwise.
    looked
        What the images of each posture show, where that is more than those of the outcome do; empty otherwise.
    exposures
        That the images of a posture are to be rendered with; exposure 1 where it has none.
    """

    sections: Mapping[str, Any] = field(default_factory=_nothing)
    files: Mapping[str, str | bytes | NDArray[np.uint8]] = field(default_factory=_nothing)
    results: tuple[SetResult, ...] | None = None
    looked: tuple[Looked, ...] = ()
    exposures: Mapping[Posture, tuple[float, ...]] = field(default_factory=_nothing)


Appraise = Callable[[Outcome], Appendix]
