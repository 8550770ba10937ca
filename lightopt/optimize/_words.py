"""What the search found, in the words that terminal and report share."""

from __future__ import annotations

from lightopt.optimize._objective import Objective
from lightopt.optimize._search import Found

__all__ = ["gap_text", "looked_text", "score_text", "ties_text"]


def score_text(value: int, objective: Objective, area: int) -> str:
    """A score with its unit, and as a share of the visible area [µm²] where it is one."""
    share = objective.share(value, area)
    return objective.shown(value) + ("" if share is None else f" ({100.0 * share:.1f} %)")


def gap_text(found: Found, objective: Objective) -> str:
    """By how much the runner-up scores less; of the combinations looked at (≥) where some are left."""
    return "-" if found.gap is None else f"{_seen(found)}−{objective.shown(found.gap)}"


def ties_text(found: Found) -> str:
    """How many combinations share the optimum's score."""
    return "none" if found.complete and found.ties == 1 else f"{_seen(found)}{found.ties:,} best"


def looked_text(found: Found) -> str:
    """How many combinations were scored, excluded by a bound, and left."""
    text = f"{found.scored:,}" + (f" + {found.excluded:,} by bound" if found.excluded else "")
    return text + (f", {found.left:,} left" if found.left else "")


def _seen(found: Found) -> str:
    return "" if found.complete else "≥ "
