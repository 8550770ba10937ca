"""What to optimise and how."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from lightopt.config import points_problem
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.design.objectives._detectability import seen_in_problem
from lightopt.design.responses._contrast import DEFAULT_CONTRAST, threshold_problem
from lightopt.design.search._exact_search import DEFAULT_LIMIT
from lightopt.rendering import DEFAULT_PATCH_BUDGET

DEFAULT_SHADE_SHARE = 10.0 / 255.0
"""Share of full scale, above black, below which a level is shaded, unless asked otherwise."""


def _no_plan() -> Mapping[str, Any]:
    return {}


@dataclass(frozen=True, kw_only=True)
class OptimizeOptions:
    """What to optimise and how.

    Attributes
    ----------
    objectives
        Names; all by default. The first decides where the lights go, the others are compared with it.
    step_deg
        Of the angles within the lights' ranges [°].
    common_elevation
        Whether all lights that move in elevation stand at the same one.
    common_lights
        Whether the lights stand the same for all postures: the sum over the postures decides.
    shade_below
        Share of full scale, above black, below which a level is shaded.
    seen_in
        Images that must show a defect, for objective detectability.
    contrast
        Times the sensor's noise that a defect must change the level by, for objective detectability.
    postures
        Instead of the part's own.
    points
        Point lights per panel, instead of the rig's.
    shadows
        Whether the part casts shadows on itself.
    patch_budget
        About how many patches may be visible.
    keep_matrix
        Whether to keep the luminance matrices on disk.
    images
        Whether to render the images of the best set.
    rows
        Combinations in the ranking, for each posture and objective.
    limit
        Most combinations to score.
    threads
        All the machine's by default. The results do not depend on it.
    places
        Elevation and azimuth of each light [°], where somebody chose them before for the first objective: then only
        the others are searched.
    plan
        What else was asked for, as JSON: part of the result's provenance.
    """

    objectives: tuple[str, ...] = ()
    step_deg: float = 5.0
    common_elevation: bool = False
    common_lights: bool = False
    shade_below: float = DEFAULT_SHADE_SHARE
    seen_in: int = 1
    contrast: float = DEFAULT_CONTRAST
    postures: tuple[Posture, ...] | None = None
    points: int | Literal["auto"] | None = None
    shadows: bool = True
    patch_budget: int = DEFAULT_PATCH_BUDGET
    keep_matrix: bool = False
    images: bool = True
    rows: int = 100
    limit: int = DEFAULT_LIMIT
    threads: int | None = None
    places: tuple[tuple[float, float], ...] | None = None
    plan: Mapping[str, Any] = field(default_factory=_no_plan)


def check_options(options: OptimizeOptions) -> None:
    """Say all that is wrong with the options at once.

    Raises
    ------
    InputError
        Anything out of range.
    """
    problems: list[str] = []
    if options.points is not None and (problem := points_problem(options.points)):
        problems.append(f"points: {problem}")
    for name, value in (
        ("patch budget", options.patch_budget),
        ("ranking rows", options.rows),
        ("combination limit", options.limit),
        ("threads", 1 if options.threads is None else options.threads),
    ):
        if value < 1:
            problems.append(f"{name}: expected at least 1, found {value}")
    if options.postures is not None and len(set(options.postures)) < len(options.postures):
        problems.append("posture: the same posture was given twice")
    defects = (seen_in_problem(options.seen_in), threshold_problem(options.contrast))
    problems += [problem for problem in defects if problem is not None]
    if problems:
        raise InputError(*problems)
