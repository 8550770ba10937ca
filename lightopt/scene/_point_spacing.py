"""Whether a panel's point lights are close enough together for the lobe that looks at them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.config import MOST_POINTS
from lightopt.core.arrays import Float64
from lightopt.lights import PanelLight
from lightopt.optics import Reflectance

COARSE_SHARE = 0.1
"""A saturated area that is off by more than this share causes a warning."""

# The area is compared where the highlight is saturated, from this share of its brightest level: the paper's knob is
# overexposed about 50 times at its highlight's peak. Anything from 0.005 to 0.2 gives nearly the same errors.
SATURATION_SHARE = 0.02

_STEPS_PER_SIGMA = 16
_LARGEST_GAP = 60.0
_REACH = 8.0


@dataclass(frozen=True, kw_only=True)
class PointSpacing:
    """How a panel's grid of point lights looks to a specular lobe."""

    points: int  # m = k² point lights
    spacing: float  # largest distance between neighbouring points [mm]; the panel's longer side for m = 1
    lobe: float  # 2·distance·σ: how wide a part of the panel the lobe takes in, one standard deviation [mm]
    area_error: float  # saturated area of a highlight relative to that of the continuous panel, minus 1
    enough: int  # the m with which the area is within about 1 %: spacing no more than half the lobe's width

    @property
    def separate(self) -> bool:
        """Whether the highlight falls apart into spots: two Gaussians are two peaks from 2 standard deviations on."""
        return self.points > 1 and self.spacing > 2.0 * self.lobe

    def text_of(self, light: PanelLight, reflectance: Reflectance) -> str:
        """The spacing of a panel's points and the width of a lobe, in words."""
        points = "1 point stands for" if self.points == 1 else f"{self.points} points stand apart by"
        lobe = f"the lobe of {reflectance.width_text} takes in {self.lobe:.3g} mm (2·distance·σ)"
        return f"{light.name}: the panel's {points} {self.spacing:.3g} mm, {lobe}"


def point_spacing(light: PanelLight, sigma: float) -> PointSpacing | None:
    """How coarse a panel's point lights are for a lobe of width σ; None for the converged panel.

    On a curved surface the mirrored view sweeps across the panel as the normal turns: by 2·distance·Δα [mm] for a
    normal that turns by Δα [rad], so that in the panel's plane the lobe is a Gaussian of standard deviation s =
    2·distance·σ. A highlight is then that Gaussian summed over the grid, or integrated over the panel, and its
    saturated area is computed from both. This leaves out that an oblique view narrows the lobe across the plane of
    incidence, by the cosine of the angle of incidence.

    sigma: Width of the lobe [rad]
    """
    if light.points == "auto":
        return None
    k = math.isqrt(light.points)
    lobe = 2.0 * light.distance * sigma
    rule = max(1, math.ceil(2.0 * max(light.size) / lobe))
    # gaps beyond this leave nothing of the area, whatever they are exactly
    unit = max(lobe, max(light.size) / k / _LARGEST_GAP)
    axes = [_profiles(side / unit, k) for side in light.size]
    threshold = SATURATION_SHARE * axes[0][1][0] * axes[1][1][0]
    areas: list[float] = []
    for across, along in zip(*axes, strict=True):  # of the grid and of the whole panel
        # number of cells (i, j) with across[i]·along[j] ≥ threshold
        ascending = np.sort(along)
        needed = threshold / np.maximum(across, 1e-300)
        areas.append(float((len(ascending) - np.searchsorted(ascending, needed)).sum()))
    return PointSpacing(
        points=light.points,
        spacing=max(light.size) / k,
        lobe=lobe,
        area_error=areas[0] / areas[1] - 1.0,
        enough=rule * rule,
    )


def coarse_points(light: PanelLight, reflectance: Reflectance) -> str | None:
    """A warning where a panel's points are too few for the middle of a lobe, None where they are enough."""
    found = point_spacing(light, reflectance.sigma)
    if reflectance.R_s == 0.0 or found is None or abs(found.area_error) <= COARSE_SHARE:
        return None
    size = "small" if found.area_error < 0 else "large"
    error = f"overexposed areas about {100.0 * abs(found.area_error):.0f} % too {size}"
    if found.separate:
        error = "separate spots instead of one highlight, whose levels and areas are not the panel's"
    return f"{found.text_of(light, reflectance)}: {error}. {points_advice(light, found.enough)}"


def like_panels(lights: Sequence[PanelLight]) -> tuple[tuple[int, ...], ...]:
    """Panels that a lobe sees alike (points, size, distance, normalisation), as groups of their indices."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for index, light in enumerate(lights):
        groups.setdefault((light.points, light.size, light.distance, light.normalisation), []).append(index)
    return tuple(tuple(indices) for indices in groups.values())


def coarse_warnings(lights: Sequence[PanelLight], reflectance: Reflectance) -> tuple[str, ...]:
    """:func:`coarse_points` of several panels, those alike in one message."""
    grouped = (
        replace(lights[indices[0]], name=", ".join(lights[i].name for i in indices)) for indices in like_panels(lights)
    )
    return tuple(text for light in grouped if (text := coarse_points(light, reflectance)) is not None)


def points_advice(light: PanelLight, enough: int) -> str:
    """What to write in the rig file instead of too few points; `enough` as in :class:`PointSpacing`."""
    auto = "Use points: auto" + (" with normalisation: mean" if light.normalisation == "sum" else "")
    return auto if enough > MOST_POINTS else f"{auto}, or points: {enough} for an error of about 1 %"


def _profiles(side: float, k: int) -> tuple[Float64, Float64]:
    # mean of the lobe over k points and over the whole side, from the panel's middle outwards; lengths in lobes
    half = 0.5 * side
    x = (np.arange(math.ceil((half + _REACH) * _STEPS_PER_SIGMA)) + 0.5) / _STEPS_PER_SIGMA
    points = ((np.arange(k) + 0.5) / k - 0.5) * side
    grid = np.zeros(len(x))
    for point in points:
        first, last = np.searchsorted(x, (point - _REACH, point + _REACH))
        grid[first:last] += np.exp(-0.5 * (x[first:last] - point) ** 2)
    root = math.sqrt(0.5)
    whole = np.array([math.erf((e + half) * root) - math.erf((e - half) * root) for e in x])
    return grid / k, whole * math.sqrt(0.5 * math.pi) / side
