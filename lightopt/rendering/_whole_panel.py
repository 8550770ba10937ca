"""The light of a whole panel, where nothing is in the way."""

import math

import numpy as np

from lightopt.core.arrays import Float64, Int32
from lightopt.core.kernels import kernel
from lightopt.core.vectors import column_at, dot, minus, scaled
from lightopt.lights import attenuated, panel_point
from lightopt.optics import lambert
from lightopt.rendering._panel_quadrature import (
    NODES,
    WEIGHTS,
    WHOLE_PANEL,
    out_of_reach,
    rectangle_diffuse,
    rectangle_specular,
)
from lightopt.rendering._penumbra_cells import ConvergedLight

_AT_ONCE = 1024  # points whose terms are in the processor's nearest cache together


@kernel
def whole_panel(
    points: Float64, normals: Float64, views: Float64, index: Int32, light: ConvergedLight, terms: Float64
) -> None:
    """Set the diffuse and specular light, per unit of R_d and R_s, of a panel of weight 1 at some points.

    points, normals, views: Surface points [mm], unit normals and unit view directions, part frame, shape (k, 3)
    index: Of the points, shape (j,)
    terms: Shape (k, 2)
    """
    panel, inverse, nodes = light.panel, light.inverse_two_sigma_squared, light.nodes
    # the processor works on several points at once in loops without branches over numbers that lie side by side
    p, n, v = np.empty((3, _AT_ONCE)), np.empty((3, _AT_ONCE)), np.empty((3, _AT_ONCE))
    diffuse, above, near = np.empty(_AT_ONCE), np.empty(_AT_ONCE, np.bool_), np.empty(_AT_ONCE, np.bool_)
    for first in range(0, len(index), _AT_ONCE):
        count = min(_AT_ONCE, len(index) - first)
        for j in range(count):
            i = index[first + j]
            for axis in range(3):
                p[axis, j], n[axis, j], v[axis, j] = points[i, axis], normals[i, axis], views[i, axis]
        for j in range(count):
            normal = column_at(n, j)
            reach = 0.5 * (abs(dot(normal, panel.across)) + abs(dot(normal, panel.along)))
            above[j] = dot(normal, minus(panel.centre, column_at(p, j))) > reach
            near[j] = not out_of_reach(column_at(p, j), normal, column_at(v, j), panel, inverse)
            diffuse[j] = 0.0
        for a in range(nodes):
            for b in range(nodes):
                q = panel_point(panel, NODES[nodes, b] - 0.5, NODES[nodes, a] - 0.5)
                weight = WEIGHTS[nodes, a] * WEIGHTS[nodes, b]
                for j in range(count):
                    towards = minus(q, column_at(p, j))
                    r2 = dot(towards, towards)
                    towards = scaled(towards, 1.0 / math.sqrt(r2))
                    term = weight * lambert(dot(column_at(n, j), towards))
                    diffuse[j] += attenuated(term, panel, r2, dot(panel.outward, towards))
        for j in range(count):
            i = index[first + j]
            point, normal, view = column_at(p, j), column_at(n, j), column_at(v, j)
            if not above[j]:
                diffuse[j] = rectangle_diffuse(point, normal, panel, WHOLE_PANEL, nodes)
            terms[i, 0], terms[i, 1] = diffuse[j], 0.0
            if near[j]:
                terms[i, 1] = rectangle_specular(
                    point, normal, view, dot(normal, view), panel, WHOLE_PANEL, inverse, nodes
                )
