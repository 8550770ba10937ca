"""What the search found, in the words that terminal and report share."""

from __future__ import annotations

import math
from collections.abc import Sequence

from lightopt.errors import counted, percent
from lightopt.optimize._candidates import Candidates
from lightopt.optimize._objective import Objective
from lightopt.optimize._result import Answer
from lightopt.optimize._search import Found
from lightopt.transforms import Posture

__all__ = [
    "combinations_text",
    "cut_off",
    "gap_text",
    "looked_text",
    "patches_text",
    "score_text",
    "ties_text",
]

NOT_COUNTED = "not counted"
"""Runner-up and ties where no other combination was looked at."""


def score_text(value: int, objective: Objective, area: int) -> str:
    """A score with its unit, and as a share of the visible area [µm²] where it is one."""
    share = objective.share(value, area)
    return objective.shown(value) + ("" if share is None else f" ({percent(share)})")


def gap_text(found: Found, objective: Objective) -> str:
    """By how much the runner-up scores less; of the combinations looked at (≥) where some are left."""
    if _alone(found):
        return NOT_COUNTED
    return "-" if found.gap is None else f"{_seen(found)}−{objective.shown(found.gap)}"


def ties_text(found: Found) -> str:
    """How many combinations share the optimum's score; of a set that was chosen before nobody counted them."""
    if _alone(found):
        return NOT_COUNTED
    return "none" if found.complete and found.ties == 1 else f"{_seen(found)}{found.ties:,} best"


def looked_text(answer: Answer) -> str:
    """How many combinations were scored, excluded by a bound, and left; nobody counted those of a set placed before."""
    found = answer.found
    if answer.proven_of is not None:
        return NOT_COUNTED
    text = f"{found.scored:,}" + (f" + {found.excluded:,} by bound" if found.excluded else "")
    return text + (f", {found.left:,} left" if found.left else "")


def patches_text(drawn: int, patches: int, *, on_all: bool) -> str:
    """On which patches a plan's postures and lights were chosen."""
    if not on_all:
        return f"on {drawn:,} of {patches:,} patches"
    return (
        f"on all {patches:,} patches"
        if drawn == patches
        else f"on {drawn:,} patches, then on all {patches:,} patches"
    )


def cut_off(answer: Answer, postures: Sequence[Posture]) -> str:
    """What to say of a search that left combinations."""
    found, name = answer.found, answer.objective.name
    proof = (
        "none scores more, but one of those left may score the same and win the tie"
        if found.proven
        else f"none scores more than {found.bound:,}"
    )
    return (
        f"objective {name}, {', '.join(map(str, postures))}: the search stopped after {found.scored:,} combinations "
        f"with {found.left:,} left; the best found scores {found.best.score:,}, {proof}. Ties and runner-up are of "
        "what was looked at. Raise --max-combinations or take a larger --step"
    )


def combinations_text(candidates: Candidates) -> str:
    """How many positions and combinations there are to choose from."""
    sizes = candidates.space.sizes
    positions = " × ".join(map(str, sizes))
    return f"{positions} positions of {', '.join(candidates.names)}: {counted(math.prod(sizes), 'combination')} at most"


def _alone(found: Found) -> bool:
    # one combination: chosen before, or of lights that do not move
    return found.complete and found.scored + found.excluded == 1


def _seen(found: Found) -> str:
    return "" if found.complete else "≥ "
