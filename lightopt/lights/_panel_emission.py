"""The panel light in kernels: the places of its points, their fall-off and their emission.

A light kind is described by such functions alone; kernels that add up its light know no more of it.
"""

import math
from typing import NamedTuple

from lightopt.core.kernels import kernel
from lightopt.core.vectors import Vector
from lightopt.lights._panel import PanelLight


class PanelNumbers(NamedTuple):
    """A panel in the part's frame; a point of it is ``centre + s·across + t·along`` with s, t in [−½, ½]."""

    centre: Vector
    across: Vector  # as long as the panel's sides [mm]
    along: Vector  # as long as the panel's sides [mm]
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
