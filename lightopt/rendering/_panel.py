"""A panel's numbers as the kernels want them, and the light of one point of it."""

from __future__ import annotations

import math
from typing import NamedTuple

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel
from lightopt.optics import MAX_LOBE_EXPONENT, lambert, torrance_sparrow
from lightopt.scene import PanelLight


class PanelNumbers(NamedTuple):
    """A panel in the part's frame; a point of it is ``centre + s·across + t·along`` with s, t in [−½, ½].

    ``across`` and ``along`` have the panel's sides as lengths [mm]; ``distance`` is that of the panel's centre to the
    origin of the world [mm]. Numbers and not arrays, since counting references to arrays costs the kernels more than
    the arithmetic.
    """

    centre_x: float
    centre_y: float
    centre_z: float
    across_x: float
    across_y: float
    across_z: float
    along_x: float
    along_y: float
    along_z: float
    outward_x: float
    outward_y: float
    outward_z: float
    distance: float
    inverse_square: bool
    emission_exponent: float


def panel_numbers(light: PanelLight) -> PanelNumbers:
    """The numbers of a panel, in the frame that its vectors are given in."""
    centre, outward = light.centre.tolist(), light.outward.tolist()
    across, along = (light.size[0] * light.across).tolist(), (light.size[1] * light.along).tolist()
    return PanelNumbers(
        centre_x=centre[0],
        centre_y=centre[1],
        centre_z=centre[2],
        across_x=across[0],
        across_y=across[1],
        across_z=across[2],
        along_x=along[0],
        along_y=along[1],
        along_z=along[2],
        outward_x=outward[0],
        outward_y=outward[1],
        outward_z=outward[2],
        distance=float(light.distance),
        inverse_square=light.inverse_square,
        emission_exponent=float(light.emission_exponent),
    )


@kernel
def point_terms(
    px: float,
    py: float,
    pz: float,
    nx: float,
    ny: float,
    nz: float,
    vx: float,
    vy: float,
    vz: float,
    n_dot_v: float,
    qx: float,
    qy: float,
    qz: float,
    panel: PanelNumbers,
    inverse_two_sigma_squared: float,
) -> tuple[float, float]:
    """Diffuse and specular terms, per unit of R_d and R_s, of one point light of weight 1 (paper, equations 2 and 3).

    px, py, pz: Surface point [mm]
    nx, ny, nz: Its unit normal
    vx, vy, vz: Unit view direction
    n_dot_v: cosθ_o
    qx, qy, qz: The point light [mm]
    panel: The panel that it belongs to, for fall-off and emission
    inverse_two_sigma_squared: 1/(2σ²) [rad⁻²]
    """
    lx, ly, lz = qx - px, qy - py, qz - pz
    r2 = lx * lx + ly * ly + lz * lz
    inverse = 1.0 / math.sqrt(r2)
    lx, ly, lz = lx * inverse, ly * inverse, lz * inverse
    n_dot_l = nx * lx + ny * ly + nz * lz
    if n_dot_l <= 0.0:
        return 0.0, 0.0
    weight = 1.0
    if panel.inverse_square:
        weight = panel.distance * panel.distance / r2
    if panel.emission_exponent > 0.0:
        cosine = panel.outward_x * lx + panel.outward_y * ly + panel.outward_z * lz
        weight *= max(0.0, cosine) ** panel.emission_exponent
    diffuse = weight * lambert(n_dot_l)
    if n_dot_v <= 0.0:
        return diffuse, 0.0
    hx, hy, hz = lx + vx, ly + vy, lz + vz
    length_squared = hx * hx + hy * hy + hz * hz
    # far from the lobe, where most pixels of a glossy part are, not even the square root is needed
    n_dot_h = nx * hx + ny * hy + nz * hz
    least_cosine = 1.0 - 0.5 * MAX_LOBE_EXPONENT / inverse_two_sigma_squared
    if least_cosine > 0.0 and (
        n_dot_h <= 0.0 or n_dot_h * n_dot_h < least_cosine * least_cosine * length_squared
    ):
        return diffuse, 0.0
    inverse = 1.0 / math.sqrt(length_squared)
    dx, dy, dz = nx - hx * inverse, ny - hy * inverse, nz - hz * inverse
    chord_squared = dx * dx + dy * dy + dz * dz
    return diffuse, weight * torrance_sparrow(chord_squared, n_dot_v, inverse_two_sigma_squared)


@kernel
def terms_at(
    p: Float64,
    n: Float64,
    v: Float64,
    n_dot_v: float,
    qx: float,
    qy: float,
    qz: float,
    panel: PanelNumbers,
    inverse_two_sigma_squared: float,
) -> tuple[float, float]:
    """:func:`point_terms` of a surface point, its normal and view direction as arrays of shape (3,).

    For loops over the points of one panel, which have their rows in hand anyway. ``n_dot_v = 0`` leaves the specular
    term out.
    """
    return point_terms(
        p[0],
        p[1],
        p[2],
        n[0],
        n[1],
        n[2],
        v[0],
        v[1],
        v[2],
        n_dot_v,
        qx,
        qy,
        qz,
        panel,
        inverse_two_sigma_squared,
    )
