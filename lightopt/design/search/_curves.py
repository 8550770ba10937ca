"""Score along one angle, all others as in the best set: shows how flat the optimum is."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lightopt.design._candidates import Candidates, Place
from lightopt.design.search._combinations import Ranked, is_allowed

TOGETHER = "all lights together"
AXES = ("elevation", "azimuth", "distance")

MOST_POINTS = 31  # of one curve; of more positions every second, third … is taken, and the best set's own


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Scores along one angle, all else as in the best set."""

    name: str  # of the light that is moved, or :data:`TOGETHER`
    axis: str  # one of :data:`AXES`
    values: tuple[float, ...]  # angles [°] or distances [mm], ascending
    scores: tuple[int, ...]

    def as_dict(self) -> dict[str, Any]:
        light = None if self.name == TOGETHER else self.name
        values = "distances_mm" if self.axis == "distance" else "angles_deg"
        lists = {values: list(self.values), "scores": list(self.scores)}
        return {"light": light, "axis": self.axis, **lists}


def score_curves(candidates: Candidates, best: Ranked, score: Callable[[tuple[int, ...]], int]) -> tuple[Curve, ...]:
    """The curves through a best set: all movable lights at one elevation, then each light along each axis.

    Combinations that are not allowed, and places that a light cannot take, are omitted; so are curves of one point. The
    first curve may not contain the best set.
    """
    here = [places[k] for places, k in zip(candidates.places, best.candidates, strict=True)]

    def curve(name: str, lights: list[int], axis: int) -> Curve:
        # along the axis, the rest of the place as it is: value to candidate, for each light
        along = [
            {
                place[axis]: k
                for k, place in enumerate(candidates.places[i])
                if axis < len(place) and _without(place, axis) == _without(here[i], axis)
            }
            for i in lights
        ]
        points: list[tuple[float, tuple[int, ...]]] = []
        for value in sorted(set(along[0]).intersection(*along[1:])):
            places = dict(zip(lights, (way[value] for way in along), strict=True))
            combination = tuple(places.get(i, k) for i, k in enumerate(best.candidates))
            if is_allowed(candidates.space, combination):
                points.append((value, combination))
        stride = -(-len(points) // MOST_POINTS)
        points = [p for k, p in enumerate(points) if k % max(1, stride) == 0 or p[1] == best.candidates]
        values, scores = tuple(value for value, _ in points), tuple(score(combination) for _, combination in points)
        return Curve(name=name, axis=AXES[axis], values=values, scores=scores)

    moving = [k for k, places in enumerate(candidates.places) if len({place[0] for place in places}) > 1]
    curves = [curve(TOGETHER, moving, 0)] if len(moving) > 1 else []
    for own in candidates.channels:
        first, last = candidates.names[own[0]], candidates.names[own[-1]]
        curves += [curve(first if len(own) == 1 else f"{first} to {last}", [*own], axis) for axis in range(len(AXES))]
    return tuple(curve for curve in curves if len(curve.values) > 1)


def _without(place: Place, axis: int) -> Place:
    return place[:axis] + place[axis + 1 :]
