"""Penumbrae over squares of image samples: worked out at a few of them, and interpolated where they vary smoothly.

What a smooth piece of surface sees of a panel varies smoothly over it: over most of a penumbra, far from the body that
casts it, by a share of a per cent from one pixel to the next. A square of samples is worked out at 3 × 3 of them, and
the quadratic through these predicts the middles of its four quarters. Where these, worked out as well, agree with the
prediction, it serves for the whole square. Where they do not, or where the surface is not smooth, the quarters are
squares of their own, whose middles are known already; the smallest ones are worked out sample by sample.

What the functions share
------------------------
at: Surface point of each sample, −1 where a ray misses the part, shape (rows, columns)
corners: Rows and columns of the first samples of some squares, shape (q, 2)
side: Steps from sample to sample along the side of a square, which shares its border with its neighbours
coarse: What the coarse rays of each point show, shape (k,)
whole: Diffuse and specular light of the whole panel at each point, per unit of R_d and R_s, shape (k, 2)
visible: The same of what is seen of it, shape (k, 2)
"""

import math

import numpy as np

from lightopt.core.arrays import Bool, Float64, Int32, Int64, UInt8
from lightopt.core.kernels import kernel
from lightopt.core.vectors import dot, length, minus, vector_at
from lightopt.lights import half_diagonal
from lightopt.rendering._panel_quadrature import half_vector_cone
from lightopt.rendering._penumbra import ConvergedLight
from lightopt.rendering._surface import PointRows, SurfacePoint, point_at

SIDES = (16, 8, 4)  # of the squares, one after the other; of any smaller one all samples would be worked out

# a prediction may be off by 0.015 level + 0.015 % where it is tested: elsewhere in the square it may be off by more
LEVEL_TOLERANCE, RELATIVE_TOLERANCE = 0.015, 0.00015

# the whole panel's diffuse light may be off by this share where only the visible share of it is interpolated: faces
# show in it, and at a crease it is far from a quadratic
DIFFUSE_TOLERANCE = 0.5

# neighbouring samples of a smooth piece of surface: their normals turn by less than 8°, and the way from one to the
# other leaves the plane of either by less than this share of its length
SMOOTH_COSINE = math.cos(math.radians(8.0))
SMOOTH_RISE = 0.12

# specular light above this level is interpolated only if the lobe is wider than this share of the angle that half
# vectors of the panel span: a narrower one sees less of the panel, and shadows are sharper in it
GLOSSY_LEVEL = 0.01
LEAST_LOBE = 1.0 / 3.0
# so far from the peak, in that angle, the tail of GGX is as even as a Gaussian lobe of that width
LEAST_AWAY = 1.5

EDGE_SHARE = 1e-3  # a panel of which less than this is hidden, or seen, counts as wholly visible, or hidden

# what is known of a square before its neighbours are: 3 × 3 samples and the middles of its quarters, in quarters of it
_NODES = 9
_PLACES = np.array([(r, c) for r in (0, 2, 4) for c in (0, 2, 4)] + [(r, c) for r in (1, 3) for c in (1, 3)])


@kernel
def squares_with(at: Int32, pending: Bool, side: int) -> Int64:
    """The complete squares with a pending sample, as `corners`; `pending` is a flag of each point, shape (k,)."""
    rows, columns = (at.shape[0] - 1) // side, (at.shape[1] - 1) // side
    chosen = np.zeros((rows, columns), np.bool_)
    for y in range(rows * side + 1):
        for x in range(columns * side + 1):
            if at[y, x] >= 0 and pending[at[y, x]] and rows > 0 and columns > 0:
                # a sample on the border of two squares belongs to the second one, as far as there is one
                chosen[min(y // side, rows - 1), min(x // side, columns - 1)] = True
    corners = np.empty((np.count_nonzero(chosen), 2), np.int64)
    q = 0
    for row in range(rows):
        for column in range(columns):
            if chosen[row, column]:
                corners[q, 0], corners[q, 1] = row * side, column * side
                q += 1
    return corners


@kernel
def points_in(at: Int32, corners: Int64, side: int, count: int) -> Bool:
    """Which of the points, `count` of them, are seen in some squares."""
    found = np.zeros(count, np.bool_)
    for q in range(len(corners)):
        for y in range(corners[q, 0], corners[q, 0] + side + 1):
            for x in range(corners[q, 1], corners[q, 1] + side + 1):
                if at[y, x] >= 0:
                    found[at[y, x]] = True
    return found


@kernel
def nodes_of(at: Int32, corners: Int64, side: int, count: int) -> Bool:
    """Which of the points, `count` of them, are to be worked out in full squares."""
    found = np.zeros(count, np.bool_)
    for q in range(len(corners)):
        for place in range(len(_PLACES)):
            found[_node(at, corners, side, q, place)] = True
    return found


@kernel
def _node(at: Int32, corners: Int64, side: int, q: int, place: int) -> int:
    step = side // 4
    row, column = corners[q, 0] + step * _PLACES[place, 0], corners[q, 1] + step * _PLACES[place, 1]
    return int(at[row, column])


@kernel
def smooth_squares(
    rows: PointRows, at: Int32, corners: Int64, side: int, coarse: UInt8, whole: Float64, light: ConvergedLight
) -> Bool:
    """Squares of one smooth piece of surface that nothing speaks against before anything is worked out, shape (q,).

    Facets show nowhere in the light, no narrow lobe is near, and the coarse rays show nothing that those of the samples
    to be worked out do not.
    """
    points, frames, views, _, front = rows
    smooth = np.empty(len(corners), np.bool_)
    for q in range(len(corners)):
        shown = 0
        top, left = corners[q, 0], corners[q, 1]
        smooth[q] = True
        for y in range(top, top + side + 1):
            for x in range(left, left + side + 1):
                i = at[y, x]
                smooth[q] = (
                    i >= 0
                    and front[i]
                    and (x == left or _continuous(points, frames, i, at[y, x - 1]))
                    and (y == top or _continuous(points, frames, i, at[y - 1, x]))
                    and _smoothly_lit(point_at(points, frames, views, i), whole[i, 1], light)
                )
                if not smooth[q]:
                    break
                shown |= 1 << coarse[i]
            if not smooth[q]:
                break
        if smooth[q]:
            found = 0
            for place in range(len(_PLACES)):
                found |= 1 << coarse[_node(at, corners, side, q, place)]
            smooth[q] = shown == found
    return smooth


@kernel
def _smoothly_lit(point: SurfacePoint, specular: float, light: ConvergedLight) -> bool:
    panel = light.panel
    if light.specular_level * specular <= GLOSSY_LEVEL:
        return True
    half, spread = half_vector_cone(point, panel.centre, half_diagonal(panel))
    if light.lobe.ggx and length(minus(point.n, half)) >= LEAST_AWAY * spread:
        return True
    return 0.5 / light.lobe.inverse >= (LEAST_LOBE * spread) ** 2


@kernel
def _continuous(points: Float64, normals: Float64, i: int, j: int) -> bool:
    a, b = vector_at(normals, i), vector_at(normals, j)
    step = minus(vector_at(points, j), vector_at(points, i))
    rise = max(abs(dot(a, step)), abs(dot(b, step)))
    return dot(a, b) > SMOOTH_COSINE and rise < SMOOTH_RISE * length(step)


@kernel
def quadratic_weights(side: int) -> Float64:
    """Weights of the values at the start, middle and end of a side in the quadratic at each sample, (side + 1, 3)."""
    weights = np.empty((side + 1, 3))
    for k in range(side + 1):
        x = k / side
        weights[k, 0] = (2.0 * x - 1.0) * (x - 1.0)
        weights[k, 1] = 4.0 * x * (1.0 - x)
        weights[k, 2] = x * (2.0 * x - 1.0)
    return weights


@kernel
def _predicted(values: Float64, weights: Float64, y: int, x: int) -> float:
    total = 0.0
    for r in range(3):
        for c in range(3):
            total += weights[y, r] * weights[x, c] * values[3 * r + c]
    return total


@kernel
def interpolate(
    at: Int32,
    corners: Int64,
    side: int,
    light: ConvergedLight,
    whole: Float64,
    visible: Float64,
    done: Bool,
    crossed: Bool,
) -> None:
    """Interpolate the squares where that is as good as working them out; their samples are `done` then.

    The visible share of either term is interpolated where the quadratic serves for the light of the whole panel, too,
    at each sample: well for the specular light, roughly for the diffuse one.

    done: Which points need nothing more, shape (k,); all that are worked out in the squares are
    crossed: Which points the edge of a shadow crosses the panel of, shape (k,)
    """
    weights = quadratic_weights(side)
    levels = light.diffuse_level, light.specular_level
    panel, seen = np.empty((2, len(_PLACES))), np.empty((2, len(_PLACES)))
    step = side // 4
    for q in range(len(corners)):
        top, left = corners[q, 0], corners[q, 1]
        any_crossed = False
        for place in range(len(_PLACES)):
            i = _node(at, corners, side, q, place)
            any_crossed |= crossed[i]
            for term in range(2):
                panel[term, place], seen[term, place] = whole[i, term], visible[i, term]
        served = True
        for place in range(_NODES, len(_PLACES)):
            y, x = step * _PLACES[place, 0], step * _PLACES[place, 1]
            error = level = 0.0
            for term in range(2):
                light_there = panel[term, place] * _visible_share(panel[term], seen[term], weights, y, x)
                error += levels[term] * abs(light_there - seen[term, place])
                level += levels[term] * seen[term, place]
            served &= error <= LEVEL_TOLERANCE + RELATIVE_TOLERANCE * level
        for y in range(side + 1):
            if not served:
                break
            for x in range(side + 1):
                for term in range(2):
                    level = levels[term] * whole[at[top + y, left + x], term]
                    error = abs(levels[term] * _predicted(panel[term], weights, y, x) - level)
                    allowed = RELATIVE_TOLERANCE if term == 1 else DIFFUSE_TOLERANCE
                    served &= error <= LEVEL_TOLERANCE + allowed * level
        if not served:
            continue
        for y in range(side + 1):
            for x in range(side + 1):
                i = at[top + y, left + x]
                if not done[i]:
                    for term in range(2):
                        visible[i, term] = whole[i, term] * _visible_share(panel[term], seen[term], weights, y, x)
                    share = _visible_share(panel[0], seen[0], weights, y, x)
                    crossed[i] = any_crossed and EDGE_SHARE < share < 1.0 - EDGE_SHARE
                    done[i] = True


@kernel
def _visible_share(panel: Float64, seen: Float64, weights: Float64, y: int, x: int) -> float:
    # of the quadratics, not the quadratic of the shares: at the horizon, where the panel's light ends, there are none
    whole = _predicted(panel, weights, y, x)
    return min(max(_predicted(seen, weights, y, x) / whole, 0.0), 1.0) if whole > 0.0 else 0.0
