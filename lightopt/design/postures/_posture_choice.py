"""The request for postures and lights, the cover by chosen postures with bounds on it, and the choice."""

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
    """One candidate of a cover."""

    candidate: int
    gain: int  # what it adds to the benefit of those before it
    benefit: int  # of those before it and itself: Σ weight · min(k, units)
    covered: int  # weight of the pairs of k units or more, which count as found


@dataclass(frozen=True, kw_only=True)
class Cover:
    """A choice of candidates."""

    steps: tuple[CoverStep, ...]  # the chosen ones, in the order in which they were chosen
    k: int  # units of evidence that a pair needs
    total: int  # weight of all pairs
    bounds: tuple[int, ...]  # on the benefit of sets of 0, 1, 2, … candidates up to as many as were chosen
    all_benefit: int  # of all candidates together
    all_covered: int  # likewise
    target: float | None = None  # share of the weight that was to be seen; None without
    sets: int | None = None  # number of all sets of as many candidates; None where not all were searched
    max_covered: int | None = None  # what the best of these sets covers; None likewise

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

    def with_search(self, max_covered: int, sets: int | None) -> "Cover":
        """With the outcome of a search of all sets; unchanged where the search ended without a proof."""
        return self if sets is None else replace(self, sets=sets, max_covered=max_covered)


@dataclass(frozen=True, kw_only=True)
class PostureRequest:
    """The share that the postures are to show, and their maximum number."""

    count: int | None = None  # most postures; as many as the target takes where None
    target: float | None = None  # share of the pairs to be shown
    limit: int = DEFAULT_LIMIT  # most combinations to try; with more, lights are moved one at a time


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Light positions, and the postures chosen for them."""

    panels: tuple[PanelLight, ...]  # the lights, world frame
    cover: Cover  # the postures, with their gains and bound, over all patches and candidate postures, with these lights
    lights: Lights = None  # index of each one's candidate; None where they keep their initial positions
    exact: bool = True  # whether every combination of the lights was tried in every iteration
    iterations: int = 0  # how often the lights were placed on the way
    converged: bool = True  # whether no combination of the positions tried last shows more in these postures


@dataclass(frozen=True, kw_only=True)
class PostureChoice(Solution):
    """The postures and lights that were chosen, on all patches."""

    postures: tuple[Posture, ...]  # in the order in which they were chosen
    starts: int  # number of starting positions of the search
    # what the rig's lights show in their initial positions, of the drawn patches at exposure 1, in postures that are
    # chosen for them, fewer than the plan's where no other adds anything
    initial: Cover
    initial_panels: tuple[PanelLight, ...] = field(compare=False, repr=False)  # these lights
    on_all_patches: bool  # whether the last iterations used all patches: not where memory is too small
    # what each position of each light shows of all patches in these postures, each image with the evaluator's
    # exposures; None where that is no longer known
    position_counts: tuple[PositionCounts, ...] | None = field(default=None, compare=False, repr=False)
    images: ImageCache | None = field(default=None, compare=False, repr=False)  # of all patches, at those exposures
    brackets: Brackets | None = None  # which further exposures are planned; None where there were none to choose from

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
