"""Which further exposures of a plan's postures were considered, and which of them are planned, and why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from lightopt.core.transforms import Posture

Reason = Literal["gain", "pair", "target"]
"""A further exposure is planned: it adds as much as one has to; it does with another, the two twice as much; or less,
and the target was not reached without it."""


@dataclass(frozen=True, kw_only=True)
class FurtherExposure:
    """A further exposure of a posture, all lights.

    exposure: Relative to exposure 1.
    gain: Share of the pairs that it adds: to what is planned before it where it is planned, else to the whole plan.
    reason: Why it is planned: see :data:`Reason`; None where it is not.
    """

    posture: Posture
    exposure: float
    gain: float
    reason: Reason | None

    @property
    def planned(self) -> bool:
        return self.reason is not None


@dataclass(frozen=True, kw_only=True)
class Brackets:
    """The further exposures that were considered.

    before, after: Share of the pairs that is seen without them and with those that are planned.
    further: The planned ones in the order in which they were chosen, then the others.
    least_gain: Share that one has to add.
    grain: How far the shares may be off since a patch counts as its middle does.
    """

    before: float
    after: float
    further: tuple[FurtherExposure, ...]
    least_gain: float
    grain: float = 0.0

    def of(self, posture: Posture) -> tuple[float, ...]:
        """Exposures of a posture in the plan, the longest first."""
        further = [shot.exposure for shot in self.further if shot.planned and shot.posture == posture]
        return tuple(sorted([1.0, *further], reverse=True))
