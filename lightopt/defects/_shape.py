"""What a defect is like, wherever it lies: its kind, size, profile and coefficients; the defects to plan for.

A place of the outline is ρ = 1, the centre (for a scratch its middle line) ρ = 0. A wall's slope, in units of the
steepest, is a function g(ρ) that vanishes at both ends, so that heights are smooth:

========  =====================================================================
dent      sin πρ, a cosine bowl; a bump the same upwards
blister   0 up to ρ = 0.6, the flat top; then sin π(ρ − 0.6)/0.4, upwards
pit       1, a cone, from ρ = 0.2 to 0.8; rounded linearly at the tip and at the rim
scratch   the same across: a V with a rounded bottom and rounded lips
========  =====================================================================
"""

import math
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel

DefectKind = Literal["scratch", "dent", "bump", "pit", "blister", "stain", "haze"]

SHAPE_KINDS: Final = ("scratch", "dent", "bump", "pit", "blister")
"""Kinds that turn the normal; a stain changes R_d, a haze σ."""

MAX_SLOPE: Final = math.radians(60.0)
"""Steeper walls would hide parts of themselves and cast shadows, which defects here do not [rad]."""

BLISTER_TOP: Final = 0.6  # share of a blister's radius that is flat

# shares of the radius over which the walls of pits and scratches are rounded at the bottom and at the rim
BLEND: Final = 0.2


@dataclass(frozen=True, kw_only=True)
class DefectShape:
    kind: DefectKind  # scratch, dent, bump, pit, blister, stain or haze
    length: float  # of its outline along its direction [mm], at least the width; equal for a round one
    width: float  # of its outline [mm], which is an ellipse, for a scratch a strip with round ends
    slope: float = 0.0  # steepest slope of its walls [rad], where they run along the length; 0 for stains and hazes
    R_d_factor: float = 1.0  # by which it multiplies R_d
    sigma_factor: float = 1.0  # by which it multiplies σ

    @property
    def depth(self) -> float:
        return depth_of_slope(self.kind, self.width, self.slope) if self.slope > 0.0 else 0.0

    @property
    def area(self) -> float:
        if self.kind == "scratch":
            return self.width * (self.length - self.width) + 0.25 * math.pi * self.width**2
        return 0.25 * math.pi * self.length * self.width


def depth_of_slope(kind: DefectKind, width: float, slope: float) -> float:
    """Depth or height of a defect [mm] from its steepest slope [rad]: tan(slope) · width/2 · the profile's integral.

    kind: One of :data:`SHAPE_KINDS`
    width: Shorter extent of the outline [mm]

    Examples
    --------
    >>> round(depth_of_slope("dent", 2.0, math.radians(2.0)), 4)
    0.0222
    """
    return math.tan(slope) * 0.5 * width * _rise(kind)


def slope_of_depth(kind: DefectKind, width: float, depth: float) -> float:
    """Steepest slope of a defect [rad] from its depth or height [mm]; the inverse of :func:`depth_of_slope`."""
    return math.atan(depth / (0.5 * width * _rise(kind)))


def _rise(kind: DefectKind) -> float:
    # integral of the relative slope from the centre to the rim, in radii
    if kind in ("dent", "bump"):
        return 2.0 / math.pi
    if kind == "blister":
        return (1.0 - BLISTER_TOP) * 2.0 / math.pi
    return 1.0 - BLEND


class Profile(NamedTuple):
    strip: bool  # with round ends, not an ellipse
    half_length: float  # [mm]
    half_width: float  # [mm]
    wall: int  # _BOWL, _BLISTER, _CONE or _FLAT
    rise: float  # tangent of the steepest slope, outwards: negative for a bump and a blister


_FLAT, _BOWL, _BLISTER, _CONE = 0, 1, 2, 3
_WALLS = {"dent": _BOWL, "bump": _BOWL, "blister": _BLISTER, "pit": _CONE, "scratch": _CONE}


def profile_of(shape: DefectShape) -> Profile:
    rise = math.tan(shape.slope) * (-1.0 if shape.kind in ("bump", "blister") else 1.0)
    wall = _WALLS.get(shape.kind, _FLAT)
    return Profile(shape.kind == "scratch", 0.5 * shape.length, 0.5 * shape.width, wall, rise)


@kernel
def _from_middle(profile: Profile, x: float) -> float:
    # along the length, from the middle line of a strip
    if not profile.strip:
        return x
    half = profile.half_length - profile.half_width
    return x - min(max(x, -half), half)


@kernel
def place_in_outline(profile: Profile, x: float, y: float) -> float:
    """ρ at a place x along the length and y across [mm]: 0 in the middle, 1 on the outline."""
    half = profile.half_width if profile.strip else profile.half_length
    return math.hypot(_from_middle(profile, x) / half, y / profile.half_width)


@kernel
def gradient_in_outline(profile: Profile, x: float, y: float) -> tuple[float, float]:
    """Slopes along x and along y, at a place [mm], of the height above the undisturbed surface."""
    rho = place_in_outline(profile, x, y)
    if rho >= 1.0 or rho <= 0.0 or profile.wall == _FLAT:
        return 0.0, 0.0
    if profile.wall == _CONE:
        steepness = min(min(rho, 1.0 - rho) / BLEND, 1.0)
    else:
        top = BLISTER_TOP if profile.wall == _BLISTER else 0.0
        steepness = math.sin(math.pi * max((rho - top) / (1.0 - top), 0.0))
    # the slope is that of ρ in units of 1 / (width / 2)
    half = profile.half_width if profile.strip else profile.half_length
    along = _from_middle(profile, x) * profile.half_width / (half * half * rho)
    return profile.rise * steepness * along, profile.rise * steepness * (y / (profile.half_width * rho))


@kernel
def _places(profile: Profile, x: Float64, y: Float64) -> Float64:
    places = np.empty(len(x))
    for i in range(len(x)):
        places[i] = place_in_outline(profile, x[i], y[i])
    return places


@kernel
def _gradients(profile: Profile, x: Float64, y: Float64) -> tuple[Float64, Float64]:
    along, across = np.empty(len(x)), np.empty(len(x))
    for i in range(len(x)):
        along[i], across[i] = gradient_in_outline(profile, x[i], y[i])
    return along, across


def radial_place(shape: DefectShape, x: Float64, y: Float64) -> Float64:
    """ρ at places x along the length and y across [mm]: 0 in the middle, 1 on the outline, shape (k,)."""
    return _places(profile_of(shape), x, y)


def height_gradient(shape: DefectShape, x: Float64, y: Float64) -> tuple[Float64, Float64]:
    """Slopes along x and along y of the height above the undisturbed surface, each of shape (k,)."""
    return _gradients(profile_of(shape), x, y)


SIZES: Final = (0.6, 1.0, 1.6)  # sizes that are tested, as multiples of an entry's; the slope stays
_SLOPES = 3  # steps of a range of slopes for which inspections are planned


@dataclass(frozen=True)
class CatalogueEntry:
    """A kind of defect that an inspection is planned for: its name, size, steepness and factors."""

    name: str
    shape: DefectShape
    sizes: tuple[float, float] = (1.0, 1.0)  # least and greatest, as multiples of the shape's
    slopes: tuple[float, float] = (1.0, 1.0)  # likewise

    def at(self, size: float, slope: float) -> "CatalogueEntry":
        """One defect of the ranges, from 0 for the least to 1 for the greatest size and slope, in equal ratios."""
        (small, large), (flat, steep) = self.sizes, self.slopes
        scale, steeper = small * (large / small) ** size, flat * (steep / flat) ** slope
        own = self.shape
        sides = {"length": scale * own.length, "width": scale * own.width}
        return CatalogueEntry(self.name, replace(own, **sides, slope=steeper * own.slope))

    def in_sizes(self) -> tuple["CatalogueEntry", ...]:
        """Entries of one size that together test all sizes of the range: each tests :data:`SIZES` of its own."""
        small, large = self.sizes
        count = max(1, math.ceil(math.log(large / small) / math.log(SIZES[-1] / SIZES[0]) - 1e-9))
        return tuple(self.at((i + 0.5) / count, 0.5) for i in range(count))

    def in_sizes_and_slopes(self) -> tuple["CatalogueEntry", ...]:
        """Entries of one size and slope that stand for the ranges, equally many of each part of them."""
        count = _SLOPES if self.slopes[0] < self.slopes[1] else 1
        return tuple(
            replace(one, shape=replace(one.shape, slope=self.at(0.5, (i + 0.5) / count).shape.slope))
            for one in self.in_sizes()
            for i in range(count)
        )


BUILT_IN_CATALOGUE = (
    # handling: parts that slide over each other or over a fixture; shallow, since deeper ones are seen without effort
    CatalogueEntry("scratch", DefectShape(kind="scratch", length=5.0, width=0.2, slope=math.radians(4.0))),
    # a knock from a rounded object: wide for its depth of 22 µm, without an edge, so that only a mirror shows it
    CatalogueEntry("dent", DefectShape(kind="dent", length=2.0, width=2.0, slope=math.radians(2.0))),
    # dust or a nodule under the plating, levelled by it to a gentle hill of 17 µm
    CatalogueEntry("bump", DefectShape(kind="bump", length=1.0, width=1.0, slope=math.radians(3.0))),
    # a gas pore or a corroded place that the plating did not close: small and steep
    CatalogueEntry("pit", DefectShape(kind="pit", length=0.3, width=0.3, slope=math.radians(20.0))),
    # plating that came off its base and lifted: a flat top of 20 µm with a wall around it
    CatalogueEntry("blister", DefectShape(kind="blister", length=1.5, width=1.5, slope=math.radians(6.0))),
    # a residue of bath or rinse: the shape is unharmed, the diffuse light is 30 % less
    CatalogueEntry("stain", DefectShape(kind="stain", length=2.0, width=1.5, R_d_factor=0.7)),
    # burnt or porous plating, or a wiped place: the mirror has become half as wide again
    CatalogueEntry("haze", DefectShape(kind="haze", length=3.0, width=3.0, sigma_factor=1.5)),
)
"""Terms as in ISO 8785:1998 (surface imperfections). The figures are those of a part of some centimetres, seen with
pixels of 0.05 to 0.1 mm: from well visible to just visible, none of them so coarse that any light shows it."""
