"""Light that reaches the camera from the part by way of the part: its mirror image of itself, and its diffuse light.

Rays leave the surface where its lobe or its diffuse reflection gathers light. What they meet is shaded by the lights as
images are, seen from where the rays begin. The numbers of rays double until the level changes no more.

    I(v) = 1/(π·W) ∫ (R_d N·l + R_s / cosθ_o · exp(−δ²/(2σ²))) · I₂(l) dω

I₂ is the level that the other surface shows in direction −l, or that of a light's housing or the surroundings. W is the
white level (:mod:`lightopt.optics._albedo`). Directions are those of cells of a unit square, which are divided where
levels differ. Nothing is random: the same scene gives the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lightopt.core.arrays import Bool, Float64, Index
from lightopt.core.kernels import kernel
from lightopt.core.threads import end_if_stopped, in_threads
from lightopt.core.vectors import Vector, dot, length, minus, plus, scaled, vector_at
from lightopt.geometry import RayCaster, resolve_hits
from lightopt.lights import PanelLight, SurfaceLight
from lightopt.optics import (
    DiffuseForm,
    Lobe,
    Reflectance,
    SpecularModel,
    diffuse_term,
    is_lambert,
    light_factor,
    lobe_at,
    lobe_of_width,
    specular_divisor,
    specular_lobe,
    square_across,
    white_level,
)
from lightopt.rendering._converged_panel import ConvergedPanel, converged_panel, isolated_levels, ray_targets
from lightopt.rendering._surface import PointRows, SurfacePoints, surface_at
from lightopt.scene import Housings, Scene

# cells of the unit square of (u, turn), from which directions are made, with a first ray through the middle of each
LOBE_CELLS, DIFFUSE_CELLS, NESTED_CELLS = (4, 6), (6, 8), (2, 4)
# errors of a cell that are small enough [grey level], share; and its most further rays along each side
CHANGE, RELATIVE_CHANGE = 0.4, 0.03
MOST_SIDES = 8
LEAST_SHARE = 0.05  # of that error, above which a cell gets more than one further ray
FAINT = 0.15  # of what a ray adds at most: all cells then get one ray, and no first one [grey level]
SPREAD = 1.4  # width of the directions of the lobe's rays, in those of the lobe
MOST_OF_A_RAY = 0.3  # of what a ray of diffuse light adds at once [grey level]
LEAST_POINTS, MOST_POINTS = 2, 6  # a side, that stand for panels; those of more points are whole
_RAYS_AT_ONCE = 1 << 16
_SHIFT = 0.6180339887498949  # of one row of cells against the next, in cells
_STEP_U, _STEP_V = 0.7548776662466927, 0.5698402909980532  # 1/g and 1/g² of g³ = g + 1
_MOST_STEPS = 50  # of Newton's method
_SCATTER = 1e3  # by which places are multiplied for starts of the sequence [1/mm]

# directions of rays from some of the points, shape (rays, 3), and weights, 0 where nothing is gathered
_Rays = Callable[[PointRows, Index, Float64, Float64], tuple[Float64, Float64]]
_Levels = Callable[[SurfacePoints], Float64]
_Places = tuple[Index, Float64, Float64, Float64]  # of rays: point, u, turn, and angle to the rays beside it [rad]


@dataclass(frozen=True, eq=False, kw_only=True)
class PartLight:
    """What the light of the part on itself depends on, in one posture."""

    scene: Scene
    caster: RayCaster
    blocker: RayCaster | None  # for shadows; None for none
    lights: Sequence[PanelLight | ConvergedPanel]  # part frame, from :meth:`of_scene`
    housings: Housings | None = None  # part frame

    @classmethod
    def of_scene(
        cls,
        scene: Scene,
        lights: Sequence[PanelLight],
        caster: RayCaster,
        *,
        housings: Housings | None = None,
        shadows: bool = True,
    ) -> PartLight:
        """That of a scene's part.

        lights: Part frame; panels get places that the lobe cannot tell apart or, where these are too many, are whole
        housings: Part frame
        """
        mirrored = [_mirrored_light(light, scene.sharpest.sigma, caster) for light in lights]
        blocker = caster if shadows else None
        return cls(scene=scene, caster=caster, blocker=blocker, lights=mirrored, housings=housings)

    def map_blockers(self, points: int, threads: int | None = None) -> None:
        """Make maps that prove shadow rays free, for the light on so many points; each meets several others."""
        panels = [light for light in self.lights if not isinstance(light, SurfaceLight)]
        if self.blocker is not None and self.scene.bounces and panels:
            targets = np.concatenate([ray_targets(light) for light in panels])
            self.blocker.map_blockers(targets, rays=points, threads=threads)

    @cached_property
    def white(self) -> float:
        """White level of the part [grey level]."""
        return white_level(self.scene.reflectances[0])

    @cached_property
    def weights(self) -> Float64:
        """Of each light, to which its surroundings' level is proportional, shape (lights,)."""
        lights = (one.light if isinstance(one, ConvergedPanel) else one for one in self.lights)
        return np.array([light.total_weight for light in lights])

    def surroundings(self, origins: Float64, directions: Float64, width: Float64) -> Float64:
        """Levels that rays meet which go by the part, under a light of weight 1, shape (k,).

        width: Angle between each ray and those beside it, over which edges of housings are spread [rad], shape (k,)
        """
        around, own = self.scene.environment, self.housings
        if own is None:
            return np.full(len(origins), around)
        return around + (own.level - around) * _share_on_rectangles(own.rectangles, origins, directions, width)

    def mirrors_housing(self, surface: SurfacePoints) -> Bool | None:
        """Whether points would mirror a housing to their views, shape (k,); None without housings."""
        if self.housings is None:
            return None
        cosines = np.einsum("ij,ij->i", surface.normals, surface.views)[:, None]
        mirrored = 2.0 * cosines * surface.normals - surface.views
        sharp = np.zeros(len(surface))
        return _share_on_rectangles(self.housings.rectangles, surface.points, mirrored, sharp) > 0.5

    def diffuse(self, surface: SurfacePoints, threads: int | None = None) -> Float64:
        """What diffuse reflection adds to the levels of points, about its error, and glints, shape (3, lights, k).

        It leaves out light that comes from a light by way of the lobe alone, which :mod:`lightopt.rendering._caustics`
        adds. Glints are what single rays add beyond :data:`MOST_OF_A_RAY` after more bounces: a lamp in a small fillet,
        which few points' rays happen to meet. They are to be shared with the points around.
        """
        return self._added(surface, threads, by_lobe=False)

    def specular(self, surface: SurfacePoints, threads: int | None = None) -> Float64:
        """As :meth:`diffuse`, what the lobe adds, which has no glints."""
        return self._added(surface, threads, by_lobe=True)

    def _added(self, surface: SurfacePoints, threads: int | None, *, by_lobe: bool) -> Float64:
        added = np.zeros((3, len(self.lights), len(surface)))
        for index, some, own in surface.by_material(self.scene.reflectances):
            added[..., index] = self._converged(some, own, threads, by_lobe=by_lobe)
        return added

    def _ways(self, own: Reflectance, *, by_lobe: bool) -> tuple[float, _Rays]:
        # rays of points of a reflectance, and the factor of what they gather
        if by_lobe:
            return own.R_s / (math.pi * self.white), lambda rows, *places: lobe_rays(rows, own.lobe, *places)
        return own.R_d / self.white, lambda rows, *places: _rays_by_cosine(rows, own.diffuse, *places)

    def _converged(self, surface: SurfacePoints, own: Reflectance, threads: int | None, *, by_lobe: bool) -> Float64:
        # factor times the mean over the unit square of (u, turn), and about its error. What a first ray of each cell
        # sees says how many more it takes, and is no part of the mean, which would miss what first rays missed
        factor, rays = self._ways(own, by_lobe=by_lobe)
        cells, most = LOBE_CELLS if by_lobe else DIFFUSE_CELLS, math.inf
        faint = not by_lobe and self._is_faint(factor, cells)
        step, area = max(1, _RAYS_AT_ONCE // (cells[0] * cells[1])), 1.0 / (cells[0] * cells[1])
        if not by_lobe and self.scene.bounces > 1:
            # light of the surroundings is no glint, however bright these are
            most = MOST_OF_A_RAY + 2.0 * factor * area * self._around * float(self.weights.max(initial=0.0))
        # what the lobe throws on diffuse surface are caustics
        shown = self.scene.reflectances
        if not by_lobe:
            shown = tuple(replace(one, R_s=0.0, sigma=1e-3, model=SpecularModel()) for one in shown)
        angle = _turn_between_rays(own, cells, by_lobe=by_lobe)

        def chunk(start: int) -> Float64:
            some = surface.take(slice(start, start + step))
            point, u, turn = _cells(len(some), cells)
            if faint:
                sides = np.ones(len(point), np.intp)
            else:
                wide = np.full(len(point), 2.0 * angle)
                first = self._seen(some, rays, (point, u, turn, wide), lambda met: self._hints(met, shown, angle))
                sides = _sides(factor * area * first, cells)
            cell, u, turn = _divided(some.points, point, u, turn, sides, cells)
            places = point[cell], u, turn, 2.0 * angle / sides[cell]
            (values,) = self._seen(some, rays, places, lambda met: self._levels(met, self.scene.bounces, shown))
            return _gathered(factor * area * values, sides, len(some), most)

        if factor == 0.0:
            return np.zeros((3, len(self.lights), len(surface)))
        chunks = in_threads(chunk, range(0, len(surface), step), threads)
        return np.concatenate([np.zeros((3, len(self.lights), 0)), *chunks], axis=2)

    def _is_faint(self, factor: float, cells: tuple[int, int]) -> bool:
        # whether a ray of diffuse light in each cell adds little: others show their R_d by direct light, or there are
        # the surroundings
        brightest = max(own.R_d for own in self.scene.reflectances) + self._around
        brightest *= float(self.weights.max(initial=0.0))
        return self.scene.bounces <= 1 and factor * brightest <= FAINT * cells[0] * cells[1]

    @property
    def _around(self) -> float:
        # the brightest level of the surroundings under a light of weight 1
        return max(self.scene.environment, 0.0 if self.housings is None else self.housings.level)

    def _seen(self, surface: SurfacePoints, rays: _Rays, places: _Places, levels: _Levels) -> Float64:
        # weight times the levels that a ray from each of the points meets, shape (arrays of levels, lights, rays)
        count = max(1, len(places[0]))
        ends = [slice(start, start + _RAYS_AT_ONCE) for start in range(0, count, _RAYS_AT_ONCE)]
        point, u, turn, width = places
        parts = [self._seen_at_once(surface, rays, (point[own], u[own], turn[own], width[own]), levels) for own in ends]
        return np.concatenate(parts, axis=2)

    def _seen_at_once(self, surface: SurfacePoints, rays: _Rays, places: _Places, levels: _Levels) -> Float64:
        end_if_stopped()
        point, u, turn, width = places
        directions, weights = rays(surface.rows, point, u, turn)
        own = np.flatnonzero(weights > 0.0)
        begun = point[own]
        origins, ways = surface.points.take(begun, axis=0), directions.take(own, axis=0)
        faces = self.caster.next_hit(origins, surface.facets.take(begun, axis=0), ways)
        hits = resolve_hits(faces, origins, ways, self.scene.mesh.vertices, self.scene.mesh.faces)
        met = own[hits.ray]
        other = surface_at(hits, self.scene.mesh, hits.points - directions[met], outside=surface.outside)
        found = levels(other)
        seen = np.zeros((*found.shape[:2], len(point)))
        if self.scene.is_surrounded:
            seen[0][:, own] = self.weights[:, None] * self.surroundings(origins, ways, width[own])
        seen[..., met] = found
        return seen * weights

    def _hints(self, surface: SurfacePoints, shown: Sequence[Reflectance], angle: float) -> Float64:
        # levels of points that rays met, without shadows, and those of highlights that may be beside them, where
        # normals are uncertain by an angle [rad]; shape (2, lights, k)
        levels = np.zeros((2, len(self.lights), len(surface)))
        if not self.scene.bounces:
            return levels
        levels[0] = isolated_levels(surface, self.lights, shown, None, penumbrae=False)
        if any(own.R_s for own in shown):
            wide = [(own, math.hypot(own.sigma, angle)) for own in shown]
            spread = [replace(own, R_d=0.0, R_s=own.R_s * (own.sigma / w) ** 2, sigma=w) for own, w in wide]
            levels[1] = isolated_levels(surface, self.lights, spread, None, penumbrae=False)
        return levels

    def _levels(self, surface: SurfacePoints, bounces: int, shown: Sequence[Reflectance]) -> Float64:
        # levels of points that rays met before so many bounces, shape (1, lights, k); shown: for direct light
        if not bounces:
            return np.zeros((1, len(self.lights), len(surface)))
        levels = isolated_levels(surface, self.lights, shown, self.blocker, penumbrae=False)[None]
        if surface.front.any() and (bounces > 1 or self.scene.is_surrounded):
            seen_from_front = np.flatnonzero(surface.front)
            for index, some, own in surface.take(seen_from_front).by_material(self.scene.reflectances):
                nodes = _cells(len(some), NESTED_CELLS)
                for by_lobe in (False, True):
                    factor, rays = self._ways(own, by_lobe=by_lobe)
                    width = np.full(len(nodes[0]), 2.0 * _turn_between_rays(own, NESTED_CELLS, by_lobe=by_lobe))
                    seen = self._seen(
                        some, rays, (*nodes, width), lambda met: self._levels(met, bounces - 1, self.scene.reflectances)
                    )
                    mean = seen.reshape(len(self.lights), len(some), -1).mean(axis=2)
                    levels[0][:, seen_from_front[index]] += factor * mean
        return levels


def _turn_between_rays(own: Reflectance, cells: tuple[int, int], *, by_lobe: bool) -> float:
    # of half vectors, which turn by half of what directions do [rad]
    whole = 16.0 * math.pi * (SPREAD * own.sigma) ** 2 if by_lobe else 2.0 * math.pi
    return 0.5 * math.sqrt(1.0 / (cells[0] * cells[1]) * whole)


def _mirrored_light(light: PanelLight, sigma: float, caster: RayCaster) -> PanelLight | ConvergedPanel:
    # a light as the part sees it in itself: the half vectors of a panel's points turn by half of what directions do
    if isinstance(light, SurfaceLight):
        return light
    k = max(LEAST_POINTS, math.ceil(0.5 * max(light.size) / (light.distance * sigma)))
    if light.points != "auto" and light.points >= k * k:
        return light
    whole = replace(light, points="auto", normalisation="mean", gain=light.total_weight)
    cells = k if k <= MOST_POINTS else 0
    return replace(converged_panel(whole, centre=caster.centre, radius=caster.radius), cells=cells)


@kernel
def _share_on_rectangles(rectangles: Float64, origins: Float64, directions: Float64, width: Float64) -> Float64:
    # how much of each ray, which is as wide as an angle [rad], meets rectangles, as those of housings
    share = np.zeros(len(origins))
    for i in range(len(origins)):
        origin, way = vector_at(origins, i), vector_at(directions, i)
        for rectangle in rectangles:
            towards, normal = minus(vector_at(rectangle, 0), origin), vector_at(rectangle, 1)
            facing, height = dot(way, normal), dot(towards, normal)
            if facing * height > 0.0:
                reach, met = height / facing, 1.0
                place = minus(scaled(way, reach), towards)
                for axis in range(2, 4):
                    side = vector_at(rectangle, axis)
                    at, half = dot(place, side), 0.5 * max(1e-9, width[i] * reach * length(way) * length(side))
                    met *= max(0.0, min(1.0, at + half) - max(-1.0, at - half)) / (2.0 * half)
                share[i] += met
        share[i] = min(1.0, share[i])
    return share


@kernel
def _frame(n: Vector) -> tuple[Vector, Vector]:
    # two unit vectors perpendicular to a unit vector and to each other (Duff et al. 2017, JCGT 6(1))
    sign = math.copysign(1.0, n.z)
    a = -1.0 / (sign + n.z)
    b = n.x * n.y * a
    return Vector(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), Vector(b, sign + n.y * n.y * a, -n.y)


def _cells(count: int, cells: tuple[int, int]) -> tuple[Index, Float64, Float64]:
    # middles of the cells of the unit square for so many points: point, u, turn. Rows are shifted against each other
    row, column = (a.ravel() for a in np.mgrid[0 : cells[0], 0 : cells[1]])
    u, turn = (row + 0.5) / cells[0], (column + row * _SHIFT % 1.0) / cells[1]
    return np.repeat(np.arange(count), len(u)), np.tile(u, count), np.tile(turn, count)


@kernel
def _divided(
    points: Float64, point: Index, u: Float64, turn: Float64, sides: Index, cells: tuple[int, int]
) -> tuple[Index, Float64, Float64]:
    # places in each cell divided into sides², one in each piece: number of the cell, u, turn. Where in the pieces they
    # are follows the R₂ sequence (Roberts 2018) from a start that differs from point to point
    count = np.sum(sides**2)
    cell, new_u, new_turn = np.empty(count, np.intp), np.empty(count), np.empty(count)
    k = first = 0
    for c in range(len(point)):
        p, n = vector_at(points, point[c]), sides[c]
        if c > 0 and point[c] != point[c - 1]:
            first = k
        start = _SCATTER * (p.x + _STEP_U * p.y + _STEP_V * p.z)
        for i in range(n):
            for j in range(n):
                s, t = start + _STEP_U * (k - first), start * _STEP_U + _STEP_V * (k - first)
                cell[k] = c
                new_u[k] = u[c] + ((i + s - math.floor(s)) / n - 0.5) / cells[0]
                new_turn[k] = turn[c] + ((j + t - math.floor(t)) / n - 0.5) / cells[1]
                k += 1
    return cell, new_u, new_turn


@kernel
def _sides(first: Float64, cells: tuple[int, int]) -> Index:
    # rays along each side of the cells of points, by what their first rays add to the level, and highlights that may be
    # beside them, shape (2, lights, cells): cells that differ from those beside them get more
    (_, lights, count), (rows, columns) = first.shape, cells
    sides, off = np.ones(count, np.intp), np.empty((rows, columns))
    for begin in range(0, count, rows * columns):
        off[:] = 0.0
        for light in range(lights):
            values = first[0, light, begin : begin + rows * columns].reshape(cells)
            near = first[1, light, begin : begin + rows * columns].reshape(cells)
            limit = CHANGE + RELATIVE_CHANGE * np.sum(values)
            for row in range(rows):
                for column in range(columns):
                    # turns have no end
                    own, spread = values[row, column], near[row, column]
                    spread = max(spread, abs(own - values[row, column - 1]))
                    spread = max(spread, abs(own - values[row, (column + 1) % columns]))
                    spread = max(spread, abs(own - values[max(row - 1, 0), column]))
                    spread = max(spread, abs(own - values[min(row + 1, rows - 1), column]))
                    off[row, column] = max(off[row, column], spread / limit)
        for row in range(rows):
            for column in range(columns):
                number = 2 if off[row, column] > LEAST_SHARE else 1
                while 1 < number < MOST_SIDES and number**1.5 < off[row, column]:
                    number += 1
                sides[begin + row * columns + column] = number
    return sides


@kernel
def _gathered(values: Float64, sides: Index, count: int, most: float) -> Float64:
    # what rays add to the levels of so many points, about its error, and what single rays add beyond the most, shape
    # (3, lights, count); values: of the sides² rays of each cell, cell by cell, shape (lights, rays)
    found, cells = np.zeros((3, len(values), count)), len(sides) // count
    for light in range(len(values)):
        k = 0
        for c in range(len(sides)):
            number = sides[c] ** 2
            sum_of_all = sum_of_squares = beyond = 0.0
            for value in values[light, k : k + number]:
                small = min(value / number, most)
                sum_of_all += small
                sum_of_squares += small * small
                beyond += value / number - small
            # of the mean of values that differ as those of their cell do; of one alone, from nothing
            mean = sum_of_all / number if number > 1 else 0.0
            k += number
            found[0, light, c // cells] += sum_of_all
            found[1, light, c // cells] += max(0.0, sum_of_squares - number * mean * mean)
            found[2, light, c // cells] += beyond
    found[1] = np.sqrt(found[1])
    return found


@kernel
def _turned(n: Vector, angle: float, turn: float) -> Vector:
    # unit vector at an angle [rad] to n, in a direction [turns] about it
    first, second = _frame(n)
    turn *= 2.0 * math.pi
    across = plus(scaled(first, math.cos(turn)), scaled(second, math.sin(turn)))
    return plus(scaled(n, math.cos(angle)), scaled(across, math.sin(angle)))


@kernel
def lobe_rays(rows: PointRows, lobe: Lobe, point: Index, u: Float64, turn: Float64) -> tuple[Float64, Float64]:
    """Directions in which the lobe of points gathers light, shape (k, 3), and weights, shape (k,).

    The mean of weight times light is ∫ lobe/cosθ_o · light dω. Views are mirrored by half vectors as dense as a lobe of
    SPREAD times the width, whose rays meet highlights in its tail, as many by each of several lobes; dω of light
    is 4 (V·H) dω of H. In each direction from the normal, they are as dense as a brushed surface's lobe is wide there.

    point: Of each ray, shape (k,)
    u, turn: Place of each ray in the unit square, shape (k,)
    """
    _, frames, views, facets, _ = rows
    directions, weights = np.empty((len(point), 3)), np.zeros(len(point))
    for k in range(len(point)):
        i = point[k]
        n, v, own = vector_at(frames, i), vector_at(views, i), lobe
        if lobe.widening > 1.0:
            along = square_across(_turned(n, 0.5 * math.pi, turn[k]), lobe_at(lobe, frames, i))
            own = lobe_of_width(lobe, lobe.inverse * (1.0 - along))
        n_dot_v, delta = dot(n, v), _leaning(u[k], own)
        half = _turned(n, delta, turn[k])
        across = dot(v, half)
        way = minus(scaled(half, 2.0 * across), v)
        directions[k, 0], directions[k, 1], directions[k, 2] = way
        above = dot(n, way) > 0.0 and dot(vector_at(facets, i), way) > 0.0
        if n_dot_v > 0.0 and across > 0.0 and delta < math.pi and above:
            turned, away = lobe_at(lobe, frames, i), minus(n, half)
            factor = light_factor(dot(n, way), square_across(way, turned), 2.0 * across, lobe)
            value = specular_lobe(dot(away, away), square_across(away, turned), turned) * factor
            divisor = specular_divisor(n_dot_v, square_across(v, turned), lobe)
            weights[k] = 8.0 * math.pi * value * across * _solid_angle(delta, own) / divisor
    return directions, weights


@kernel
def _leaning(u: float, lobe: Lobe) -> float:
    # δ of a half vector [rad], below which is a share u of all
    if lobe.ggx:
        return math.atan(SPREAD * math.sqrt(2.0 / lobe.inverse * u / (1.0 - u)))
    squared = -math.log(1.0 - u) / lobe.inverse
    if lobe.wider > 0:
        # of several lobes, evenly from their common middle outwards: neighbouring shares are neighbouring directions
        low, high = squared, squared * lobe.inverse / lobe.inverses[lobe.wider - 1]
        for _ in range(_MOST_STEPS):
            outside = math.exp(-squared * lobe.inverse)
            slope = lobe.inverse * outside
            for k in range(lobe.wider):
                tail = math.exp(-squared * lobe.inverses[k])
                outside += tail
                slope += lobe.inverses[k] * tail
            off = outside - (lobe.wider + 1) * (1.0 - u)
            if off > 0.0:
                low = squared
            else:
                high = squared
            step = off / slope if slope > 0.0 else 0.0
            if abs(step) <= 1e-9 * squared:
                break
            squared += step
            if not low < squared < high:
                squared = 0.5 * (low + high)
    return SPREAD * math.sqrt(squared)


@kernel
def _solid_angle(delta: float, lobe: Lobe) -> float:
    # sinδ dδ per share of the half vectors
    if lobe.ggx:
        tangent, alpha_squared = math.tan(delta), SPREAD**2 * 2.0 / lobe.inverse
        density = 2.0 * alpha_squared * (1.0 + tangent * tangent) / (alpha_squared + tangent * tangent) ** 2
        return math.cos(delta) / density
    density = 2.0 * lobe.inverse / SPREAD**2 * math.exp(-(delta * delta) * lobe.inverse / SPREAD**2)
    for k in range(lobe.wider):
        wide = lobe.inverses[k] / SPREAD**2
        density += 2.0 * wide * math.exp(-(delta * delta) * wide)
    density /= lobe.wider + 1
    narrowing = math.sin(delta) / delta if delta > 1e-6 else 1.0
    return narrowing / density


@kernel
def _rays_by_cosine(
    rows: PointRows, form: DiffuseForm, point: Index, u: Float64, turn: Float64
) -> tuple[Float64, Float64]:
    # as dense as N·l; weights are diffuse light over that of Lambert's
    _, frames, views, facets, _ = rows
    directions, weights = np.empty((len(point), 3)), np.zeros(len(point))
    for k in range(len(point)):
        way = _turned(vector_at(frames, point[k]), math.asin(math.sqrt(u[k])), turn[k])
        directions[k, 0], directions[k, 1], directions[k, 2] = way
        if dot(vector_at(facets, point[k]), way) > 0.0:
            weights[k] = 1.0
            if not is_lambert(form):
                n, v = vector_at(frames, point[k]), vector_at(views, point[k])
                cosine = math.sqrt(1.0 - u[k])
                weights[k] = diffuse_term(cosine, dot(n, v), dot(way, v), form) / cosine
    return directions, weights
