"""What was planned: postures, exposures, tolerances, commands."""

from __future__ import annotations

from dataclasses import dataclass

from lightopt.core.transforms import Posture
from lightopt.design._commands import Command, Way
from lightopt.design.exposures._brackets import Brackets
from lightopt.design.postures._choice import PostureChoice
from lightopt.design.postures._posture_grid import ExcludedPosture
from lightopt.design.tolerances._analysis import ToleranceAnalysis
from lightopt.rendering import GRAZING_DEG

SHARES_OF = (
    f"the surface that the camera sees in any posture to choose from at up to {GRAZING_DEG:g}° to its normal × "
    "defects by weight"
)
"""What the shares of a plan are shares of."""

OWN_SHARES_OF = (
    f"the surface that the camera sees in any of the postures at up to {GRAZING_DEG:g}° to its normal × defects by "
    "weight"
)
"""The same of exposures for a part's own postures."""

NEGLIGIBLE_SHARE = 0.001
"""Of the pairs: what further postures add together that is too little for an image."""


@dataclass(frozen=True, kw_only=True)
class ChosenPostures:
    """The postures of a plan, and what there was to choose from.

    choice: Postures and lights.
    candidate_count: Number of postures to choose from.
    left_out: Postures that the stage reaches and that are of no use.
    way: Through the chosen ones, were all captured in one round.
    pace: How fast the stage goes, and who says so.
    least: Images that must show a pair.
    requested, target: Number of postures and share that were asked for; None for what was not.
    drawn, patches: Number of patches for the first turns of postures and lights, and for the last ones and all
        figures.
    max_edge, footprint: Longest edge of these, and side of a pixel's footprint on the part where it is smallest [mm].
    grain: How far shares may be off since a patch counts as its middle does: see
        :class:`lightopt.rendering.PatchTable`.
    inspectable_share, left_out_share: Of the part's surface, by area: inspectable in one candidate posture or more;
        seen at a grazing angle only.
    exposures: That were offered, 1 among them.
    brackets: Which of them are planned; None where there was no offer.
    """

    choice: PostureChoice
    candidate_count: int
    left_out: tuple[ExcludedPosture, ...]
    way: Way
    pace: str
    least: int
    requested: int | None
    target: float | None
    drawn: int
    patches: int
    max_edge: float
    footprint: float
    grain: float
    inspectable_share: float
    left_out_share: float
    exposures: tuple[float, ...] = (1.0,)
    brackets: Brackets | None = None

    def exposures_of(self, posture: Posture) -> tuple[float, ...]:
        """Planned exposures of a posture, the longest first."""
        return (1.0,) if self.brackets is None else self.brackets.of(posture)

    @property
    def proven(self) -> bool:
        """Whether no other postures with no other lights show more: then the alternating search can miss nothing."""
        cover = self.choice.cover
        return cover.covered == cover.total or (self.choice.iterations == 0 and cover.proven)

    @property
    def sufficient(self) -> int:
        """How many of the postures, in the order in which they were chosen, come within a tenth of a point of all."""
        steps = self.choice.cover.steps
        enough = (steps[-1].covered if steps else 0) - NEGLIGIBLE_SHARE * self.choice.cover.total
        return next((i for i, step in enumerate(steps, start=1) if step.covered >= enough), len(steps))


@dataclass(frozen=True, kw_only=True)
class ToleranceResult:
    """How far the score of one posture, or of several together, falls when angles are off.

    `grain` is how far shares of its `patches` may be off since a patch counts as its middle does.
    """

    postures: tuple[Posture, ...]
    robustness: ToleranceAnalysis
    unit: str
    patches: int
    grain: float


@dataclass(frozen=True, kw_only=True)
class PlanResult:
    """What was planned beside the lights.

    chosen: Postures; None where the part's own were taken.
    brackets: Exposures; None where none were offered.
    tolerances: Posture by posture, then together where there are several; empty where they were not asked for.
    commands: That carry the plan out; empty where neither postures nor exposures were planned.
    """

    chosen: ChosenPostures | None = None
    brackets: Brackets | None = None
    tolerances: tuple[ToleranceResult, ...] = ()
    commands: tuple[Command, ...] = ()

    def exposures_of(self, posture: Posture) -> tuple[float, ...]:
        """Planned exposures of a posture, the longest first."""
        return (1.0,) if self.brackets is None else self.brackets.of(posture)

    @property
    def shares_of(self) -> str:
        """What the shares of exposures and postures are shares of."""
        return OWN_SHARES_OF if self.chosen is None else SHARES_OF
