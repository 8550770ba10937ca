"""Objectives: scores of a combination of light positions.

To add an objective, write a module with a class that has the methods of `_objective.Objective`, and name it in
:data:`OBJECTIVES` below.
"""

from collections.abc import Callable, Sequence

from lightopt.core.errors import refuse
from lightopt.design.objectives._coverage import COVERAGE
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.objectives._objective import Objective
from lightopt.design.objectives._paper import PAPER

OBJECTIVES: dict[str, Objective] = {objective.name: objective for objective in (COVERAGE, PAPER)}
"""Those that need levels alone, in default order; the first one decides where the lights go."""


def objectives_named(
    names: Sequence[str], detectability: Callable[[], DetectabilityObjective]
) -> tuple[Objective, ...]:
    """The objectives of these names; without names, all that need levels alone.

    `detectability` creates the objective of that name, which depends on a part's catalogue of defects.
    """
    known = (*OBJECTIVES, "detectability")
    problems = [
        f"option 'objectives': expected {' or '.join(known)}, found \"{name}\"" for name in names if name not in known
    ]
    if len(set(names)) < len(names):
        problems.append("option 'objectives': the same objective was given twice")
    refuse(problems)
    return tuple(OBJECTIVES.get(name) or detectability() for name in names) or tuple(OBJECTIVES.values())
