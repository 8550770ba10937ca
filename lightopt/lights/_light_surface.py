"""The surfaces that lights shine from, other than the panel: cut into elements whose edges are lines of (u, v).

Each element is a piece of a plane, of a cone (also of a cylinder, or of a ring in a plane) or of a sphere. All of them
shine with the same radiance on one side (Lambert's law), so that the light of an element at a point is

    ∫ L · cosα / r² · dA,    dA = |∂x/∂u × ∂x/∂v| du dv

times what the surface reflects; α is the angle at the element, r the distance. Frames of lights are as
:class:`~lightopt.lights.PanelLight` has them: `across`, `along` and `outward`, which points away from the part.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from lightopt.core.arrays import Float64, Int32
from lightopt.core.kernels import kernel
from lightopt.core.vectors import Vector, cross, dot, length, minus, plus, scaled
from lightopt.lights._panel import UNIFORM, PanelLight, Pattern, panel_corners

PLANE, CONE, SPHERE, FRAME = 0, 1, 2, 3
_NODES = 8  # a side of an element, for its brightness and its outline


class Element(NamedTuple):
    """A piece of a light's surface, u in [u0, u1] and v in [v0, v1].

    shape: PLANE: origin + u·a + v·b; u, v [mm]
        CONE: origin + (radius + v·widening)·(cos u·a + sin u·b) + v·rise·c, widening² + rise² = 1; u [rad], v [mm]
        SPHERE: origin + radius·(cos v·(cos u·a + sin u·b) + sin v·c); u, v [rad]
        FRAME: from the circle origin + radius·(cos u·a + sin u·b) at v = 0 straight out to the line
        origin + widening·(a + tan u·b) at v = 1; u [rad]
    origin: [mm]; a, b, c: orthogonal unit vectors, right-handed
    side: 1 where it shines along ∂x/∂u × ∂x/∂v, −1 on the other side
    radiance: At exposure 1, per unit of what the surface reflects
    centre, reach: Sphere around the element [mm]
    """

    shape: int
    origin: Vector
    a: Vector
    b: Vector
    c: Vector
    u0: float
    u1: float
    v0: float
    v1: float
    radius: float
    widening: float
    rise: float
    side: float
    radiance: float
    centre: Vector
    reach: float


ELEMENT_NUMBERS = 26  # numbers of an element in a row of an array
RADIANCE = 21  # number of its radiance among them


@kernel
def element_at(rows: Float64, i: int) -> Element:
    """An element of a light, from row i of an array of shape (e, ELEMENT_NUMBERS)."""
    r = rows[i]
    origin, centre = Vector(r[1], r[2], r[3]), Vector(r[22], r[23], r[24])
    a, b, c = Vector(r[4], r[5], r[6]), Vector(r[7], r[8], r[9]), Vector(r[10], r[11], r[12])
    return Element(
        int(r[0]), origin, a, b, c, r[13], r[14], r[15], r[16], r[17], r[18], r[19], r[20], r[21], centre, r[25]
    )


@kernel
def element_place(e: Element, u: float, v: float) -> tuple[Vector, Vector, Vector]:
    """A point of an element [mm], and its derivatives along u and v."""
    if e.shape == PLANE:
        return place_on_element(e, u, v, (1.0, 0.0), (1.0, 0.0))
    of_v = (math.cos(v), math.sin(v)) if e.shape == SPHERE else (1.0, 0.0)
    return place_on_element(e, u, v, (math.cos(u), math.sin(u)), of_v)


@kernel
def place_on_element(
    e: Element, u: float, v: float, of_u: tuple[float, float], of_v: tuple[float, float]
) -> tuple[Vector, Vector, Vector]:
    """As :func:`element_place`, given the cosine and sine of u, and those of v on a sphere."""
    if e.shape == PLANE:
        return plus(e.origin, plus(scaled(e.a, u), scaled(e.b, v))), e.a, e.b
    around = plus(scaled(e.a, of_u[0]), scaled(e.b, of_u[1]))
    turned = plus(scaled(e.b, of_u[0]), scaled(e.a, -of_u[1]))
    if e.shape == FRAME:
        tangent = of_u[1] / of_u[0]
        outer = scaled(plus(e.a, scaled(e.b, tangent)), e.widening)
        out = minus(outer, scaled(around, e.radius))
        along_edge = scaled(e.b, e.widening * (1.0 + tangent * tangent))
        place = plus(e.origin, plus(scaled(around, e.radius), scaled(out, v)))
        return place, plus(scaled(turned, (1.0 - v) * e.radius), scaled(along_edge, v)), out
    if e.shape == CONE:
        rho = e.radius + v * e.widening
        place = plus(e.origin, plus(scaled(around, rho), scaled(e.c, v * e.rise)))
        return place, scaled(turned, rho), plus(scaled(around, e.widening), scaled(e.c, e.rise))
    rho, height = e.radius * of_v[0], e.radius * of_v[1]
    place = plus(e.origin, plus(scaled(around, rho), scaled(e.c, height)))
    return place, scaled(turned, rho), plus(scaled(around, -height), scaled(e.c, rho))


@kernel
def element_weight(e: Element, towards: Vector, along_u: Vector, along_v: Vector) -> float:
    """Radiance · cosα / r² · dA per du dv of a place of an element; 0 on the side that does not shine.

    towards: From the surface to the place [mm]
    along_u, along_v: From :func:`element_place`
    """
    r2 = dot(towards, towards)
    # |∂u × ∂v|·cosα is the product of the cross product with the direction to the surface
    facing = -e.side * dot(cross(along_u, along_v), towards)
    return e.radiance * max(0.0, facing) / (r2 * math.sqrt(r2))


@kernel
def _light_at(rows: Float64, p: Vector, nodes: Float64, weights: Float64) -> float:
    # ∫ L·cosα/r² dA of all elements at a point
    total = 0.0
    for i in range(len(rows)):
        e = element_at(rows, i)
        for m in range(len(nodes)):
            for n in range(len(nodes)):
                u, v = e.u0 + nodes[m] * (e.u1 - e.u0), e.v0 + nodes[n] * (e.v1 - e.v0)
                q, along_u, along_v = element_place(e, u, v)
                area = weights[m] * weights[n] * (e.u1 - e.u0) * (e.v1 - e.v0)
                total += element_weight(e, minus(q, p), along_u, along_v) * area
    return total


@kernel
def _bound(rows: Float64) -> None:
    # set the sphere around each element
    for i in range(len(rows)):
        e = element_at(rows, i)
        centre, _, _ = element_place(e, 0.5 * (e.u0 + e.u1), 0.5 * (e.v0 + e.v1))
        reach = 0.0
        for m in range(_NODES + 1):
            for n in range(_NODES + 1):
                u, v = e.u0 + (e.u1 - e.u0) * m / _NODES, e.v0 + (e.v1 - e.v0) * n / _NODES
                reach = max(reach, length(minus(element_place(e, u, v)[0], centre)))
        rows[i, 22], rows[i, 23], rows[i, 24], rows[i, 25] = centre.x, centre.y, centre.z, reach


@dataclass(frozen=True, kw_only=True)
class SurfaceLight(PanelLight):
    """A light of another shape than the panel, or one channel of it, in whichever frame its vectors are given.

    What it has of a panel is the frame that it stands in, with the size of the rectangle around it.
    """

    kind: str  # of the light, as in the rig file
    entry: int  # number of its entry in the rig file; channels of one entry have the surface in common
    elements: Float64  # of its surface, shape (e, ELEMENT_NUMBERS)
    pattern: Pattern  # what multiplies the radiance
    # of a pixel that looks straight at its full radiance at exposure 1, per unit of gain [grey level]
    direct_level: float = 0.0

    def moved(self, rotation: Float64, translation: Float64) -> "SurfaceLight":
        """The light after x' = rotation·x + translation, of shapes (3, 3) and (3,)."""
        panel = PanelLight.moved(self, rotation, translation)
        assert isinstance(panel, SurfaceLight)
        return replace(panel, elements=_moved(self.elements, rotation, translation))

    @property
    def is_flat(self) -> bool:
        """Whether it lies in a plane, within the rectangle around it."""
        return bool(np.isin(self.elements[:, 0], (PLANE, FRAME)).all())

    @property
    def targets(self) -> Float64:
        return np.ascontiguousarray(self.elements[:, 22:25])


def _moved(elements: Float64, rotation: Float64, translation: Float64) -> Float64:
    moved = elements.copy()
    for first in (1, 4, 7, 10, 22):
        moved[:, first : first + 3] = elements[:, first : first + 3] @ rotation.T
    for first in (1, 22):
        moved[:, first : first + 3] += translation
    return moved


@kernel
def _grid_places(rows: Float64, steps: int) -> Float64:
    # places of elements at so many steps along u and v [mm], shape (e, steps + 1, steps + 1, 3)
    places = np.empty((len(rows), steps + 1, steps + 1, 3))
    for k in range(len(rows)):
        e = element_at(rows, k)
        for i in range(steps + 1):
            for j in range(steps + 1):
                u, v = e.u0 + (e.u1 - e.u0) * i / steps, e.v0 + (e.v1 - e.v0) * j / steps
                q, _, _ = element_place(e, u, v)
                places[k, i, j, 0], places[k, i, j, 1], places[k, i, j, 2] = q.x, q.y, q.z
    return places


def surface_mesh(light: PanelLight) -> tuple[Float64, Int32]:
    """Triangles of a light, whose normals point to where it shines.

    Returns vertices, faces: [mm], shape (n, 3), frame of the light's vectors; shape (f, 3)
    """
    if not isinstance(light, SurfaceLight):
        return panel_corners(light), np.array([[0, 2, 1], [0, 3, 2]], np.int32)
    side = _NODES + 1
    vertices = _grid_places(light.elements, _NODES)
    corner = np.arange(vertices[..., 0].size, dtype=np.int32).reshape(-1, side, side)
    a, b, c, d = corner[:, :-1, :-1], corner[:, 1:, :-1], corner[:, 1:, 1:], corner[:, :-1, 1:]
    back = light.elements[:, None, None, None, 20] < 0.0
    faces = [np.where(back, np.stack(t[::-1], axis=-1), np.stack(t, axis=-1)) for t in ((a, b, c), (a, c, d))]
    return vertices.reshape(-1, 3), np.concatenate([some.reshape(-1, 3) for some in faces])


def outlines(light: PanelLight) -> Float64:
    """Corners of the flat pieces that a light is made of, in order around each [mm], shape (pieces, 4, 3)."""
    if not isinstance(light, SurfaceLight):
        return panel_corners(light)[None]
    corners = _grid_places(light.elements, 1)
    return np.stack([corners[:, 0, 0], corners[:, 1, 0], corners[:, 1, 1], corners[:, 0, 1]], axis=1)


def plane_elements(
    size: tuple[float, float], cells: tuple[int, int], *, centre: tuple[float, float] = (0.0, 0.0)
) -> Float64:
    """Elements of a rectangle in the light's plane, shape (e, ELEMENT_NUMBERS).

    size: Along `across` and `along` [mm]
    cells: Elements along these
    centre: Of the rectangle in the light's plane [mm]
    """
    u = centre[0] + size[0] * (np.linspace(0.0, 1.0, cells[0] + 1) - 0.5)
    v = centre[1] + size[1] * (np.linspace(0.0, 1.0, cells[1] + 1) - 0.5)
    # across × along is outward, and light goes the other way
    return _grid(u, v, shape=PLANE, side=-1.0)


def cone_elements(
    start: tuple[float, float], end: tuple[float, float], turn: tuple[float, float], cells: tuple[int, int]
) -> Float64:
    """Elements of a surface of revolution about the light's axis that shines towards the axis, or along it.

    start, end: Radius and height along `outward` of its profile's inner or upper end, and of its outer or lower end
        [mm]: it shines on the side that is then on the right
    turn: Azimuths about the axis that it begins and ends at, from `across` [rad]
    cells: Elements around and along the profile
    """
    long = math.hypot(end[0] - start[0], end[1] - start[1])
    widening, rise = (end[0] - start[0]) / long, (end[1] - start[1]) / long
    u, v = np.linspace(*turn, cells[0] + 1), np.linspace(0.0, long, cells[1] + 1)
    # ∂u × ∂v goes with rise·radial − widening·outward
    return _grid(u, v, shape=CONE, side=1.0, profile=(start[1], start[0], widening, rise))


def frame_elements(size: tuple[float, float], hole: float) -> Float64:
    """Elements of a rectangle in the light's plane around a round hole.

    size: Along `across` and `along` [mm]
    hole: Diameter of the hole [mm], less than either side
    """
    sides: list[Float64] = []
    for quarter in range(4):
        near, far = (0.5 * size[(quarter + k) % 2] for k in range(2))
        corner = math.atan2(far, near)
        u, v = np.linspace(-corner, corner, 7), np.linspace(0.0, 1.0, 3)
        rows = _grid(u, v, shape=FRAME, side=1.0, profile=(0.0, 0.5 * hole, near, 0.0))
        cosine, sine = (round(f(0.5 * math.pi * quarter)) for f in (math.cos, math.sin))
        rows[:, 4:10] = cosine, sine, 0.0, -sine, cosine, 0.0
        sides.append(rows)
    return np.concatenate(sides)


def half_pipe_elements(radius: float, length: float, slot: float) -> Float64:
    """Elements of the half of a cylinder about `across` on the side of `outward`, less a slot along its top.

    radius, length: [mm]
    slot: Width of the slot [mm], less than the diameter
    """
    open_ = math.asin(0.5 * slot / radius)
    halves = ((0.0, 0.5 * math.pi - open_), (0.5 * math.pi + open_, math.pi))
    turns = halves if slot > 0.0 else ((0.0, math.pi),)
    around = 12 // len(turns)
    ends = ((radius, 0.5 * length), (radius, -0.5 * length))
    rows = np.concatenate([cone_elements(*ends, turn, (around, 4)) for turn in turns])
    # about across instead of outward
    rows[:, 1:4] = 0.5 * length, 0.0, 0.0
    rows[:, 4:13] = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]).ravel()
    return rows


def sphere_elements(
    radius: float, turn: tuple[float, float], height: tuple[float, float], cells: tuple[int, int]
) -> Float64:
    """Elements of a sphere about the light's centre that shine inwards.

    turn: Azimuths about the axis that it begins and ends at, from `across` [rad]
    height: Elevations above the plane of `across` and `along`, on the side of `outward` [rad]
    cells: Elements around and up
    """
    u, v = np.linspace(*turn, cells[0] + 1), np.linspace(*height, cells[1] + 1)
    return _grid(u, v, shape=SPHERE, side=-1.0, profile=(0.0, radius, 0.0, 0.0))


def _grid(
    u: Float64, v: Float64, *, shape: int, side: float, profile: Sequence[float] = (0.0, 0.0, 0.0, 0.0)
) -> Float64:
    # elements between lines of u and v; profile: height, radius, widening, rise
    i, j = (a.ravel() for a in np.mgrid[: len(u) - 1, : len(v) - 1])
    rows = np.zeros((len(i), ELEMENT_NUMBERS))
    rows[:, 0], rows[:, 3], rows[:, 4:13] = shape, profile[0], np.eye(3).ravel()
    rows[:, 13:17] = np.stack([u[i], u[i + 1], v[j], v[j + 1]], axis=1)
    rows[:, 17:22] = *profile[1:], side, 1.0
    return rows


def surface_light(
    panel: PanelLight,
    *,
    kind: str,
    entry: int,
    elements: Float64,
    whole: Float64 | None = None,
    pattern: Pattern = UNIFORM,
    direct_level: float = 0.0,
) -> SurfaceLight:
    """A light of a shape, or a channel of it, where a panel would stand.

    Its radiance is such that all of the light, wholly in view of a surface at the origin that faces each of its
    points, gives it as much light as a panel of the same gain, so that segments add up to the whole light.

    panel: With the frame, name and gain of the light; world frame
    elements: Of this channel, in the frame of the panel about its centre; their radiances relative to the whole light
    whole: Those of the whole light; as `elements` if None
    entry, pattern, direct_level: As :class:`SurfaceLight` has them; the pattern is left out of the whole light
    """
    everything = elements if whole is None else whole
    # the origin of the world, seen from the light
    rotation = np.stack([panel.across, panel.along, panel.outward], axis=1)
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    total = _light_at(everything, Vector(*(-panel.centre @ rotation).tolist()), 0.5 * nodes + 0.5, 0.5 * weights)
    own = elements.copy()
    own[:, RADIANCE] /= total
    _bound(own)
    fields: dict[str, Any] = dict(vars(panel), points="auto", normalisation="mean")
    fields |= {"inverse_square": True, "emission_exponent": 1.0, "kind": kind, "entry": entry, "pattern": pattern}
    fields["direct_level"] = direct_level
    return SurfaceLight(**fields, elements=_moved(own, rotation, panel.centre))


def mixed_light(name: str, parts: Sequence[tuple[SurfaceLight, float]]) -> SurfaceLight:
    """A light of several that are on together, each with a weight above 0, where the first one stands.

    parts: Lights of the same pattern, or channels of one light
    """
    first, gain = parts[0][0], sum(weight * light.gain for light, weight in parts)
    shares = [weight * light.gain / gain for light, weight in parts]
    if all(np.array_equal(light.pattern.terms, first.pattern.terms) for light, _ in parts):
        rows = [_times(light.elements, RADIANCE, share) for (light, _), share in zip(parts, shares, strict=True)]
        return replace(first, name=name, gain=gain, elements=_summed(rows, RADIANCE))
    terms = [_times(light.pattern.terms, 0, share) for (light, _), share in zip(parts, shares, strict=True)]
    return replace(first, name=name, gain=gain, pattern=first.pattern._replace(terms=_summed(terms, 0)))


def _times(rows: Float64, column: int, factor: float) -> Float64:
    scaled_rows = rows.copy()
    scaled_rows[:, column] *= factor
    return scaled_rows


def _summed(parts: Sequence[Float64], column: int) -> Float64:
    # one row for all that differ in a column only, which has their sum
    rows = np.concatenate(parts)
    _, first, number = np.unique(np.delete(rows, column, axis=1), axis=0, return_index=True, return_inverse=True)
    merged = rows[first]
    merged[:, column] = np.bincount(number.ravel(), rows[:, column])
    return merged


def picture_light(display: SurfaceLight, picture: Float64) -> SurfaceLight:
    """A display that shows a picture, each pixel an element; black ones are left out.

    display: Without or with a pattern, which the picture takes the place of
    picture: Shares of the full radiance, as seen from the part with `along` upwards, shape (rows, columns): row 0 is at
        the greatest v, column 0 at the greatest u
    """
    rows, columns = np.nonzero(picture)
    u, v = (
        0.5 * side - side * np.arange(count + 1) / count
        for side, count in zip(display.size, reversed(picture.shape), strict=True)
    )
    own = np.repeat(display.elements[:1], len(rows), axis=0)
    own[:, 13:17] = np.stack([u[columns + 1], u[columns], v[rows + 1], v[rows]], axis=1)
    own[:, RADIANCE] *= picture[rows, columns]
    _bound(own)
    return replace(display, elements=own, pattern=UNIFORM)
