"""The rule for the number of point lights of a panel."""

from __future__ import annotations

import math

MOST_POINTS = 65_536


def points_problem(points: int | str) -> str | None:
    """What is wrong with a number of point lights, in words; None for a square up to `MOST_POINTS`, and for auto."""
    if points == "auto":
        return None
    if isinstance(points, int) and 1 <= points <= MOST_POINTS:
        k = math.isqrt(points)
        if k * k == points:
            return None
        near = f"; the nearest are {k * k} and {(k + 1) ** 2}"
    else:
        near = f"; at most {MOST_POINTS}" if isinstance(points, int) and points > MOST_POINTS else ""
    return f"expected a square (1, 4, 9, 16, …) or auto, found {points}{near}"
