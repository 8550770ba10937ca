"""What surface points see of a rectangle past a mesh, from the mesh's silhouettes and not from rays.

Seen from a point, as many triangles lie before one place of a rectangle as before another one, but for the edges of
triangles that are crossed on the way between them. Where the two triangles of an edge lie on both sides of it, nothing
changes; the edges with both on the same side make up the silhouette. So some dozen edges tell how many triangles lie
before any place, if one ray tells it for one place (Laine et al. 2005, doi:10.1145/1186822.1073327). Triangles count
one by one: the mesh may be open, and its faces may disagree in direction.

Edges are held in a hierarchy of boxes with cones of their triangles' normals: a box is left out where it lies beside
all ways to the rectangle, or where all its triangles show the point the same side. Points near each other have nearly
the same edges: those that may be silhouettes for any of a group of points are found together.

What the functions share
------------------------
vertices: In the mesh's radii from its centre, float32 as Embree has them, shape (n, 3)
faces: With one vertex for each place, shape (m, 3)
planes: Unit normal of each face, zero if it has no area, and its plane's distance from the centre, shape (m, 4)
corners: The corners 3·face + corner that begin an edge, one in each of its triangles; −1 where it has one; shape (e, 2)
nodes: The nodes of all levels, the root first, and of each its children side by side: centre and half sides of their
    boxes, axis of the cone of normals, sine of its half-angle; shape (b, 10, 8)
leaves: Of each leaf the planes of its edges' triangles, (normal, distance from the centre) of the first and of the
    second one, which is turned over where it runs along the edge the other way; zeros where there is none; (l, 8, 8)
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lightopt.core.arrays import Bool, Float32, Float64, Int32, Int64
from lightopt.core.kernels import kernel
from lightopt.core.vectors import Vector, column_at, dot, minus, plus, scaled
from lightopt.geometry._topology import corners_by_edge, next_corner

_BRANCHES = 8  # edges of a leaf, and children of any other node
_NO_CONE = 2.0  # in place of that sine: the triangles may show any side
_CONE_MARGIN = 1e-3  # of sines: cosines of float32 normals are good to 1e-7, small angles from these to 5e-4
_BOX_MARGIN = 1e-6  # of boxes, in radii of the mesh
_SLACK = np.float32(1e-5)  # of places in float32, per unit of the point's height above the rectangle
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)

MOST_LEAVES = 1024  # of a search: of more, rays take less time
_GROUP, _GROUP_SIDE = 32, 0.02  # most points of a group, and the longest side of the box around them [radii]
_ROWS = 16  # rows of the rectangle, whose edges are kept together
_NEAREST = 1e-9  # edges nearer to a point than this share of its distance from the rectangle are cut off there


class Silhouettes(NamedTuple):
    """Edges between k points and a rectangle, projected onto it from each of them.

    Places on the rectangle are (s, t), each from 0 to 1.
    """

    # rows of point i: the edges of row j are those from first[i, j] up to first[i, j + 1]; after the rows come the
    # edges that cross the rectangle's first side, s = 0; shape (k, _ROWS + 2)
    first: Int64
    edges: Float64  # s and t of both ends, and the triangles on its left less those on its right, shape (m, 5)
    found: Bool  # False where they are too many, and where the point is behind the rectangle, shape (k,)


class _Tree(NamedTuple):
    vertices: Float32
    faces: Int32
    corners: Int32
    nodes: Float32
    leaves: Float32
    begins: Int64  # number of the first node of each level, and of the first leaf after them


class _View(NamedTuple):
    """Coordinates of a rectangle: (s, t) and the height above it are the products with the axes, less the origin."""

    across: Vector
    along: Vector
    upward: Vector  # to the mesh's side of it
    origin: Vector
    hand: float  # 1 if the axes are right-handed, −1 if not


class _Box(NamedTuple):
    """Around one or several points, in the mesh's frame and in coordinates of a view."""

    middle: Vector
    half: Vector
    place: Vector
    half_place: Vector


class SilhouetteEdges:
    """A hierarchy of the edges of a mesh."""

    def __init__(self, vertices: Float32, faces: Int32, planes: Float32) -> None:
        corners = _edge_records(faces, *corners_by_edge(faces))
        corners = corners[np.argsort(_curve_keys(_middles(vertices, faces, corners)), kind="stable")]
        counts = [max(1, -(-len(corners) // _BRANCHES))]
        leaves, boxes = np.zeros((counts[0], 8, _BRANCHES), np.float32), np.empty((counts[0], 10), np.float32)
        _fill_leaves(vertices, faces, planes, corners, leaves, boxes)
        levels: list[Float32] = []
        while counts[0] > 1 or not levels:
            counts.insert(0, -(-counts[0] // _BRANCHES))
            level, above = np.zeros((counts[0], 10, _BRANCHES), np.float32), np.empty((counts[0], 10), np.float32)
            _fill_level(boxes, level, above)
            levels.insert(0, level)
            boxes = above
        self._tree = _Tree(vertices, faces, corners, np.concatenate(levels), leaves, np.cumsum([0, *counts]))

    def between(self, begins: Float64, corner: Float64, across: Float64, along: Float64) -> Silhouettes:
        """The silhouettes between points and a rectangle.

        begins: Points a little off the surface, shape (3, k), in the mesh's radii from its centre, as all arguments
        corner, across, along: A corner of the rectangle and its two sides, perpendicular to each other, shape (3,)
        """
        normal = np.cross(across, along)
        hand = -float(np.copysign(1.0, normal @ corner))
        axes = np.stack([across / (across @ across), along / (along @ along), hand * normal / np.linalg.norm(normal)])
        view = _View(*(Vector(*row.tolist()) for row in (*axes, axes @ corner)), hand=hand)
        order = np.argsort(_curve_keys(np.ascontiguousarray(begins.T, np.float32)), kind="stable")
        return _silhouettes(self._tree, begins, view, order)


@kernel
def triangles_before(silhouettes: Silhouettes, i: int, s: float, t: float) -> int:
    """How many more triangles point i sees before place (s, t) of the rectangle than before its corner (0, 0)."""
    edges, row = silhouettes.edges, _row_of(t)
    count = _triangles_up_to(silhouettes, i, t)
    for j in range(silhouettes.first[i, row], silhouettes.first[i, row + 1]):
        where, change = _crossing(edges, j, t)
        count += change if 0.0 < where <= s else 0
    return count


@kernel
def triangles_in_row(silhouettes: Silhouettes, i: int, s: float, step: float, t: float, counts: Int64) -> None:
    """The same of the places (s, t), (s + step, t) and so on, as many as `counts` has room for."""
    edges, row = silhouettes.edges, _row_of(t)
    for k in range(len(counts)):
        counts[k] = 0
    counts[0] = _triangles_up_to(silhouettes, i, t)
    for j in range(silhouettes.first[i, row], silhouettes.first[i, row + 1]):
        where, change = _crossing(edges, j, t)
        k = max(0, math.ceil((where - s) / step)) if where > 0.0 else len(counts)
        if k < len(counts):
            counts[k] += change
    for k in range(1, len(counts)):
        counts[k] += counts[k - 1]


@kernel
def _row_of(t: float) -> int:
    return min(int(t * _ROWS), _ROWS - 1)


@kernel
def _triangles_up_to(silhouettes: Silhouettes, i: int, t: float) -> int:
    # from the corner (0, 0) up the side s = 0
    first, edges, count = silhouettes.first, silhouettes.edges, 0
    for j in range(first[i, _ROWS], first[i, _ROWS + 1]):
        s0, t0, s1, t1 = edges[j, 0], edges[j, 1], edges[j, 2], edges[j, 3]
        if t0 - s0 * (t1 - t0) / (s1 - s0) <= t:
            count += int(edges[j, 4]) if s1 > s0 else -int(edges[j, 4])
    return count


@kernel
def _crossing(edges: Float64, j: int, t: float) -> tuple[float, int]:
    # where an edge crosses a row, infinite where it does not, and by how many triangles that changes what is seen
    s0, t0, s1, t1 = edges[j, 0], edges[j, 1], edges[j, 2], edges[j, 3]
    if (t0 <= t) == (t1 <= t):
        return math.inf, 0
    return s0 + (t - t0) * (s1 - s0) / (t1 - t0), -int(edges[j, 4]) if t1 > t0 else int(edges[j, 4])


@kernel
def _curve_keys(points: Float32) -> Int32:
    # places of points in the unit sphere along a curve that stays near each of them (Morton order)
    keys = np.empty(len(points), np.int32)
    for i in range(len(points)):
        key = 0
        for axis in range(3):
            # spreads ten bits to every third one
            cell = int((points[i, axis] + 1.0) * 511.5)
            cell = (cell | (cell << 16)) & 0x030000FF
            cell = (cell | (cell << 8)) & 0x0300F00F
            cell = (cell | (cell << 4)) & 0x030C30C3
            cell = (cell | (cell << 2)) & 0x09249249
            key |= cell << axis
        keys[i] = key
    return keys


@kernel
def _edge_records(faces: Int32, order: Int32, begins: Int32) -> Int32:
    # edges of two triangles, and of each triangle on its own those of one or of more than two
    corners = np.empty((len(order), 2), np.int32)
    ends, count = faces.reshape(-1), 0
    for edge in range(len(begins) - 1):
        begin, end = begins[edge], begins[edge + 1]
        if ends[order[begin]] == ends[next_corner(order[begin])]:
            continue
        if end - begin == 2:
            corners[count, 0], corners[count, 1] = order[begin], order[begin + 1]
            count += 1
            continue
        for k in range(begin, end):
            corners[count, 0], corners[count, 1] = order[k], -1
            count += 1
    return corners[:count].copy()


@kernel
def _middles(vertices: Float32, faces: Int32, corners: Int32) -> Float32:
    ends = faces.reshape(-1)
    middles = np.empty((len(corners), 3), np.float32)
    for i in range(len(corners)):
        a, b = ends[corners[i, 0]], ends[next_corner(corners[i, 0])]
        for axis in range(3):
            middles[i, axis] = np.float32(0.5) * (vertices[a, axis] + vertices[b, axis])
    return middles


@kernel
def _fill_leaves(
    vertices: Float32, faces: Int32, planes: Float32, corners: Int32, leaves: Float32, boxes: Float32
) -> None:
    ends = faces.reshape(-1)
    low, high = np.empty(3), np.empty(3)
    for leaf in range(len(leaves)):
        for axis in range(3):
            low[axis], high[axis] = math.inf, -math.inf
        cone, ax, ay, az = True, 0.0, 0.0, 0.0
        begin, end = _BRANCHES * leaf, min(_BRANCHES * (leaf + 1), len(corners))
        for edge in range(begin, end):
            one, two = corners[edge, 0], corners[edge, 1]
            for vertex in (ends[one], ends[next_corner(one)]):
                for axis in range(3):
                    low[axis] = min(low[axis], vertices[vertex, axis])
                    high[axis] = max(high[axis], vertices[vertex, axis])
            # triangles that run along the edge the same way do not cancel, nor does a single one
            cone &= two >= 0 and ends[one] != ends[two]
            for which in range(2):
                corner = corners[edge, which]
                if corner < 0:
                    continue
                f, sign = corner // 3, np.float32(1.0 if ends[corner] == ends[one] else -1.0)
                cone &= planes[f, 0] != 0.0 or planes[f, 1] != 0.0 or planes[f, 2] != 0.0  # a face with an area
                ax, ay, az = ax + planes[f, 0], ay + planes[f, 1], az + planes[f, 2]
                for k in range(4):
                    leaves[leaf, 4 * which + k, edge - begin] = sign * planes[f, k]
        _write_box(boxes, leaf, low, high)
        length = math.sqrt(ax * ax + ay * ay + az * az)
        cosine = 1.0
        for edge in range(end - begin):
            for which in range(2):
                towards = 0.0
                for k, axis in enumerate((ax, ay, az)):
                    towards += axis * leaves[leaf, 4 * which + k, edge]
                # the second plane of an edge is turned over
                cosine = min(cosine, (towards if which == 0 else -towards) / length)
        _write_cone(boxes, leaf, cone, ax, ay, az, math.acos(min(max(cosine, -1.0), 1.0)))


@kernel
def _fill_level(children: Float32, level: Float32, boxes: Float32) -> None:
    # nodes, and the boxes around them, of the boxes of their children, all of 10 numbers
    low, high = np.empty(3), np.empty(3)
    for node in range(len(level)):
        for axis in range(3):
            low[axis], high[axis] = math.inf, -math.inf
        begin, end = _BRANCHES * node, min(_BRANCHES * (node + 1), len(children))
        cone, ax, ay, az = True, 0.0, 0.0, 0.0
        for child in range(begin, end):
            for number in range(10):
                level[node, number, child - begin] = children[child, number]
            for axis in range(3):
                low[axis] = min(low[axis], children[child, axis] - children[child, 3 + axis])
                high[axis] = max(high[axis], children[child, axis] + children[child, 3 + axis])
            cone &= children[child, 9] < 1.0
            ax, ay, az = ax + children[child, 6], ay + children[child, 7], az + children[child, 8]
        _write_box(boxes, node, low, high)
        length = math.sqrt(ax * ax + ay * ay + az * az)
        widest = 0.0
        for child in range(begin, end):
            towards = (ax * children[child, 6] + ay * children[child, 7] + az * children[child, 8]) / length
            widest = max(widest, math.acos(min(max(towards, -1.0), 1.0)) + math.asin(min(children[child, 9], 1.0)))
        _write_cone(boxes, node, cone, ax, ay, az, widest)


@kernel
def _write_box(boxes: Float32, i: int, low: Float64, high: Float64) -> None:
    for axis in range(3):
        boxes[i, axis] = 0.5 * (low[axis] + high[axis])
        boxes[i, 3 + axis] = 0.5 * (high[axis] - low[axis]) + _BOX_MARGIN


@kernel
def _write_cone(boxes: Float32, i: int, cone: bool, ax: float, ay: float, az: float, half_angle: float) -> None:
    length = math.sqrt(ax * ax + ay * ay + az * az)
    if cone and length > 0.0 and half_angle < 0.5 * math.pi:
        boxes[i, 6], boxes[i, 7], boxes[i, 8] = ax / length, ay / length, az / length
        boxes[i, 9] = math.sin(half_angle) + _CONE_MARGIN
    else:
        boxes[i, 6], boxes[i, 7], boxes[i, 8], boxes[i, 9] = 0.0, 0.0, 0.0, _NO_CONE


@kernel
def _silhouettes(tree: _Tree, begins: Float64, view: _View, order: Int64) -> Silhouettes:
    # order: of the points, in which neighbours follow each other
    k = begins.shape[1]
    first, found = np.zeros((k, _ROWS + 2), np.int64), np.zeros(k, np.bool_)
    edges, count = np.empty((64 * k, 5)), 0
    near, seen = np.empty(MOST_LEAVES, np.int64), np.empty((MOST_LEAVES * _BRANCHES, 5))
    some = np.empty(MOST_LEAVES * _BRANCHES, np.int64)
    planes, left = np.empty((8, len(some)), np.float32), np.empty(len(some), np.int32)
    before, ahead = np.empty(k, np.int64), 0  # those before the rectangle
    for i in order:
        before[ahead] = i
        ahead += _in_view(view, column_at(begins, i)).z > 0.0
    start = 0
    while start < ahead:
        end, box = _group(begins, view, before[:ahead], start, _GROUP)
        leaves = _leaves_near(tree, box, view, near)
        if leaves < 0:
            end, box = _group(begins, view, before[:ahead], start, 1)
            leaves = _leaves_near(tree, box, view, near)
        possible = _edges_near(tree.leaves, near, max(0, leaves), box, some, planes)
        for i in before[start:end]:
            found[i] = leaves >= 0
            _count_left(planes, column_at(begins, i), left[:possible])
            shown = _project(tree, some[:possible], left, column_at(begins, i), view, seen)
            _count_rows(seen, shown, count, first, i)
            count = first[i, _ROWS + 1]
            while count > len(edges):
                edges = _twice(edges)
            _write_rows(seen, shown, first, i, edges)
        start = end
    return Silhouettes(first, edges[:count].copy(), found)


@kernel
def _group(begins: Float64, view: _View, order: Int64, start: int, most: int) -> tuple[int, _Box]:
    # the end of the group of points that begins with number `start`, and the box around them
    low = high = column_at(begins, order[start])
    end = start + 1
    while end < min(start + most, len(order)):
        p = column_at(begins, order[end])
        lower = Vector(min(low.x, p.x), min(low.y, p.y), min(low.z, p.z))
        higher = Vector(max(high.x, p.x), max(high.y, p.y), max(high.z, p.z))
        if max(higher.x - lower.x, higher.y - lower.y, higher.z - lower.z) > _GROUP_SIDE:
            break
        low, high, end = lower, higher, end + 1
    middle, half = scaled(plus(low, high), 0.5), scaled(minus(high, low), 0.5)
    if end > start + 1:
        half = plus(half, Vector(_BOX_MARGIN, _BOX_MARGIN, _BOX_MARGIN))
    reach = Vector(_reach(view.across, half), _reach(view.along, half), _reach(view.upward, half))
    return end, _Box(middle, half, _in_view(view, middle), reach)


@kernel
def _reach(axis: Vector, half: Vector) -> float:
    # how far a box reaches from its middle along an axis
    return abs(axis.x) * half.x + abs(axis.y) * half.y + abs(axis.z) * half.z


@kernel
def _twice(edges: Float64) -> Float64:
    longer = np.empty((2 * len(edges), 5))
    for i in range(len(edges)):
        for k in range(5):
            longer[i, k] = edges[i, k]
    return longer


@kernel
def _in_view(view: _View, p: Vector) -> Vector:
    origin = view.origin
    return Vector(dot(view.across, p) - origin.x, dot(view.along, p) - origin.y, dot(view.upward, p) - origin.z)


@kernel
def _single(v: Vector) -> Vector:
    # in float32, of which twice as many are worked out at once
    x: Any = np.float32(v.x)
    y: Any = np.float32(v.y)
    z: Any = np.float32(v.z)
    return Vector(x, y, z)


@kernel
def _leaves_near(tree: _Tree, box: _Box, view: _View, near: Int64) -> int:
    # the leaves that may have silhouettes for the points in a box; how many, or −1 where they are too many
    nodes, begins = tree.nodes, tree.begins
    points = _Box(_single(box.middle), _single(box.half), _single(box.place), _single(box.half_place))
    origin = _single(view.origin)
    axes = _View(_single(view.across), _single(view.along), _single(view.upward), origin, view.hand)
    stack, last = np.empty((len(begins) * _BRANCHES, 2), np.int64), 1
    stack[0, 0] = stack[0, 1] = 0  # level, number of the node in it
    lowest, kept = len(begins) - 3, 0
    while last > 0:
        last -= 1
        level, number = stack[last, 0], stack[last, 1]
        mask = _children_near(nodes, begins[level] + number, points, axes)
        child = _BRANCHES * number
        while mask != 0:
            if mask & 1 == 1 and child < begins[level + 2] - begins[level + 1]:
                if level < lowest:
                    stack[last, 0], stack[last, 1] = level + 1, child
                    last += 1
                elif kept < len(near):
                    near[kept] = child
                    kept += 1
                else:
                    return -1
            mask >>= 1
            child += 1
    return kept


@kernel
def _children_near(nodes: Float32, node: int, points: _Box, view: _View) -> int:
    # bit k: whether edges of child k may change what a point of a box sees; without branches, so that all children are
    # worked out at once. The way from a point at x, height z, through a place at u, height w, meets the rectangle at
    # (u·z − x·w) / (z − w): outside for all places of a box, if the greatest u·z is below the least x·w; likewise
    # counted from the opposite side
    across, along, upward, origin = view.across, view.along, view.upward, view.origin
    p, half, at, reach = points.middle, points.half, points.place, points.half_place
    lowest, highest = at.z - reach.z, at.z + reach.z
    first_x, last_x = at.x - reach.x, _ONE - at.x - reach.x
    first_y, last_y = at.y - reach.y, _ONE - at.y - reach.y
    slack, mask = _SLACK * highest, 0
    for k in range(_BRANCHES):
        mx, my, mz = nodes[node, 0, k], nodes[node, 1, k], nodes[node, 2, k]
        hx, hy, hz = nodes[node, 3, k], nodes[node, 4, k], nodes[node, 5, k]
        height = upward.x * mx + upward.y * my + upward.z * mz - origin.z
        deep = abs(upward.x) * hx + abs(upward.y) * hy + abs(upward.z) * hz + slack
        least, most = max(height - deep, _ZERO), height + deep
        near = (height - deep <= highest) & (most >= _ZERO)  # not behind the points, nor beyond the rectangle
        u = across.x * mx + across.y * my + across.z * mz - origin.x
        wide = abs(across.x) * hx + abs(across.y) * hy + abs(across.z) * hz + slack
        up, down = u + wide, _ONE - u + wide
        near &= max(up * lowest, up * highest) >= min(first_x * least, first_x * most)
        near &= max(down * lowest, down * highest) >= min(last_x * least, last_x * most)
        u = along.x * mx + along.y * my + along.z * mz - origin.y
        wide = abs(along.x) * hx + abs(along.y) * hy + abs(along.z) * hz + slack
        up, down = u + wide, _ONE - u + wide
        near &= max(up * lowest, up * highest) >= min(first_y * least, first_y * most)
        near &= max(down * lowest, down * highest) >= min(last_y * least, last_y * most)
        # all normals are less than 90° from all ways, or all more: angle of the axis < 90° − cone − what the ways span
        sine = nodes[node, 9, k]
        dx, dy, dz = mx - p.x, my - p.y, mz - p.z
        hx, hy, hz = hx + half.x, hy + half.y, hz + half.z
        around = hx * hx + hy * hy + hz * hz
        free = np.sqrt(max(_ZERO, dx * dx + dy * dy + dz * dz - around))
        around = np.sqrt(around)
        cosine = np.sqrt(max(_ZERO, _ONE - sine * sine))
        towards = abs(dx * nodes[node, 6, k] + dy * nodes[node, 7, k] + dz * nodes[node, 8, k])
        turned = (cosine * free > sine * around) & (towards > sine * free + cosine * around)
        mask |= (1 << k) if near & (not turned) else 0
    return mask


@kernel
def _edges_near(leaves: Float32, near: Int64, count: int, box: _Box, some: Int64, planes: Float32) -> int:
    # the edges of some leaves that may be silhouettes for points in a box, and their planes, shape (8, m); how many
    kept = 0
    for j in range(count):
        mask, k = _possible_silhouettes(leaves, near[j], box.middle, box.half), 0
        while mask != 0:
            if mask & 1 == 1:
                some[kept] = _BRANCHES * near[j] + k
                for number in range(8):
                    planes[number, kept] = leaves[near[j], number, k]
                kept += 1
            mask >>= 1
            k += 1
    return kept


@kernel
def _possible_silhouettes(leaves: Float32, leaf: int, p: Vector, half: Vector) -> int:
    # bit k: whether edge k of a leaf may be one for points in a box, from its middle and half sides: it is none if all
    # of the box is above the plane of one triangle and below that of the other, which is turned over. Without branches,
    # so that all are worked out at once
    mask = 0
    for k in range(_BRANCHES):
        a, b, c, d = leaves[leaf, 0, k], leaves[leaf, 1, k], leaves[leaf, 2, k], leaves[leaf, 3, k]
        one, reach_one = a * p.x + b * p.y + c * p.z - d, abs(a) * half.x + abs(b) * half.y + abs(c) * half.z
        a, b, c, d = leaves[leaf, 4, k], leaves[leaf, 5, k], leaves[leaf, 6, k], leaves[leaf, 7, k]
        two, reach_two = a * p.x + b * p.y + c * p.z - d, abs(a) * half.x + abs(b) * half.y + abs(c) * half.z
        none = (one > reach_one) & (two < -reach_two) | (one < -reach_one) & (two > reach_two)
        mask |= (0 if none else 1) << k
    return mask


@kernel
def _count_left(planes: Float32, p: Vector, left: Int32) -> None:
    # of edges, the number of their triangles that lie on their left less those on their right, seen from a point
    for k in range(len(left)):
        one = planes[0, k] * p.x + planes[1, k] * p.y + planes[2, k] * p.z - planes[3, k]
        two = planes[4, k] * p.x + planes[5, k] * p.y + planes[6, k] * p.z - planes[7, k]
        left[k] = (1 if one > 0.0 else 0) - (1 if one < 0.0 else 0) + (1 if two > 0.0 else 0) - (1 if two < 0.0 else 0)


@kernel
def _project(tree: _Tree, some: Int64, left: Int32, p: Vector, view: _View, seen: Float64) -> int:
    # those of some edges that are silhouettes for a point, projected from it onto the rectangle; how many
    vertices, faces, corners = tree.vertices, tree.faces, tree.corners
    at, shown = _in_view(view, p), 0
    for j in range(len(some)):
        if left[j] == 0:
            continue
        f, k = corners[some[j], 0] // 3, corners[some[j], 0] % 3
        a, b = _place(vertices, faces[f, k], view), _place(vertices, faces[f, (k + 1) % 3], view)
        # what is before the point, and before the rectangle
        begin, end = _between(a.z, b.z, _NEAREST * at.z, at.z)
        if begin >= end:
            continue
        s0, t0 = _projected(a, b, begin, at)
        s1, t1 = _projected(a, b, end, at)
        if max(s0, s1) <= 0.0 or min(s0, s1) > 1.0 or max(t0, t1) <= 0.0 or min(t0, t1) > 1.0:
            continue
        seen[shown, 0], seen[shown, 1], seen[shown, 2], seen[shown, 3] = s0, t0, s1, t1
        seen[shown, 4] = left[j] * view.hand
        shown += 1
    return shown


@kernel
def _place(vertices: Float32, vertex: int, view: _View) -> Vector:
    return _in_view(view, Vector(float(vertices[vertex, 0]), float(vertices[vertex, 1]), float(vertices[vertex, 2])))


@kernel
def _between(first: float, second: float, nearest: float, z: float) -> tuple[float, float]:
    # the stretch of an edge, as shares of it, that is lower than a point at height z and not beyond the rectangle
    begin, end = 0.0, 1.0
    highest = z - nearest
    if first > highest or second > highest:
        if first > highest and second > highest:
            return 1.0, 0.0
        share = (highest - first) / (second - first)
        begin, end = (share, end) if first > highest else (begin, share)
    if first < 0.0 or second < 0.0:
        if first < 0.0 and second < 0.0:
            return 1.0, 0.0
        share = first / (first - second)
        begin, end = (max(begin, share), end) if first < 0.0 else (begin, min(end, share))
    return begin, end


@kernel
def _projected(a: Vector, b: Vector, share: float, at: Vector) -> tuple[float, float]:
    # exactly the same for all edges that end at a vertex
    if share == 0.0:
        x, y, z = a.x, a.y, a.z
    elif share == 1.0:
        x, y, z = b.x, b.y, b.z
    else:
        x, y, z = a.x + share * (b.x - a.x), a.y + share * (b.y - a.y), a.z + share * (b.z - a.z)
    return (x * at.z - at.x * z) / (at.z - z), (y * at.z - at.y * z) / (at.z - z)


@kernel
def _rows_of(seen: Float64, j: int) -> tuple[int, int, bool]:
    # the first and the last row that an edge passes, and whether it crosses the rectangle's side s = 0
    s0, t0, s1, t1 = seen[j, 0], seen[j, 1], seen[j, 2], seen[j, 3]
    first = min(max(int(min(t0, t1) * _ROWS), 0), _ROWS - 1)
    last = min(max(int(max(t0, t1) * _ROWS), 0), _ROWS - 1)
    crosses = (s0 <= 0.0) != (s1 <= 0.0) and t0 - s0 * (t1 - t0) / (s1 - s0) > 0.0
    return first, last, crosses


@kernel
def _count_rows(seen: Float64, shown: int, begin: int, first: Int64, i: int) -> None:
    for row in range(_ROWS + 2):
        first[i, row] = 0
    for j in range(shown):
        low, high, crosses = _rows_of(seen, j)
        for row in range(low, high + 1):
            first[i, row + 1] += 1
        first[i, _ROWS + 1] += crosses
    first[i, 0] = begin
    for row in range(_ROWS + 1):
        first[i, row + 1] += first[i, row]


@kernel
def _write_rows(seen: Float64, shown: int, first: Int64, i: int, edges: Float64) -> None:
    free = first[i].copy()
    for j in range(shown):
        low, high, crosses = _rows_of(seen, j)
        for row in range(low, high + 2):
            if row <= high or crosses:
                to = free[row if row <= high else _ROWS]
                free[row if row <= high else _ROWS] += 1
                for k in range(5):
                    edges[to, k] = seen[j, k]
