"""The panel light: where it stands, its point lights, and whether two panels collide.

In kernels: the places of its points, their fall-off and their emission. A light kind is described by such functions
alone; kernels that add up its light know no more of it.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from lightopt.core.arrays import Float32, Float64, Int64
from lightopt.core.kernels import kernel
from lightopt.core.transforms import azimuth_tangent, direction, elevation_tangent
from lightopt.core.vectors import Vector


@dataclass(frozen=True, kw_only=True)
class PanelLight:
    """A rectangular panel, in whichever frame its vectors are given (world or part)."""

    name: str
    elevation: float  # of the direction to its centre, world frame [rad]
    azimuth: float  # of the direction to its centre, world frame [rad]
    distance: float  # panel centre to origin [mm]
    centre: Float64  # [mm], shape (3,)
    across: Float64  # unit vector of one side, shape (3,); e_φ of a panel that faces the origin
    along: Float64  # unit vector of the other side, shape (3,); e_θ of a panel that faces the origin
    # unit vector across × along, shape (3,), from the origin to a panel that faces it; it shines along −outward
    outward: Float64
    size: tuple[float, float]  # sides along `across` and `along` [mm]
    points: int | Literal["auto"]  # number of point lights k², or ``"auto"`` for the converged panel
    normalisation: Literal["mean", "sum"] = "mean"
    gain: float = 1.0
    inverse_square: bool = False  # whether light falls off with (reference distance / r)²
    emission_exponent: float = 0.0  # n of the emission cosⁿ(angle to the panel's axis); 0 is the paper's point light
    reference_distance: float | None = None  # [mm]; None for the panel's own distance

    @property
    def total_weight(self) -> float:
        """Sum of the weights of the panel's points (1/m each for ``mean``, 1 each for ``sum``), times the gain."""
        if self.normalisation == "sum" and self.points != "auto":
            return self.gain * self.points
        return self.gain

    def moved(self, rotation: Float64, translation: Float64) -> "PanelLight":
        """The panel after x' = rotation·x + translation, of shapes (3, 3) and (3,)."""
        return replace(
            self,
            centre=rotation @ self.centre + translation,
            across=rotation @ self.across,
            along=rotation @ self.along,
            outward=rotation @ self.outward,
        )


def place_light(*, distance: float, elevation: float, azimuth: float, **panel: Any) -> PanelLight:
    """Panel centred at ``distance·d(elevation, azimuth)``, facing the origin; [mm], [rad], world frame.

    panel: The fields of the light that do not depend on where it stands: name, size, points, …
    """
    axes = _facing(elevation, azimuth)
    return _panel(axes, distance * axes[2], distance=distance, elevation=elevation, azimuth=azimuth, **panel)


def pose_light(
    *, centre: Float64, rotation: Float64, elevation: float, azimuth: float, start: tuple[float, float], **panel: Any
) -> PanelLight:
    """Panel of a measured pose, carried about the origin from the angles where it was measured to others.

    centre: Where it was measured, world frame [mm], shape (3,)
    rotation: Of its own axes (across, along, outward) there, to the world's
    elevation, azimuth: Where it stands now [rad]
    start: Elevation and azimuth where it was measured [rad]
    panel: As of :func:`place_light`
    """
    if (elevation, azimuth) != start:
        before, after = (np.stack(_facing(*angles), axis=1) for angles in (start, (elevation, azimuth)))
        carried = after @ before.T
        centre, rotation = carried @ centre, carried @ rotation
    distance = float(np.linalg.norm(centre))
    return _panel(tuple(rotation.T), centre, distance=distance, elevation=elevation, azimuth=azimuth, **panel)


def _panel(axes: tuple[Float64, ...], centre: Float64, **panel: Any) -> PanelLight:
    across, along, outward = axes
    return PanelLight(centre=centre, across=across, along=along, outward=outward, **panel)


def _facing(elevation: float, azimuth: float) -> tuple[Float64, Float64, Float64]:
    # axes of a panel that stands there and faces the origin
    outward = direction(elevation=elevation, azimuth=azimuth)
    return azimuth_tangent(azimuth=azimuth), elevation_tangent(elevation=elevation, azimuth=azimuth), outward


def panel_grid(light: PanelLight, points: int) -> Float64:
    """The m point lights of a panel at the centres of a k×k grid of cells (paper, figure 7), shape (m, 3) [mm].

    points: m = k²
    """
    k = math.isqrt(points)
    offsets = (np.arange(k) + 0.5) / k - 0.5
    across = (offsets * light.size[0])[None, :, None] * light.across
    along = (offsets * light.size[1])[:, None, None] * light.along
    return np.ascontiguousarray((light.centre + across + along).reshape(-1, 3))


def panel_corners(light: PanelLight) -> Float64:
    """Corners of a panel in order around it [mm], shape (4, 3), frame of the panel's vectors."""
    across = 0.5 * light.size[0] * light.across
    along = 0.5 * light.size[1] * light.along
    return np.array([light.centre + s * across + t * along for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))])


def plane_places(light: PanelLight, origins: Float64, directions: Float64) -> tuple[Float64, Float64, Float64]:
    """Where rays meet the plane of a light: u and v on it from its centre [mm], and how many directions away it is.

    NaN where they do not; places beyond the light's edges are not left out.

    origins, directions: Of the rays, shape (3,) or (k, 3), and (k, 3), of any length
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = ((light.centre - origins) @ light.outward) / (directions @ light.outward)
    distance = np.where(distance > 0.0, distance, np.nan)
    offset = origins + distance[:, None] * directions - light.centre
    return offset @ light.across, offset @ light.along, distance


def rectangles_meet(a: PanelLight, b: PanelLight) -> bool:
    """Whether two panels touch or cross: no axis separates them (Gottschalk et al. 1996, doi:10.1145/237170.237244)."""
    between = b.centre - a.centre
    if float(np.linalg.norm(between)) > 0.5 * (float(np.hypot(*a.size)) + float(np.hypot(*b.size))):
        return False
    sides = [0.5 * light.size[i] * axis for light in (a, b) for i, axis in enumerate((light.across, light.along))]
    edges = [light_axis for light in (a, b) for light_axis in (light.across, light.along)]
    axes = [a.outward, b.outward, *edges]
    axes += [np.cross(p, q) for p, q in itertools.product(edges[:2], edges[2:])]
    # sides within the planes, which separate rectangles that lie in one plane
    axes += [np.cross(light.outward, edge) for light in (a, b) for edge in edges]
    for axis in axes:
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            continue
        reach = sum(abs(float(side @ axis)) for side in sides)
        if abs(float(between @ axis)) > reach + 1e-9 * length:
            return False
    return True


class PanelNumbers(NamedTuple):
    """A panel in the part's frame; a point of it is ``centre + s·across + t·along`` with s, t in [−½, ½]."""

    centre: Vector
    across: Vector  # one side [mm]
    along: Vector  # the other side [mm]
    outward: Vector
    distance: float  # at which the fall-off is 1 [mm]
    inverse_square: bool
    emission_exponent: float


def panel_numbers(light: PanelLight) -> PanelNumbers:
    """The numbers of a panel, in the frame that its vectors are given in."""
    return PanelNumbers(
        centre=Vector(*light.centre.tolist()),
        across=Vector(*(light.size[0] * light.across).tolist()),
        along=Vector(*(light.size[1] * light.along).tolist()),
        outward=Vector(*light.outward.tolist()),
        distance=float(light.distance if light.reference_distance is None else light.reference_distance),
        inverse_square=light.inverse_square,
        emission_exponent=float(light.emission_exponent),
    )


@kernel
def panel_point(panel: PanelNumbers, s: float, t: float) -> Vector:
    """The point centre + s·across + t·along."""
    c, a, b = panel.centre, panel.across, panel.along
    return Vector(c.x + s * a.x + t * b.x, c.y + s * a.y + t * b.y, c.z + s * a.z + t * b.z)


@kernel
def half_diagonal(panel: PanelNumbers) -> float:
    """Of the panel [mm]."""
    a, b = panel.across, panel.along
    return 0.5 * math.sqrt(a.x**2 + a.y**2 + a.z**2 + b.x**2 + b.y**2 + b.z**2)


@kernel
def attenuated(weight: float, panel: PanelNumbers, r2: float, cosine: float) -> float:
    """Weight of a point of the panel after its fall-off and emission.

    r2: Squared distance from the point to the surface [mm²]
    cosine: Between the direction to the surface and the panel's axis
    """
    if panel.inverse_square:
        weight *= panel.distance * panel.distance / r2
    if panel.emission_exponent > 0.0:
        weight *= max(0.0, cosine) ** panel.emission_exponent
    return weight


TERM_NUMBERS = 5
PICTURE = 2


class Pattern(NamedTuple):
    """What the radiance of a light is multiplied by, at each place on it."""

    terms: Float64  # shape (b, TERM_NUMBERS)
    # levels of all pictures, each in full and in means of 2 × 2, 4 × 4, ... of its pixels, one after the other
    values: Float32
    levels: Int64  # where each of these begins in `values`, its rows and its columns, shape (pictures, halvings, 3)


def _stripes(terms: list[list[float]]) -> Pattern:
    return Pattern(np.array(terms), np.zeros(0, np.float32), np.zeros((0, 0, 3), np.int64))


UNIFORM = _stripes([[1.0, 0.0, 0.0, 0.0, 0.0]])  # the pattern that is 1 everywhere


def sine_pattern(axis: int, *, period: float, phase: float) -> Pattern:
    """Stripes ½·(1 + cos(2π·x/period + phase)); [mm] or, on a dome, [rad]."""
    wave = 2.0 * math.pi / period
    cosine = [0.5 * math.cos(phase), axis, wave, 0.0, 0.0]
    sine = [-0.5 * math.sin(phase), axis, wave, -0.5 * math.pi, 0.0]
    return _stripes([[0.5, 0.0, 0.0, 0.0, 0.0], cosine, sine])


def bar_pattern(axis: int, *, period: float, phase: float, duty: float) -> Pattern:
    """Bars that take up the share `duty` of a period [mm], in the middle of one where 2π·x/period + phase is 0."""
    return _stripes([[1.0, axis, 2.0 * math.pi / period, phase, duty]])


def picture_patterns(pictures: Sequence[Float64], size: tuple[float, float]) -> list[Pattern]:
    """A pattern for each of some pictures of one light, each spread over all of it.

    pictures: Shares of the full radiance, as seen from the part with `along` upwards, shape (rows, columns) each: row 0
        is at the greatest v, column 0 at the greatest u
    size: Of the light along `across` and `along` [mm]
    """
    halvings = max(math.ceil(math.log2(max(picture.shape))) for picture in pictures) + 1
    levels, values, used = np.zeros((len(pictures), halvings, 3), np.int64), list[Float32](), 0
    for number, picture in enumerate(pictures):
        total, count = picture, np.ones(picture.shape)
        for halving in range(halvings):
            levels[number, halving] = used, *total.shape
            values.append((total / count).astype(np.float32).ravel())
            used += total.size
            total, count = _halved(total), _halved(count)
    joined = np.concatenate(values)
    terms = [np.array([[1.0, PICTURE, number + 1.0, *size]]) for number in range(len(pictures))]
    return [Pattern(own, joined, levels) for own in terms]


def _halved(sums: Float64) -> Float64:
    # sums over 2 × 2 pixels; fewer at the last row and column of an odd number
    rows, columns = sums.shape
    even = np.pad(sums, ((0, rows % 2), (0, columns % 2)))
    return even.reshape((rows + 1) // 2, 2, (columns + 1) // 2, 2).sum(axis=(1, 3))


def pattern_at(pattern: Pattern, u: Float64, v: Float64) -> Float64:
    """What a pattern multiplies the radiance by at places on the light [mm], shape (n,)."""
    values = np.zeros(len(u))
    for coefficient, axis, wave, phase, duty in pattern.terms:
        if axis == PICTURE:
            first, rows, columns = pattern.levels[int(wave) - 1, 0]
            row = np.clip(np.floor((0.5 - v / duty) * rows), 0, rows - 1).astype(np.intp)
            column = np.clip(np.floor((0.5 - u / phase) * columns), 0, columns - 1).astype(np.intp)
            values += coefficient * pattern.values[first + row * columns + column]
            continue
        angle = wave * (v if axis else u) + phase
        bright = np.abs(np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi) <= duty * math.pi
        values += coefficient * (bright if duty > 0.0 else np.cos(angle))
    return values


def pattern_picture(pattern: Pattern, size: tuple[float, float], pixels: tuple[int, int]) -> Float64:
    """Mean of a pattern over each pixel of a display, exact, shape (rows, columns).

    size: Of the display along `across` and `along` [mm]
    pixels: Columns and rows; as :func:`picture_light` has them, row 0 is at the greatest v, column 0 at the greatest u
    """
    sums = [np.zeros(count) for count in pixels]
    shown = np.zeros(pixels[::-1])
    for term in pattern.terms:
        axis = int(term[1])
        if axis == PICTURE:
            first, rows, columns = pattern.levels[int(term[2]) - 1, 0]
            values = pattern.values[first : first + rows * columns].reshape(rows, columns).astype(np.float64)
            shown += term[0] * (_shares(pixels[1], rows) @ values @ _shares(pixels[0], columns).T)
            continue
        edges = size[axis] * (0.5 - np.arange(pixels[axis] + 1) / pixels[axis])
        sums[axis] += term[0] * _means(edges, wave=term[2], phase=term[3], duty=term[4])
    return shown + sums[1][:, None] + sums[0][None, :]


def _shares(pixels: int, of: int) -> Float64:
    # how much of each pixel is within each of so many others on the same side, shape (pixels, of)
    ends, others = np.arange(pixels + 1) / pixels, np.arange(of + 1) / of
    low = np.maximum(ends[:-1, None], others[None, :-1])
    high = np.minimum(ends[1:, None], others[None, 1:])
    return np.maximum(0.0, high - low) * pixels


def _means(edges: Float64, *, wave: float, phase: float, duty: float) -> Float64:
    # means of a term without its coefficient between neighbouring edges [mm]
    if wave == 0.0:
        return np.full(len(edges) - 1, math.cos(phase))
    at = wave * edges + phase
    if duty == 0.0:
        return np.diff(np.sin(at)) / np.diff(at)
    # bars up to a place: whole ones, and the share of the last one
    turns = at / (2.0 * math.pi) + 0.5 * duty
    whole = np.floor(turns)
    return np.diff(whole * duty + np.minimum(turns - whole, duty)) / np.diff(turns)
