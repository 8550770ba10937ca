"""Texts about a result that terminal and report share."""

import math
from collections.abc import Sequence

from lightopt.core.errors import counted
from lightopt.core.transforms import Posture
from lightopt.design._candidates import Candidates
from lightopt.design._result import ObjectiveResult, SetResult
from lightopt.design.objectives._objective import NEAR_PER_MILLE, Objective, share_of_whole, share_text
from lightopt.rendering import GRAZING_DEG

NOT_COUNTED = "not counted"  # runner-up and ties where no other combination was scored


def shown_text(value: int, objective: Objective, result: SetResult) -> str:
    """A score of a result with its unit, to the digits that its patches support."""
    return objective.format_score(value, result.grain * result.area)


def score_text(value: int, objective: Objective, result: SetResult) -> str:
    """A score with its unit, and as a share of the inspectable area where it is one."""
    share = share_of_whole(objective, value, result.area)
    text = shown_text(value, objective, result)
    return text + ("" if share is None else f" ({share_text(share, result.grain)})")


def gap_text(answer: ObjectiveResult, result: SetResult) -> str:
    """By how much the runner-up scores less; of the combinations scored (≥) where some are left."""
    found = answer.found
    if answer.proven_of is not None:
        return NOT_COUNTED
    if found.gap is None:
        return "-"
    gap = shown_text(found.gap, answer.objective, result)
    if not found.gap:
        return "equal"
    # a gap below the patches' grain is that small whatever is left
    return gap if gap.startswith("<") else f"{'' if found.complete else '≥ '}−{gap}"


def ties_text(answer: ObjectiveResult) -> str:
    """How many other combinations share the optimum's score; not counted for a set that was chosen before."""
    return NOT_COUNTED if answer.proven_of else f"{'' if answer.found.complete else '≥ '}{answer.found.ties:,}"


def near_text(answer: ObjectiveResult) -> str:
    """How many other combinations score nearly as much; not counted for a set that was chosen before."""
    return NOT_COUNTED if answer.proven_of else f"{'' if answer.found.near_exact else '≥ '}{answer.found.near:,}"


def shares_of(objectives: Sequence[Objective]) -> dict[str, list[str]]:
    """Names of the objectives whose scores are shares, by the surface that they are shares of."""
    names: dict[str, list[str]] = {}
    for objective in objectives:
        if objective.share_of is not None:
            names.setdefault(objective.share_of, []).append(objective.name)
    return names


def near_meaning(objectives: Sequence[Objective]) -> str:
    """What is near the best, in words."""
    within = f"{NEAR_PER_MILLE / 10:g}"
    texts = [
        f"within {within} points of the share of {' and '.join(names)}"
        if points
        else f"within {within} % of the best score of {' and '.join(names)}"
        for points in (True, False)
        if (names := [one.name for one in objectives if (one.share_of is not None) == points])
    ]
    return f"near best: other combinations {', '.join(texts)}, ties among them"


def left_out_text(result: SetResult) -> str:
    """Which share of the surface that the camera sees is left out."""
    return share_text(result.left_out, result.grain)


LEFT_OUT_MEANING = (
    f"left out: of the surface that the camera sees, what it sees at more than {GRAZING_DEG:g}° to the normal; it "
    "counts neither as covered nor as uncovered"
)
"""What the share that is left out is."""


def combinations_counted_text(answer: ObjectiveResult) -> str:
    """How many combinations were scored, excluded by a bound, and left; not of a set that was chosen before."""
    found = answer.found
    if answer.proven_of is not None:
        return NOT_COUNTED
    text = f"{found.scored:,}" + (f" + {found.excluded:,} by bound" if found.excluded else "")
    return text + (f", {found.left:,} left" if found.left else "")


def cut_off(answer: ObjectiveResult, postures: Sequence[Posture]) -> str:
    """The warning of a search that left combinations."""
    found, name = answer.found, answer.objective.name
    proof = (
        "none scores more, but one of those left may score the same and win the tie"
        if found.proven
        else f"none scores more than {found.bound:,}"
    )
    return (
        f"objective {name}, {', '.join(map(str, postures))}: the search stopped after {found.scored:,} combinations "
        f"with {found.left:,} left; the best found scores {found.best.score:,}, {proof}. Ties and runner-up are of "
        "what was looked at. Raise option 'limit' or option 'step_deg'"
    )


def combinations_text(candidates: Candidates) -> str:
    """How many positions and combinations there are to choose from."""
    sizes = candidates.space.sizes
    positions = " × ".join(map(str, sizes))
    return f"{positions} positions of {', '.join(candidates.names)}: {counted(math.prod(sizes), 'combination')} at most"
