"""Candidate positions of the lights: angles and distances in their ranges, exclusions with reasons, and collisions.

Curves are the score along one angle, all others as in the best set: they show how flat the optimum is.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from lightopt.config import RANGE_KEYS, LightConfig, RigConfig
from lightopt.core.arrays import Bool
from lightopt.core.errors import InputError, counted, refuse
from lightopt.design._cells import Cells, LightCells, cell_clashes, intervals, light_cells
from lightopt.design.search._exact_search import CombinationSpace, Ranked, Rows, is_allowed
from lightopt.lights import PanelLight, outlines
from lightopt.rendering import panels_in_part
from lightopt.scene import PinholeCamera, Scene, area_in_view, build_camera, build_lights, lights_meet

# where a light stands: elevation and azimuth [°], and of a light with a range of distances its distance [mm]
Place = tuple[float, ...]
PLACE_KEYS = ("elevation_deg", "azimuth_deg", "distance_mm")  # of these in a rig file
Reason = tuple[str, str, float | None]  # text, kind and amount of an `ExcludedPosition`
ROUNDING_MM = 1e-6  # a rim that stands on the table may be that far below it
MOST_POSITIONS = 100_000  # candidate positions of a light; more are refused
NEAR = 0.02  # share of a step that a light need not be moved by


def can_move(light: LightConfig) -> bool:
    return any(getattr(light, key) is not None for key in RANGE_KEYS)


def place_of(light: LightConfig) -> Place:
    return tuple(getattr(light, key) for key in PLACE_KEYS[: 2 if light.distance_range_mm is None else 3])


def place_dict(place: Place) -> dict[str, float]:
    return dict(zip(PLACE_KEYS, place, strict=False))


def place_text(place: Place) -> str:
    """A place for people, such as ``60°, 45°, 250 mm``."""
    return ", ".join(f"{value:g}{unit}" for value, unit in zip(place, ("°", "°", " mm"), strict=False))


def step_problems(name: str, step_deg: float) -> list[str]:
    """Why the option of a name is no step of candidate angles."""
    usable = 0.0 < step_deg < math.inf
    return [] if usable else [f"option '{name}': expected degrees above 0, found {step_deg:g}"]


@dataclass(frozen=True)
class PlaceGrid:
    """The places of a light before any is excluded."""

    axes: tuple[tuple[float, ...], ...]  # steps of elevation and azimuth [°] and perhaps distance [mm], ascending
    places: tuple[Place, ...]  # every combination of these, in their order
    full_turn: bool = False  # whether the azimuths go all the way round

    @property
    def distinct(self) -> list[Place]:
        return list(dict.fromkeys(self.places))


def place_grid(rig: RigConfig, index: int, *, step_deg: float, elevations: Sequence[float] | None = None) -> PlaceGrid:
    """The places of a light, ascending by elevation, then azimuth, then distance.

    Both ends of a range are steps, and from the lower one on every `step_deg`, or every step of the light's
    distances. A light without a range stays there. Where a light was measured, its place is taken instead of one that
    is nearer than it can be set. `elevations` replaces those of the light's range, for lights that share their
    elevation.
    """
    refuse(step_problems("step_deg", step_deg))
    light = rig.lights[index]
    shared = elevations is not None
    if elevations is None or light.elevation_range_deg is None:
        elevations = _steps(light.elevation_range_deg, light.elevation_deg, step_deg)
    azimuths = _steps(light.azimuth_range_deg, light.azimuth_deg, step_deg)
    full_turn = len(azimuths) > 1 and math.isclose(azimuths[-1] - azimuths[0], 360.0)
    if full_turn:
        azimuths.pop()  # the full turn ends where it begins
    ranges: list[Sequence[float]] = [elevations, azimuths]
    steps = [step_deg, step_deg]
    if light.distance_range_mm is not None:
        low, high = light.distance_range_mm
        step = light.distance_step_mm or 0.25 * (high - low) or 1.0
        ranges.append(_steps(light.distance_range_mm, light.distance_mm, step))
        steps.append(step)
    if math.prod(map(len, ranges)) > MOST_POSITIONS:
        raise InputError(
            f"{rig.source.at('lights', index)}: light {light.name} has more than {MOST_POSITIONS:,} positions; raise "
            f"option 'step_deg' {step_deg:g} or distance_step_mm"
        )
    axes, places = tuple(map(tuple, ranges)), tuple(itertools.product(*ranges))
    if shared or light.pose is None:
        return PlaceGrid(axes, places, full_turn)
    here = place_of(light)

    def is_near(place: Place) -> bool:
        return all(abs(a - b) <= NEAR * step for a, b, step in zip(place, here, steps, strict=True))

    return PlaceGrid(axes, tuple(here if is_near(place) else place for place in places), full_turn)


def common_elevations(rig: RigConfig, *, step_deg: float) -> list[float] | None:
    """The elevations that all lights with an elevation range can share [°]; None where no light has one."""
    movable = [(light.elevation_range_deg, light.name) for light in rig.lights if light.elevation_range_deg is not None]
    if not movable:
        return None
    (low, _), highest = max(movable, key=lambda light: light[0][0])
    (_, high), lowest = min(movable, key=lambda light: light[0][1])
    if low > high:
        both = f"{highest} stays at {low:g}° or above, {lowest} at {high:g}° or below"
        raise InputError(f"{rig.source.at('lights')}: option 'common_elevation': {both}; widen a range")
    return _steps((low, high), low, step_deg)


def _steps(ends: tuple[float, float] | None, now: float, step: float) -> list[float]:
    if ends is None:
        return [now]
    low, high = ends
    # a last step that only rounding keeps from the end is the end
    count = (high - low) / step + 1e-9  # infinite for the least of steps
    if count > MOST_POSITIONS:
        return [low] * (MOST_POSITIONS + 1)
    angles = [round(low + k * step, 9) for k in range(math.floor(count) + 1)]
    return angles if math.isclose(angles[-1], high, abs_tol=1e-9) else [*angles, high]


@dataclass(frozen=True)
class ExcludedPosition:
    light: str
    place: Place
    reason: str
    kind: str  # ``view``, ``table``, ``part`` or ``collision``
    amount: float | None = None  # pixels covered, or mm below the table top; None for the other kinds

    def as_dict(self) -> dict[str, Any]:
        facts = {name: getattr(self, name) for name in ("reason", "kind", "amount")}
        return {"light": self.light, **place_dict(self.place), **facts}


@dataclass(frozen=True)
class Candidates:
    names: tuple[str, ...]  # of the lights, in the rig's order
    channels: tuple[tuple[int, ...], ...]  # indices of the lights that move together: channels of one light of the rig
    places: tuple[tuple[Place, ...], ...]  # per light, ascending
    panels: tuple[tuple[PanelLight, ...], ...]  # per light: the panels at these places, world frame
    left_out: tuple[ExcludedPosition, ...]
    space: CombinationSpace
    cells: Cells  # what lies between the places

    @property
    def message(self) -> str:
        sizes = self.space.sizes
        count = counted(sum(math.prod(map(len, rows)) for rows in self.space.groups), "combination")
        return f"{' × '.join(map(str, sizes))} positions of {', '.join(self.names)}: {count} at most"

    def panels_at(self, combination: Sequence[int]) -> tuple[PanelLight, ...]:
        return tuple(some[k] for some, k in zip(self.panels, combination, strict=True))


def find_candidates(
    rig: RigConfig,
    *,
    step_deg: float,
    common_elevation: bool = False,
    points: int | Literal["auto"] | None = None,
    places: Sequence[Place] | None = None,
    scene: Scene | None = None,
) -> Candidates:
    """The positions that a rig's lights can take.

    Excluded are panels in the camera's view, below the table top, inside the part in one of its postures, or colliding
    with another light at all of its positions. Panels that collide at some positions only exclude combinations.

    points: Point lights per panel, instead of the rig's.
    places: One fixed place per light, instead of the ranges.
    scene: The part in its postures; without it the part is not checked.
    Raises InputError: A light without any position left.
    """
    shared = common_elevations(rig, step_deg=step_deg) if common_elevation and places is None else None
    camera = build_camera(rig)
    left_out: list[ExcludedPosition] = []
    possible: list[list[tuple[Place, PanelLight]]] = []
    grids: list[PlaceGrid] = []
    panels_there: list[dict[Place, PanelLight]] = []
    for index in range(len(rig.lights)):
        free: list[tuple[Place, PanelLight]] = []
        if places is None:
            grids.append(place_grid(rig, index, step_deg=step_deg, elevations=shared))
        else:
            grids.append(PlaceGrid(tuple((value,) for value in places[index]), (places[index],)))
        own = grids[-1].distinct
        there = dict(zip(own, panels_of(rig, index, own, points), strict=True))
        panels_there.append(there)
        for at, panel in there.items():
            reason = _reason(panel, camera, scene)
            if reason is None:
                free.append((at, panel))
            else:
                left_out.append(ExcludedPosition(panel.name, at, *reason))
        possible.append(free)
    clashes = _clashes(rig, possible)
    always_colliding = _always_colliding(possible, clashes)
    for index, k, other in ((i, k, other) for i, some in always_colliding.items() for k, other in sorted(some.items())):
        reason = f"collides with {rig.lights[other].name} in all of its positions"
        left_out.append(ExcludedPosition(rig.lights[index].name, possible[index][k][0], reason, "collision"))
    rows = [[k for k in range(len(some)) if k not in always_colliding[i]] for i, some in enumerate(possible)]
    _check_any(rig, rows, left_out)
    left = [[possible[i][k] for k in row] for i, row in enumerate(rows)]
    places_left = tuple(tuple(at for at, _ in some) for some in left)
    sizes = tuple(map(len, rows))
    channels = bodies_of(rig)
    left_clashes = {(i, j): clash[np.ix_(rows[i], rows[j])] for (i, j), clash in clashes.items()}
    left_clashes = {pair: clash for pair, clash in left_clashes.items() if clash.any()}
    groups = _together(rig, channels, places_left, _groups(rig, places_left, sizes, shared))
    space = CombinationSpace(sizes=sizes, groups=groups, clashes=left_clashes)
    panels = tuple(tuple(panel for _, panel in some) for some in left)
    names = tuple(light.name for light in rig.lights)
    parts = zip(grids, places_left, panels_there, strict=True)
    found = [light_cells(own.axes, own.places, left, there, full_turn=own.full_turn) for own, left, there in parts]
    cells = _cells(rig, channels, found, left_clashes, shared)
    return Candidates(names, channels, places_left, panels, tuple(left_out), space, cells)


def _cells(
    rig: RigConfig,
    channels: Sequence[Sequence[int]],
    lights: Sequence[LightCells],
    clashes: Mapping[tuple[int, int], Bool],
    shared: Sequence[float] | None,
) -> Cells:
    # combined as the places are
    cells = [own.cells for own in lights]
    elevations, sizes = None if shared is None else intervals(shared), tuple(map(len, cells))
    groups = _together(rig, channels, cells, _groups(rig, cells, sizes, elevations))
    space = CombinationSpace(sizes=sizes, groups=groups, clashes=cell_clashes(clashes, lights))
    return Cells(tuple(lights), space)


def bodies_of(rig: RigConfig) -> tuple[tuple[int, ...], ...]:
    """Indices of the lights that move together: channels of one light of the rig, and lights that a programme mixes."""
    found: list[tuple[set[int], list[int]]] = []
    for index, light in enumerate(rig.lights):
        entries, members = {one.entry for one, _ in light.mixture} or {light.entry}, [index]
        for own in [own for own in found if own[0] & entries]:
            found.remove(own)
            entries, members = entries | own[0], own[1] + members
        found.append((entries, members))
    return tuple(sorted(tuple(sorted(members)) for _, members in found))


def _together(
    rig: RigConfig, channels: Sequence[Sequence[int]], places: Sequence[Sequence[Any]], groups: Sequence[Rows]
) -> tuple[Rows, ...]:
    """The groups divided such that the channels of a light stand in one place."""
    moving = [own for own in channels if len(own) > 1 and any(len(places[i]) > 1 for i in own)]
    if not moving:
        return tuple(groups)
    common = [[at for at in places[own[0]] if all(at in places[i] for i in own)] for own in moving]
    found: list[Rows] = []
    for rows, shared in itertools.product(groups, itertools.product(*common)):
        at = {i: place for own, place in zip(moving, shared, strict=True) for i in own}
        chosen = [row[[i not in at or places[i][k] == at[i] for k in row]] for i, row in enumerate(rows)]
        if all(map(len, chosen)):
            found.append(tuple(chosen))
    if not found:
        names = " and ".join(rig.lights[own[0]].name for own in moving)
        raise InputError(f"{rig.source.at('lights')}: no position is left for all channels of {names}; widen its range")
    return tuple(found)


def _check_any(rig: RigConfig, rows: Sequence[Sequence[int]], left_out: Sequence[ExcludedPosition]) -> None:
    problems: list[str] = []
    for index, light in ((i, light) for i, light in enumerate(rig.lights) if not rows[i]):
        kinds: dict[str, list[str]] = {}
        for out in left_out:
            if out.light == light.name:
                kinds.setdefault(out.kind, []).append(out.reason)
        reasons = [f"{some[0]} (first of {counted(len(some), 'position')})" for some in kinds.values()]
        key = "elevation_range_deg" if light.elevation_range_deg is not None else "elevation_deg"
        problems.append(
            f"{rig.source.at('lights', index, key)}: no position of light {light.name} is left: it "
            f"{'; it '.join(reasons)}. Change its range or the size of its panel"
        )
    refuse(problems)


def panels_of(
    rig: RigConfig, index: int, places: Sequence[Place], points: int | Literal["auto"] | None
) -> tuple[PanelLight, ...]:
    """A light's panels at places, world frame; `points` instead of the rig's point lights per panel."""
    light = rig.lights[index]
    moved = tuple(light.model_copy(update=place_dict(place)) for place in places)
    return build_lights(rig.model_copy(update={"lights": moved}), None, points)


def _reason(panel: PanelLight, camera: PinholeCamera, scene: Scene | None) -> Reason | None:
    pixels = area_in_view(camera, panel)
    if pixels > 0.0:
        covered = max(1, round(pixels))
        return f"stands in the camera's view, over {counted(covered, 'pixel')}", "view", float(covered)
    lowest = float(outlines(panel)[..., 2].min())
    if lowest < -ROUNDING_MM:
        return f"reaches {-lowest:.3g} mm below the table top", "table", -lowest
    inside = () if scene is None else panels_in_part(replace(scene, lights=(panel,)))
    return (f"is inside the part in posture {inside[0].posture}", "part", None) if inside else None


def _clashes(rig: RigConfig, possible: Sequence[Sequence[tuple[Place, PanelLight]]]) -> dict[tuple[int, int], Bool]:
    clashes: dict[tuple[int, int], Bool] = {}
    for i, j in itertools.combinations(range(len(possible)), 2):
        if rig.lights[i].entry == rig.lights[j].entry:
            continue  # channels of one light
        clash = np.zeros((len(possible[i]), len(possible[j])), np.bool_)
        if clash.size:
            # spheres around the panels exclude most pairs at once
            centres = [np.array([panel.centre for _, panel in possible[k]]) for k in (i, j)]
            radii = sum(0.5 * max(float(np.hypot(*panel.size)) for _, panel in possible[k]) for k in (i, j))
            for a, centre in enumerate(centres[0]):
                apart = np.linalg.norm(centres[1] - centre, axis=1)
                for b in map(int, np.flatnonzero(apart <= radii)):
                    clash[a, b] = lights_meet(possible[i][a][1], possible[j][b][1])
        if clash.any():
            clashes[i, j] = clash
    return clashes


def _always_colliding(
    possible: Sequence[Sequence[object]], clashes: dict[tuple[int, int], Bool]
) -> dict[int, dict[int, int]]:
    # of each light, its candidates that collide with all that is left of another light, and which light that is
    gone: dict[int, dict[int, int]] = {i: {} for i in range(len(possible))}
    found = True
    while found:
        found = False
        both_ways = (pair for (i, j), clash in clashes.items() for pair in ((i, j, clash), (j, i, clash.T)))
        for light, other, table in both_ways:
            left = [k for k in range(len(possible[other])) if k not in gone[other]]
            more = [k for k in range(len(possible[light])) if left and k not in gone[light] and table[k, left].all()]
            gone[light] |= dict.fromkeys(more, other)
            found = found or bool(more)
    return gone


def _groups(
    rig: RigConfig, places: Sequence[Sequence[Any]], sizes: Sequence[int], shared: Sequence[Any] | None
) -> tuple[Rows, ...]:
    # of places and the elevations that lights share, or of cells and the intervals of elevation
    if shared is None:
        return (tuple(np.arange(n) for n in sizes),)
    lights = [(light.elevation_range_deg is None, some) for light, some in zip(rig.lights, places, strict=True)]
    groups = [
        tuple(np.flatnonzero([stays or at[0] == elevation for at in some]) for stays, some in lights)
        for elevation in shared
    ]
    groups = [rows for rows in groups if all(map(len, rows))]
    if not groups:
        raise InputError(
            f"{rig.source.at('lights')}: option 'common_elevation': at no elevation are positions of all lights left"
        )
    return tuple(groups)


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
        return {"light": light, "axis": self.axis, values: list(self.values), "scores": list(self.scores)}


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
