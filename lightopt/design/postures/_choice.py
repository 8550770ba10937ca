"""The request for postures and lights, and the choice."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lightopt.core.transforms import Posture
from lightopt.design.postures._combinations import PositionCounts
from lightopt.design.postures._cover import Cover
from lightopt.design.search._exact_search import DEFAULT_LIMIT
from lightopt.scene import PanelLight


@dataclass(frozen=True, kw_only=True)
class PostureRequest:
    """How much the postures are to show, and how many there may be.

    seen_in: Images that must show a pair, of all postures together.
    count: Most postures; as many as the target takes where None.
    target: Share of the pairs to be shown.
    limit: Most combinations of the lights' positions that are tried; with more, lights are moved one at a time.
    """

    seen_in: int = 1
    count: int | None = None
    target: float | None = None
    limit: int = DEFAULT_LIMIT


@dataclass(frozen=True, kw_only=True)
class InitialLights:
    """What the rig's lights show in their initial positions.

    share: Of the pairs of the drawn patches, at exposure 1.
    postures: Number of postures, chosen for these lights; fewer than the plan's where no other adds anything.
    panels: The lights, world frame.
    """

    share: float
    postures: int
    panels: tuple[PanelLight, ...] = field(compare=False, repr=False)


@dataclass(frozen=True, kw_only=True)
class PostureChoice:
    """The postures and lights that were chosen.

    postures: In the order in which they were chosen.
    cover: Their gains and bound, over all patches and candidate postures, with these lights.
    lights: Candidate index of each light; None where the lights keep their initial positions.
    panels: The lights, world frame.
    exact: Whether every combination of the lights was tried in each iteration.
    iterations: How often the lights were placed on the way to this choice.
    starts: Number of starting positions of the search.
    on_all_patches: Whether the last iterations used all patches; not where memory is too small for so many positions.
    converged: Whether no combination of the positions tried last shows more of all patches in these postures.
    position_counts: What each position of each light shows of all patches in these postures, each image with the
        evaluator's exposures; None where that is no longer known.
    """

    postures: tuple[Posture, ...]
    cover: Cover
    lights: tuple[int, ...] | None
    panels: tuple[PanelLight, ...]
    exact: bool
    iterations: int
    starts: int
    initial: InitialLights
    on_all_patches: bool
    converged: bool
    position_counts: tuple[PositionCounts, ...] | None = field(default=None, compare=False, repr=False)

    @property
    def initial_if_moved(self) -> InitialLights | None:
        """What the rig's lights show in their initial positions; None where they stay there."""
        same = (
            np.allclose(old.outward, new.outward, rtol=0.0, atol=1e-9)
            for old, new in zip(self.initial.panels, self.panels, strict=True)
        )
        return None if all(same) else self.initial
