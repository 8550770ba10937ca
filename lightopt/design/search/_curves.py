"""Score along one angle, all others as in the best set: shows how flat the optimum is."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lightopt.design._candidates import Candidates
from lightopt.design.search._combinations import Ranked, is_allowed

TOGETHER = "all lights together"

MOST_POINTS = 31  # of one curve; of more positions every second, third … is taken, and the best set's own


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Scores along one angle, all else as in the best set."""

    name: str  # of the light that is moved, or :data:`TOGETHER`
    axis: str  # ``elevation`` or ``azimuth``
    angles_deg: tuple[float, ...]  # ascending [°]
    scores: tuple[int, ...]

    def as_dict(self) -> dict[str, Any]:
        light = None if self.name == TOGETHER else self.name
        lists = {"angles_deg": list(self.angles_deg), "scores": list(self.scores)}
        return {"light": light, "axis": self.axis, **lists}


def score_curves(candidates: Candidates, best: Ranked, score: Callable[[tuple[int, ...]], int]) -> tuple[Curve, ...]:
    """The curves through a best set: all movable lights at one elevation, then each light's elevation and azimuth.

    Combinations that are not allowed, and angles that a light cannot take, are omitted; so are curves of one point. The
    first curve may not contain the best set.
    """
    here = [angles[k] for angles, k in zip(candidates.angles, best.candidates, strict=True)]

    def curve(name: str, lights: list[int], axis: int) -> Curve:
        # along the axis, the other angle as it is: angle to candidate, for each light
        along = [
            {angles[axis]: k for k, angles in enumerate(candidates.angles[i]) if angles[1 - axis] == here[i][1 - axis]}
            for i in lights
        ]
        points: list[tuple[float, tuple[int, ...]]] = []
        for angle in sorted(set(along[0]).intersection(*along[1:])):
            places = dict(zip(lights, (way[angle] for way in along), strict=True))
            combination = tuple(places.get(i, k) for i, k in enumerate(best.candidates))
            if is_allowed(candidates.space, combination):
                points.append((angle, combination))
        stride = -(-len(points) // MOST_POINTS)
        points = [p for k, p in enumerate(points) if k % max(1, stride) == 0 or p[1] == best.candidates]
        angles, scores = tuple(angle for angle, _ in points), tuple(score(combination) for _, combination in points)
        return Curve(name=name, axis=("elevation", "azimuth")[axis], angles_deg=angles, scores=scores)

    moving = [k for k, angles in enumerate(candidates.angles) if len({elevation for elevation, _ in angles}) > 1]
    curves = [curve(TOGETHER, moving, 0)] if len(moving) > 1 else []
    for own in candidates.channels:
        first, last = candidates.names[own[0]], candidates.names[own[-1]]
        curves += [curve(first if len(own) == 1 else f"{first} to {last}", [*own], axis) for axis in (0, 1)]
    return tuple(curve for curve in curves if len(curve.angles_deg) > 1)
