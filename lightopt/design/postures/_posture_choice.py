"""The request for postures and lights, the cover by chosen postures with bounds on it, and the choice."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from lightopt.core.transforms import Posture
from lightopt.design.postures._exposures import Brackets
from lightopt.design.postures._light_positions import PositionCounts
from lightopt.design.responses._image_evaluator import ImageCache
from lightopt.design.search._exact_search import DEFAULT_LIMIT
from lightopt.lights import PanelLight

Lights = tuple[int, ...] | None  # candidate of each light; None for the rig's own positions


@dataclass(frozen=True, kw_only=True)
class CoverStep:
    """One candidate of a cover.

    gain: What it adds to the benefit of those before it.
    benefit: Of those before it and itself: Σ weight · min(k, units).
    covered: Weight of the pairs of k units or more, which count as found.
    """

    candidate: int
    gain: int
    benefit: int
    covered: int


@dataclass(frozen=True, kw_only=True)
class Cover:
    """A choice of candidates.

    steps: The chosen ones, in the order in which they were chosen.
    k: Units of evidence that a pair needs.
    total: Weight of all pairs.
    bounds: On the benefit of sets of 0, 1, 2, … candidates up to as many as were chosen.
    all_benefit, all_covered: Of all candidates together.
    target: Share of the weight that was to be seen; None without.
    sets, max_covered: Number of all sets of as many candidates, and what the best of them covers; None where not all
        were searched.
    """

    steps: tuple[CoverStep, ...]
    k: int
    total: int
    bounds: tuple[int, ...]
    all_benefit: int
    all_covered: int
    target: float | None = None
    sets: int | None = None
    max_covered: int | None = None

    @property
    def chosen(self) -> tuple[int, ...]:
        return tuple(step.candidate for step in self.steps)

    @property
    def benefit(self) -> int:
        return self.steps[-1].benefit if self.steps else 0

    @property
    def covered(self) -> int:
        """Weight of the pairs that the chosen ones find."""
        return self.steps[-1].covered if self.steps else 0

    @property
    def share(self) -> float:
        """Share of all pairs, by weight, that are found."""
        return self.covered / max(1, self.total)

    @property
    def bound_share(self) -> float:
        """No set of as many candidates finds more than this share."""
        if self.max_covered is not None:
            return self.max_covered / max(1, self.total)
        return self.bound_of(len(self.bounds) - 1)

    def bound_of(self, count: int) -> float:
        """No set of `count` candidates, up to as many as were chosen, finds more than this share."""
        # [units ≥ k] ≤ min(k, units) / k
        return min(self.bounds[count] / self.k, self.all_covered) / max(1, self.total)

    @property
    def min_size(self) -> int | None:
        """No set of fewer candidates reaches the target; None without one, or where all together do not reach it."""
        if self.target is None or self.all_covered < self.target * self.total:
            return None
        # a pair that is found has benefit k
        enough = [size for size, bound in enumerate(self.bounds) if bound >= self.k * self.target * self.total]
        return enough[0] if enough else len(self.steps)

    @property
    def guarantee(self) -> float:
        """Share of the best set of as many that these cover at least."""
        return self.share / self.bound_share if self.bound_share > 0.0 else 1.0

    @property
    def proven(self) -> bool:
        """Whether no set of as many covers more."""
        most = min(self.bounds[-1] // self.k, self.all_covered) if self.max_covered is None else self.max_covered
        return self.covered >= most

    def with_search(self, max_covered: int, sets: int | None) -> Cover:
        """With the outcome of a search of all sets; unchanged where the search ended without a proof."""
        return self if sets is None else replace(self, sets=sets, max_covered=max_covered)


@dataclass(frozen=True, kw_only=True)
class PostureRequest:
    """The share that the postures are to show, and their maximum number.

    count: Most postures; as many as the target takes where None.
    target: Share of the pairs to be shown.
    limit: Most combinations of the lights' positions that are tried; with more, lights are moved one at a time.
    """

    count: int | None = None
    target: float | None = None
    limit: int = DEFAULT_LIMIT


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Light positions, and the postures chosen for them.

    panels, lights: The lights, world frame, and the index of each one's candidate; None where they keep their initial
        positions.
    cover: The postures, with their gains and bound, over all patches and candidate postures, with these lights.
    exact: Whether every combination of the lights was tried in every iteration.
    iterations: How often the lights were placed on the way.
    converged: Whether no combination of the positions tried last shows more in these postures.
    """

    panels: tuple[PanelLight, ...]
    cover: Cover
    lights: Lights = None
    exact: bool = True
    iterations: int = 0
    converged: bool = True


@dataclass(frozen=True, kw_only=True)
class PostureChoice(Solution):
    """The postures and lights that were chosen, on all patches.

    postures: In the order in which they were chosen.
    starts: Number of starting positions of the search.
    initial, initial_panels: What the rig's lights show in their initial positions, of the drawn patches at exposure 1,
        in postures that are chosen for them, fewer than the plan's where no other adds anything; and these lights.
    on_all_patches: Whether the last iterations used all patches; not where memory is too small for so many positions.
    position_counts: What each position of each light shows of all patches in these postures, each image with the
        evaluator's exposures; None where that is no longer known.
    images: Some of all patches, at the evaluator's exposures.
    brackets: Which further exposures are planned; None where there were none to choose from.
    """

    postures: tuple[Posture, ...]
    starts: int
    initial: Cover
    initial_panels: tuple[PanelLight, ...] = field(compare=False, repr=False)
    on_all_patches: bool
    position_counts: tuple[PositionCounts, ...] | None = field(default=None, compare=False, repr=False)
    images: ImageCache | None = field(default=None, compare=False, repr=False)
    brackets: Brackets | None = None

    def exposures_of(self, posture: Posture) -> tuple[float, ...]:
        """Planned exposures of a posture, the longest first."""
        return (1.0,) if self.brackets is None else self.brackets.of(posture)

    @property
    def initial_if_moved(self) -> Cover | None:
        """What the rig's lights show in their initial positions; None where they stay there."""
        same = (
            np.allclose(old.outward, new.outward, rtol=0.0, atol=1e-9)
            for old, new in zip(self.initial_panels, self.panels, strict=True)
        )
        return None if all(same) else self.initial
