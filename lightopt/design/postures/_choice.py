"""What is asked of a choice of postures and lights, and what was chosen."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lightopt.core.transforms import Posture
from lightopt.design.postures._combinations import PlaceCounts
from lightopt.design.postures._cover import Cover
from lightopt.design.search._search import DEFAULT_LIMIT
from lightopt.scene import PanelLight


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What is asked of the postures.

    Attributes
    ----------
    least
        Images that must show a pair, of all postures together.
    count
        Most postures; as many as the target takes where None.
    target
        Share of the pairs to be shown.
    limit
        Most combinations of the lights' positions that are tried; with more, lights are moved one at a time.
    """

    least: int = 1
    count: int | None = None
    target: float | None = None
    limit: int = DEFAULT_LIMIT


@dataclass(frozen=True, kw_only=True)
class Stood:
    """What the rig's lights show where they stood.

    Attributes
    ----------
    share
        Of the pairs of the drawn patches, at exposure 1.
    postures
        In how many postures, chosen for these lights; fewer than the plan's where no other adds anything.
    panels
        The lights there, world frame.
    """

    share: float
    postures: int
    panels: tuple[PanelLight, ...] = field(compare=False, repr=False)


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The postures and lights that were chosen.

    Attributes
    ----------
    postures
        In the order in which they were chosen.
    cover
        Their gains and bound, over all patches and candidate postures, with these lights.
    lights
        Where the lights stand: candidate of each; None where they stay as the rig has them.
    panels
        The lights there, world frame.
    exact
        Whether every combination of the lights was tried for the postures of each turn.
    turns
        How often the lights were placed on the way to this choice.
    starts
        From how many places of the lights the turns began.
    stood
        What the rig's lights show where they stood.
    on_all
        Whether the last turns were taken on all patches; not where memory is not meant for so many positions.
    settled
        Whether no combination of the positions that were tried last shows more of all patches in these postures.
    places
        What each position of each light shows of all patches in these postures, each image with the survey's exposures;
        None where that is not known any more.
    """

    postures: tuple[Posture, ...]
    cover: Cover
    lights: tuple[int, ...] | None
    panels: tuple[PanelLight, ...]
    exact: bool
    turns: int
    starts: int
    stood: Stood
    on_all: bool
    settled: bool
    places: tuple[PlaceCounts, ...] | None = field(default=None, compare=False, repr=False)

    @property
    def before(self) -> Stood | None:
        """What the rig's lights show where they stood; None where they stay there, of which the cover says more."""
        same = (
            np.allclose(old.outward, new.outward, rtol=0.0, atol=1e-9)
            for old, new in zip(self.stood.panels, self.panels, strict=True)
        )
        return None if all(same) else self.stood
