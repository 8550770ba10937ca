"""The objectives by name."""

from __future__ import annotations

from collections.abc import Sequence

from lightopt.errors import InputError
from lightopt.optimize._coverage import COVERAGE
from lightopt.optimize._objective import Objective
from lightopt.optimize._paper import PAPER

__all__ = ["OBJECTIVES", "objectives_named"]

OBJECTIVES: dict[str, Objective] = {objective.name: objective for objective in (COVERAGE, PAPER)}
"""In the order in which they are computed unless asked otherwise; the first one decides where the lights go."""


def objectives_named(names: Sequence[str]) -> tuple[Objective, ...]:
    """The objectives of these names; all of them for none.

    Raises
    ------
    InputError
        An unknown name, or one given twice.
    """
    problems = [
        f'--objective: expected {" or ".join(OBJECTIVES)}, found "{name}"'
        for name in names
        if name not in OBJECTIVES
    ]
    if len(set(names)) < len(names):
        problems.append("--objective: the same objective was given twice")
    if problems:
        raise InputError(*problems)
    return tuple(OBJECTIVES[name] for name in names) or tuple(OBJECTIVES.values())
