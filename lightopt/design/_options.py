"""What to optimise, what to plan in addition to the lights, and the provenance of a run."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from lightopt.config import PartConfig, RigConfig, input_hashes, points_problem
from lightopt.core.errors import InputError
from lightopt.core.provenance import provenance
from lightopt.core.transforms import Posture
from lightopt.defects import DEFAULT_FALSE_ALARMS, false_alarms_problem
from lightopt.design._tolerances import Tolerances
from lightopt.design.objectives._detectability import min_images_problem
from lightopt.design.postures._exposures import DEFAULT_EXPOSURE_GAIN, check_exposures
from lightopt.design.postures._posture_grid import DEFAULT_OUTSIDE_PX, DEFAULT_POSTURE_STEP
from lightopt.design.search._exact_search import DEFAULT_LIMIT
from lightopt.rendering import DEFAULT_PATCH_BUDGET

DEFAULT_SHADE_SHARE = 10.0 / 255.0  # share of full scale, above black, below which a level is shaded
DEFECT_OBJECTIVE = "detectability"  # the objective whose pairs of patch and defect are planned for


@dataclass(frozen=True, kw_only=True)
class CalibratedThreshold:
    """The score from which a calibrated inspection counts a defect: that of its posture with the highest."""

    score: float
    file: str  # name of the calibration
    sha256: str  # hash of the calibration


@dataclass(frozen=True, kw_only=True)
class OptimizeOptions:
    """What to optimise and how.

    objectives: Names; all by default. The first decides where the lights go, the others are compared with it.
    step_deg: Of the angles within the lights' ranges [°].
    common_elevation: Whether all lights that move in elevation stand at the same one.
    common_lights: Whether the lights stand the same for all postures: the sum over the postures decides. Otherwise they
        have to be moved from posture to posture.
    shade_below: Share of full scale, above black, below which a level is shaded.
    min_images: Images that must show a defect, for objective detectability.
    false_alarms: Allowed in the images of a posture of a good part, for objective detectability.
    threshold: Of a calibrated inspection; it follows from `false_alarms` and noise alone where None.
    postures, points: Instead of the part's own; point lights per panel, instead of the rig's.
    patch_budget: About how many patches may be visible.
    images, report: Whether images of the best set and an HTML report are part of the results.
    rows, limit: Combinations in the ranking, for each posture and objective, and most combinations to score.
    places: Elevation and azimuth of each light [°], where they were chosen before for the first objective: then only
        the others are searched.
    """

    objectives: tuple[str, ...] = ()
    step_deg: float = 5.0
    common_elevation: bool = False
    common_lights: bool = True
    shade_below: float = DEFAULT_SHADE_SHARE
    min_images: int = 2
    false_alarms: float = DEFAULT_FALSE_ALARMS
    threshold: CalibratedThreshold | None = None
    postures: tuple[Posture, ...] | None = None
    points: int | Literal["auto"] | None = None
    shadows: bool = True
    patch_budget: int = DEFAULT_PATCH_BUDGET
    keep_matrix: bool = False
    images: bool = True
    report: bool = False
    rows: int = 100
    limit: int = DEFAULT_LIMIT
    places: tuple[tuple[float, float], ...] | None = None


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """What to plan in addition to the positions of the lights; nothing by default.

    choose_postures: How many to choose; as many as the target takes where None.
    target: Share of the pairs of patch and defect that the chosen ones are to show; None for no matter.
    posture_step_deg, allow_outside_px: Of the postures to choose from: step of the grid [°], and how far the part may
        leave the view [px].
    exposures, exposure_gain: To choose from beside exposure 1, and the points that one has to add.
    """

    choose_postures: int | None = None
    target: float | None = None
    posture_step_deg: float = DEFAULT_POSTURE_STEP
    allow_outside_px: float = DEFAULT_OUTSIDE_PX
    exposures: tuple[float, ...] = ()
    exposure_gain: float = DEFAULT_EXPOSURE_GAIN
    tolerances: Tolerances | None = None

    @property
    def chooses(self) -> bool:
        """Whether postures are to be chosen."""
        return self.choose_postures is not None or self.target is not None

    @property
    def all_exposures(self) -> tuple[float, ...]:
        """Exposure 1 and the candidate exposures."""
        return (1.0, *(exposure for exposure in self.exposures if exposure != 1.0))

    def facts(self) -> dict[str, Any]:
        """The options that are in use, as JSON."""
        facts: dict[str, Any] = {}
        if self.chooses:
            names = ("choose_postures", "target", "posture_step_deg", "allow_outside_px")
            facts |= {name: getattr(self, name) for name in names}
        if self.exposures:
            facts |= {"exposures": list(self.exposures), "exposure_gain": self.exposure_gain}
        if self.tolerances is not None:
            values = asdict(self.tolerances)
            facts["tolerances"] = {name.removeprefix("tolerance_"): value for name, value in values.items()}
        return facts


def check_options(options: OptimizeOptions, plan: PlanOptions) -> None:
    """Refuse options that are out of range, all at once."""
    problems: list[str] = []
    if options.points is not None and (problem := points_problem(options.points)):
        problems.append(f"option 'points': {problem}")
    for name, value in (("patch_budget", options.patch_budget), ("rows", options.rows), ("limit", options.limit)):
        if value < 1:
            problems.append(f"option '{name}': expected at least 1, found {value}")
    if options.postures is not None and len(set(options.postures)) < len(options.postures):
        problems.append("option 'postures': the same posture was given twice")
    defects = (min_images_problem(options.min_images), false_alarms_problem(options.false_alarms))
    problems += [problem for problem in defects if problem is not None]
    if plan.choose_postures is not None and plan.choose_postures < 1:
        problems.append(f"option 'choose_postures': expected 1 posture or more, found {plan.choose_postures}")
    if plan.target is not None and not 0.0 < plan.target <= 1.0:
        percents = 1.0 < plan.target <= 100.0
        hint = f"; for {plan.target:g} % give {plan.target / 100.0:g}" if percents else ""
        problems.append(
            "option 'target': expected a share of the surface above 0 and up to 1, such as 0.95, found "
            f"{plan.target:g}{hint}"
        )
    if not (math.isfinite(plan.allow_outside_px) and plan.allow_outside_px >= 0.0):
        problems.append(
            f"option 'allow_outside_px': expected a number of pixels, 0 or more, found {plan.allow_outside_px:g}"
        )
    problems += check_exposures(plan.exposures, plan.exposure_gain)
    if problems:
        raise InputError(*problems)


def run_provenance(
    rig: RigConfig, part: PartConfig, options: OptimizeOptions, plan: PlanOptions, known: dict[str, Any] | None = None
) -> Mapping[str, Any]:
    """What ``result.json`` says a run depends on.

    known: Names of the objectives, and postures; None before these are: then only what does not depend on them.
    """
    names = ("step_deg", "common_elevation", "points", "shadows", "patch_budget")
    if known is not None:
        names += ("common_lights", "shade_below", "images", "report")
    facts: dict[str, Any] = {name: getattr(options, name) for name in names}
    if known is not None:
        facts |= {**known, "max_combinations": options.limit, "ranking_rows": options.rows}
    # postures and exposures are planned for defects, whatever the objective
    if plan.chooses or plan.exposures or DEFECT_OBJECTIVE in (known or {}).get("objectives", ()):
        facts |= {"min_images": options.min_images, "false_alarms": options.false_alarms}
        facts |= {} if options.threshold is None else {"calibration": asdict(options.threshold)}
    return provenance(input_hashes(rig, part), {**facts, **plan.facts()})
