"""The light of a whole rectangle of a panel: the specular lobe integrated where it matters, at a cost free of σ.

The lobe's exponent δ²/(2σ²) is nearly a quadratic form over the panel. Its least value on the rectangle and its shape
there give a window outside which the lobe is negligible; a tensor Gauss–Legendre rule with just enough nodes for how
much the exponent varies integrates the exact expression inside the window. A narrow lobe has a small window, a wide one
varies little: neither needs many nodes.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel
from lightopt.rendering._panel import PanelNumbers, point_terms, terms_at

MAX_NODES = 48
"""Most Gauss–Legendre nodes along a side; only a view or a light that grazes the surface asks for as many."""

NEGLIGIBLE_EXPONENT = 45.0
"""A rectangle where the lobe is nowhere above e⁻⁴⁵ = 3e-20 of R_s gets no specular light."""

WINDOW_EXPONENT = 14.0
"""The window ends where the lobe has fallen to e⁻¹⁴ = 8e-7 of its greatest value on the rectangle."""

WINDOW_MARGIN = 1.15
"""The window is widened by this, since the exponent is only nearly quadratic."""

_GRAZING = 1e-3
_LINEARISATIONS = 3
_BOX_STEPS = 12


@cache
def gauss_legendre_table() -> tuple[Float64, Float64]:
    """Nodes and weights on [0, 1] of the Gauss–Legendre rules; row n has the rule of n nodes.

    Two arrays of shape (MAX_NODES + 1, MAX_NODES), worked out once.
    """
    nodes = np.zeros((MAX_NODES + 1, MAX_NODES))
    weights = np.zeros((MAX_NODES + 1, MAX_NODES))
    for n in range(1, MAX_NODES + 1):
        x, w = np.polynomial.legendre.leggauss(n)
        nodes[n, :n] = 0.5 * (x + 1.0)
        weights[n, :n] = 0.5 * w
    for table in (nodes, weights):
        table.flags.writeable = False
    return nodes, weights


@kernel
def rectangle_diffuse(
    p: Float64,
    n: Float64,
    v: Float64,
    panel: PanelNumbers,
    s0: float,
    s1: float,
    t0: float,
    t1: float,
    count: int,
    nodes: Float64,
    weights: Float64,
) -> float:
    """Diffuse light, per unit of R_d, of the rectangle [s0, s1] × [t0, t1] of a panel of total weight 1.

    p, n, v: Surface point [mm], unit normal, unit view direction, shape (3,)
    count: Gauss–Legendre nodes along each side
    """
    level, rise_s, rise_t, lowest = _height_above_horizon(p, n, panel, s0, s1, t0, t1)
    first, last = _broken_rows(level, rise_s, rise_t, lowest, s0, s1, t0, t1)
    total = 0.0
    for low, high in ((t0, first), (first, last), (last, t1)):
        if low >= high:
            continue
        part = 0.0
        for i in range(count):
            t = low + (high - low) * nodes[count, i]
            r0, r1 = _row_above_horizon(level + rise_t * t, rise_s, lowest, s0, s1)
            if r0 >= r1:
                continue
            row = 0.0
            for j in range(count):
                s = r0 + (r1 - r0) * nodes[count, j]
                # a view from below (n_dot_v = 0) leaves out the specular term
                d, _ = terms_at(
                    p,
                    n,
                    v,
                    0.0,
                    panel.centre_x + s * panel.across_x + t * panel.along_x,
                    panel.centre_y + s * panel.across_y + t * panel.along_y,
                    panel.centre_z + s * panel.across_z + t * panel.along_z,
                    panel,
                    0.0,
                )
                row += weights[count, j] * d
            part += weights[count, i] * (r1 - r0) * row
        total += part * (high - low)
    return total


@kernel
def _height_above_horizon(
    p: Float64, n: Float64, panel: PanelNumbers, s0: float, s1: float, t0: float, t1: float
) -> tuple[float, float, float, float]:
    # height of the panel above the surface's tangent plane: level + rise_s·s + rise_t·t; and the least on a rectangle
    level = n[0] * (panel.centre_x - p[0]) + n[1] * (panel.centre_y - p[1]) + n[2] * (panel.centre_z - p[2])
    rise_s = n[0] * panel.across_x + n[1] * panel.across_y + n[2] * panel.across_z
    rise_t = n[0] * panel.along_x + n[1] * panel.along_y + n[2] * panel.along_z
    lowest = level + min(rise_s * s0, rise_s * s1) + min(rise_t * t0, rise_t * t1)
    return level, rise_s, rise_t, lowest


@kernel
def _broken_rows(
    level: float, rise_s: float, rise_t: float, lowest: float, s0: float, s1: float, t0: float, t1: float
) -> tuple[float, float]:
    # N·L > 0 is a half-plane of (s, t) with a break of the integrand along its border: rows of nodes end there, and are
    # taken apart where it meets the rectangle's sides, between these two t
    if lowest > 0.0 or rise_t == 0.0:
        return t1, t1
    at_start, at_end = -(level + rise_s * s0) / rise_t, -(level + rise_s * s1) / rise_t
    return min(max(min(at_start, at_end), t0), t1), min(max(max(at_start, at_end), t0), t1)


@kernel
def _row_above_horizon(
    height: float, rise_s: float, lowest: float, s0: float, s1: float
) -> tuple[float, float]:
    # the part of a row of the rectangle that is above the horizon; empty where none is
    if lowest > 0.0:
        return s0, s1
    if rise_s > 0.0:
        return max(s0, -height / rise_s), s1
    if rise_s < 0.0:
        return s0, min(s1, -height / rise_s)
    return (s0, s1) if height > 0.0 else (s0, s0)


@kernel
def rectangle_specular(
    p: Float64,
    n: Float64,
    v: Float64,
    n_dot_v: float,
    panel: PanelNumbers,
    s0: float,
    s1: float,
    t0: float,
    t1: float,
    inverse_two_sigma_squared: float,
    panel_nodes: int,
    nodes: Float64,
    weights: Float64,
) -> float:
    """Specular light, per unit of R_s, of the rectangle [s0, s1] × [t0, t1] of a panel of total weight 1.

    Parameters as in :func:`rectangle_diffuse`; `n_dot_v` is cosθ_o, `inverse_two_sigma_squared` 1/(2σ²) [rad⁻²], and
    `panel_nodes` the nodes a side that the whole panel needs for its fall-off and emission.
    """
    if n_dot_v <= 0.0:
        return 0.0
    s, t = mirror_point(p, n, v, n_dot_v, panel)
    s, t = min(max(s, s0), s1), min(max(t, t0), t1)
    hx = hy = jxs = jxt = jys = jyt = 0.0
    a = b = c = 0.0
    least = 0.0
    for round_ in range(_LINEARISATIONS):
        hx, hy, jxs, jxt, jys, jyt = _half_vector_map(p, n, v, panel, s, t)
        # exponent ≈ k·|h + J·Δx|²: its matrix and gradient, per axis of the panel
        k = inverse_two_sigma_squared
        a = k * (jxs * jxs + jys * jys)
        b = k * (jxs * jxt + jys * jyt)
        c = k * (jxt * jxt + jyt * jyt)
        gs, gt = k * (jxs * hx + jys * hy), k * (jxt * hx + jyt * hy)
        least = k * (hx * hx + hy * hy)
        if round_ == _LINEARISATIONS - 1 or least > 50.0 * NEGLIGIBLE_EXPONENT:
            break
        ns, nt = _least_in_box(a, b, c, gs - a * s - b * t, gt - b * s - c * t, s, t, s0, s1, t0, t1)
        if abs(ns - s) < 1e-6 and abs(nt - t) < 1e-6:
            break
        s, t = ns, nt
    if least > NEGLIGIBLE_EXPONENT:
        return 0.0
    determinant = a * c - b * b
    if determinant <= 1e-12 * a * c or a <= 0.0 or c <= 0.0:
        ws0, ws1, wt0, wt1 = s0, s1, t0, t1
    else:
        gs, gt = (
            inverse_two_sigma_squared * (jxs * hx + jys * hy),
            inverse_two_sigma_squared * (jxt * hx + jyt * hy),
        )
        centre_s = s - (c * gs - b * gt) / determinant
        centre_t = t - (a * gt - b * gs) / determinant
        reach = WINDOW_MARGIN * WINDOW_MARGIN * (least + WINDOW_EXPONENT) / determinant
        half_s, half_t = math.sqrt(reach * c), math.sqrt(reach * a)
        ws0, ws1 = max(s0, centre_s - half_s), min(s1, centre_s + half_s)
        wt0, wt1 = max(t0, centre_t - half_t), min(t1, centre_t + half_t)
        if ws0 >= ws1 or wt0 >= wt1:
            return 0.0
    gs = inverse_two_sigma_squared * (jxs * hx + jys * hy)
    gt = inverse_two_sigma_squared * (jxt * hx + jyt * hy)
    count_s = max(_node_count(a, gs, ws0 - s, ws1 - s), math.ceil(panel_nodes * (ws1 - ws0)) + 1)
    count_t = max(_node_count(c, gt, wt0 - t, wt1 - t), math.ceil(panel_nodes * (wt1 - wt0)) + 1)
    level, rise_s, rise_t, lowest = _height_above_horizon(p, n, panel, ws0, ws1, wt0, wt1)
    first, last = _broken_rows(level, rise_s, rise_t, lowest, ws0, ws1, wt0, wt1)
    total = 0.0
    for low, high in ((wt0, first), (first, last), (last, wt1)):
        if low >= high:
            continue
        part = 0.0
        for i in range(count_t):
            t = low + (high - low) * nodes[count_t, i]
            r0, r1 = _row_above_horizon(level + rise_t * t, rise_s, lowest, ws0, ws1)
            if r0 >= r1:
                continue
            part += (
                weights[count_t, i]
                * (r1 - r0)
                * _specular_row(
                    p, n, v, n_dot_v, panel, r0, r1, t, count_s, inverse_two_sigma_squared, nodes, weights
                )
            )
        total += part * (high - low)
    return total


@kernel
def _specular_row(
    p: Float64,
    n: Float64,
    v: Float64,
    n_dot_v: float,
    panel: PanelNumbers,
    s0: float,
    s1: float,
    t: float,
    count: int,
    inverse_two_sigma_squared: float,
    nodes: Float64,
    weights: Float64,
) -> float:
    # mean of the specular light along a row of the panel
    px, py, pz = p[0], p[1], p[2]
    nx, ny, nz = n[0], n[1], n[2]
    vx, vy, vz = v[0], v[1], v[2]
    row = 0.0
    for j in range(count):
        s = s0 + (s1 - s0) * nodes[count, j]
        _, value = point_terms(
            px,
            py,
            pz,
            nx,
            ny,
            nz,
            vx,
            vy,
            vz,
            n_dot_v,
            panel.centre_x + s * panel.across_x + t * panel.along_x,
            panel.centre_y + s * panel.across_y + t * panel.along_y,
            panel.centre_z + s * panel.across_z + t * panel.along_z,
            panel,
            inverse_two_sigma_squared,
        )
        row += weights[count, j] * value
    return row


@kernel
def out_of_reach(
    p: Float64, n: Float64, v: Float64, panel: PanelNumbers, inverse_two_sigma_squared: float
) -> bool:
    """Whether the lobe is surely negligible all over the panel: a quick test that looks at its centre alone.

    While L turns by α, H turns by no more than α / (2·cos(half the angle between L and V)).
    """
    lx, ly, lz = panel.centre_x - p[0], panel.centre_y - p[1], panel.centre_z - p[2]
    r = math.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx / r, ly / r, lz / r
    hx, hy, hz = lx + v[0], ly + v[1], lz + v[2]
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    half_diagonal = 0.5 * math.sqrt(
        panel.across_x**2
        + panel.across_y**2
        + panel.across_z**2
        + panel.along_x**2
        + panel.along_y**2
        + panel.along_z**2
    )
    if half_diagonal >= 0.9 * r or length < 1e-3:
        return False
    turn = math.asin(half_diagonal / r)
    half_angle = math.acos(min(1.0, 0.5 * length)) + 0.5 * turn
    cosine = math.cos(half_angle)
    if cosine < 0.1:
        return False
    dx, dy, dz = n[0] - hx / length, n[1] - hy / length, n[2] - hz / length
    # the chord is never more than the angle
    nearest = math.sqrt(dx * dx + dy * dy + dz * dz) - turn / (2.0 * cosine)
    return nearest > 0.0 and nearest * nearest * inverse_two_sigma_squared > NEGLIGIBLE_EXPONENT


@kernel
def mirror_point(
    p: Float64, n: Float64, v: Float64, n_dot_v: float, panel: PanelNumbers
) -> tuple[float, float]:
    """Where the mirrored view meets the panel's plane, (s, t) in the panel's sides; its centre where it never does."""
    mx, my, mz = (2.0 * n_dot_v * n[0] - v[0], 2.0 * n_dot_v * n[1] - v[1], 2.0 * n_dot_v * n[2] - v[2])
    cx, cy, cz = panel.centre_x - p[0], panel.centre_y - p[1], panel.centre_z - p[2]
    towards = mx * panel.outward_x + my * panel.outward_y + mz * panel.outward_z
    ahead = cx * panel.outward_x + cy * panel.outward_y + cz * panel.outward_z
    if abs(towards) < _GRAZING or ahead / towards <= 0.0:
        return 0.0, 0.0
    reach = ahead / towards
    x, y, z = reach * mx - cx, reach * my - cy, reach * mz - cz
    ux, uy, uz = panel.across_x, panel.across_y, panel.across_z
    wx, wy, wz = panel.along_x, panel.along_y, panel.along_z
    return (
        (x * ux + y * uy + z * uz) / (ux * ux + uy * uy + uz * uz),
        (x * wx + y * wy + z * wz) / (wx * wx + wy * wy + wz * wz),
    )


@kernel
def _half_vector_map(
    p: Float64, n: Float64, v: Float64, panel: PanelNumbers, s: float, t: float
) -> tuple[float, float, float, float, float, float]:
    # components of H in the tangent plane of N at panel coordinates (s, t), and their derivatives along s and t,
    # scaled so that |h| is the angle δ and not its sine
    lx = panel.centre_x + s * panel.across_x + t * panel.along_x - p[0]
    ly = panel.centre_y + s * panel.across_y + t * panel.along_y - p[1]
    lz = panel.centre_z + s * panel.across_z + t * panel.along_z - p[2]
    r = math.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx / r, ly / r, lz / r
    hx, hy, hz = lx + v[0], ly + v[1], lz + v[2]
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hy, hz = hx / length, hy / length, hz / length
    # any two unit vectors perpendicular to N and to each other
    if abs(n[2]) < 0.9:
        size = math.sqrt(n[0] * n[0] + n[1] * n[1])
        ax, ay, az = -n[1] / size, n[0] / size, 0.0
    else:
        size = math.sqrt(n[1] * n[1] + n[2] * n[2])
        ax, ay, az = 0.0, -n[2] / size, n[1] / size
    bx, by, bz = n[1] * az - n[2] * ay, n[2] * ax - n[0] * az, n[0] * ay - n[1] * ax
    ha, hb = hx * ax + hy * ay + hz * az, hx * bx + hy * by + hz * bz
    sine = math.sqrt(ha * ha + hb * hb)
    scale = 1.0
    if sine > 1e-6:
        scale = math.atan2(sine, hx * n[0] + hy * n[1] + hz * n[2]) / sine
    jas, jbs = _tangent_step(
        panel.across_x,
        panel.across_y,
        panel.across_z,
        r,
        lx,
        ly,
        lz,
        length,
        hx,
        hy,
        hz,
        ax,
        ay,
        az,
        bx,
        by,
        bz,
    )
    jat, jbt = _tangent_step(
        panel.along_x, panel.along_y, panel.along_z, r, lx, ly, lz, length, hx, hy, hz, ax, ay, az, bx, by, bz
    )
    return scale * ha, scale * hb, scale * jas, scale * jat, scale * jbs, scale * jbt


@kernel
def _tangent_step(
    sx: float,
    sy: float,
    sz: float,
    r: float,
    lx: float,
    ly: float,
    lz: float,
    length: float,
    hx: float,
    hy: float,
    hz: float,
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
) -> tuple[float, float]:
    # derivative of the unit half vector when the light moves along one side of the panel
    along = sx * lx + sy * ly + sz * lz
    dx, dy, dz = (sx - along * lx) / r, (sy - along * ly) / r, (sz - along * lz) / r
    along = dx * hx + dy * hy + dz * hz
    dx, dy, dz = (dx - along * hx) / length, (dy - along * hy) / length, (dz - along * hz) / length
    return dx * ax + dy * ay + dz * az, dx * bx + dy * by + dz * bz


@kernel
def _least_in_box(
    a: float,
    b: float,
    c: float,
    gs: float,
    gt: float,
    s: float,
    t: float,
    s0: float,
    s1: float,
    t0: float,
    t1: float,
) -> tuple[float, float]:
    # least value of ½(a·s² + 2b·s·t + c·t²) + gs·s + gt·t on a box, one coordinate after the other: it is convex
    if a <= 0.0 or c <= 0.0:
        return s, t
    for _ in range(_BOX_STEPS):
        s = min(max(-(gs + b * t) / a, s0), s1)
        t = min(max(-(gt + b * s) / c, t0), t1)
    return s, t


@kernel
def _node_count(curvature: float, gradient: float, low: float, high: float) -> int:
    # nodes that integrate exp(−q), q = curvature·x² + 2·gradient·x on [low, high], to 2e-4 of the integral: found by
    # trying; one more, since the exponent is only nearly quadratic
    at_low = curvature * low * low + 2.0 * gradient * low
    at_high = curvature * high * high + 2.0 * gradient * high
    spread = max(at_low, at_high, 0.0)
    width = (high - low) * math.sqrt(2.0 * curvature)
    if spread < 0.05:
        count = 2
    elif spread < 0.2:
        count = 3
    elif spread < 1.0:
        count = 4
    elif spread < 6.0:
        count = 5
    else:
        count = 6
    if width > 2.0:
        count = max(count, math.ceil(3.0 + 0.9 * width))
    return min(count + 1, MAX_NODES)
