"""Objectives: scores of a combination of light positions.

To add an objective, write a module with a class that has the methods of `_objective.Objective`, and name it in
:data:`OBJECTIVES` below; detectability depends on a part's catalogue of defects.
"""

from ._coverage import COVERAGE
from ._objective import Objective
from ._paper import PAPER

OBJECTIVES: dict[str, Objective] = {objective.name: objective for objective in (COVERAGE, PAPER)}
"""Those that need levels alone, in default order; the first one decides where the lights go."""
