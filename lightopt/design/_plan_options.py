"""What is asked of a plan."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from lightopt.core.errors import InputError
from lightopt.design.exposures._plan_exposures import DEFAULT_EXPOSURE_GAIN, check_exposures
from lightopt.design.postures._posture_grid import DEFAULT_OUTSIDE_PX, DEFAULT_POSTURE_STEP
from lightopt.design.tolerances._tolerances import Tolerances

OBJECTIVE = "detectability"
"""The objective whose pairs of patch and defect are planned for."""


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """What is asked of a plan, beside :class:`lightopt.design.OptimizeOptions`.

    Attributes
    ----------
    postures
        How many to choose; as many as the target takes where None.
    target
        Share of the pairs of patch and defect that the chosen ones are to show; None for no matter.
    posture_step_deg
        Of the grid to choose from [°].
    allow_outside_px
        How far the part may leave the view in a posture to choose from [px].
    exposures
        Offered beside exposure 1; none by default.
    exposure_gain
        Points that one has to add.
    tolerances
        What may be off; None where nobody asks.
    """

    postures: int | None = None
    target: float | None = None
    posture_step_deg: float = DEFAULT_POSTURE_STEP
    allow_outside_px: float = DEFAULT_OUTSIDE_PX
    exposures: tuple[float, ...] = ()
    exposure_gain: float = DEFAULT_EXPOSURE_GAIN
    tolerances: Tolerances | None = None

    @property
    def chooses(self) -> bool:
        """Whether postures are to be chosen."""
        return self.postures is not None or self.target is not None

    @property
    def all_exposures(self) -> tuple[float, ...]:
        """Exposure 1, and those that are offered beside it."""
        return (1.0, *(exposure for exposure in self.exposures if exposure != 1.0))

    def facts(self) -> dict[str, Any]:
        """What was asked for, as JSON; nothing where nothing was."""
        facts: dict[str, Any] = {}
        if self.chooses:
            facts["choose_postures"] = self.postures
            facts["target"] = self.target
            facts["posture_step_deg"] = self.posture_step_deg
            facts["allow_outside_px"] = self.allow_outside_px
        if self.exposures:
            facts["exposures"] = list(self.exposures)
            facts["exposure_gain"] = self.exposure_gain
        if self.tolerances is not None:
            facts["tolerances"] = {
                "light_deg": self.tolerances.light_deg,
                "pose_deg": self.tolerances.pose_deg,
                "target": self.tolerances.target,
                "draws": self.tolerances.draws,
                "seed": self.tolerances.seed,
            }
        return facts


def check_plan(options: PlanOptions) -> None:
    """Say all that is wrong with the options at once.

    Raises
    ------
    InputError
        Anything out of range.
    """
    problems: list[str] = []
    if options.postures is not None and options.postures < 1:
        problems.append(f"--choose-postures: expected 1 posture or more, found {options.postures}")
    if options.target is not None and not 0.0 < options.target <= 1.0:
        percents = 1.0 < options.target <= 100.0
        hint = f"; {options.target:g} % is --target {options.target / 100.0:g}" if percents else ""
        problems.append(
            "--target: expected a share of the surface above 0 and up to 1, such as 0.95, found "
            f"{options.target:g}{hint}"
        )
    if not (math.isfinite(options.allow_outside_px) and options.allow_outside_px >= 0.0):
        problems.append(
            f"--allow-outside: expected a number of pixels, 0 or more, found {options.allow_outside_px:g}"
        )
    problems += check_exposures(options.exposures, options.exposure_gain)
    if problems:
        raise InputError(*problems)
