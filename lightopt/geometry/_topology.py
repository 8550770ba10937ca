"""Which vertices coincide, which edges two faces share, which way faces wind: what repair and smoothing stand on.

Repair makes all faces of a surface wind the same way, and closed surfaces face outwards.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float32, Float64, Int32, Int64
from lightopt.core.errors import counted
from lightopt.core.kernels import bits_of_float, kernel
from lightopt.geometry._triangle_mesh import TriangleMesh, face_crosses

_NO_VOLUME = 1e-9  # closed surfaces with less volume than this part of area^1.5 are folded sheets without an inside


@dataclass(frozen=True, eq=False)
class EdgePairs:
    """Edges that exactly two faces use."""

    corners: Int32  # the corners that begin the edge, one in each face, 3·face + corner, lower face first; (e, 2)
    same_direction: Bool  # whether both faces run along the edge the same way (their windings disagree), shape (e,)
    rim: Bool  # whether a face touches an edge used once or more than twice, shape (m,)


@dataclass(frozen=True, eq=False)
class MeshEdges:
    ends: Int64  # vertex indices, the lower one first, shape (e, 2)
    uses: Int64  # number of faces at the edge, shape (e,)
    corners: Int64  # that begin the edge in the first and in the last of them, as 3·face + corner, shape (e, 2)

    @property
    def faces(self) -> Int64:
        """The first and the last of the faces at the edge, shape (e, 2)."""
        return self.corners // 3


def merge_rows(rows: Float32 | Float64) -> tuple[Int32, Int32]:
    """Find the unique rows of an array by exact value, in order of first occurrence.

    rows: Positions, or positions with normals, finite, shape (n, k)
    Returns: Row numbers of the first occurrences, shape (u,), and for each row the number of its unique row, shape
        (n,).
    """
    return _merged(np.ascontiguousarray(rows))


def mesh_edges(faces: NDArray[np.integer]) -> MeshEdges:
    """Every edge of some faces (m, 3) once; edges meet where vertex indices are the same, wherever the vertices are."""
    faces = np.ascontiguousarray(faces, np.int32)
    order, begins = corners_by_edge(faces)
    first, last = order[begins[:-1]], order[begins[1:] - 1]
    start, end = faces.reshape(-1)[first], faces[:, (1, 2, 0)].reshape(-1)[first]
    ends = np.stack([np.minimum(start, end), np.maximum(start, end)], axis=1).astype(np.int64)
    corners = np.stack([first, last], axis=1).astype(np.int64)
    return MeshEdges(ends=ends, uses=np.diff(begins).astype(np.int64), corners=corners)


def edge_pairs(faces: Int32) -> EdgePairs:
    order, begins = corners_by_edge(faces)
    uses = np.diff(begins)
    of_two = begins[:-1][uses == 2]
    corners = np.stack([order[of_two], order[of_two + 1]], axis=1)
    start = faces.reshape(-1)[corners]
    rim = np.zeros(len(faces), np.bool_)
    rim[order[np.repeat(uses != 2, uses)] // 3] = True
    return EdgePairs(corners, start[:, 0] == start[:, 1], rim)


@kernel
def corners_by_edge(faces: Int32) -> tuple[Int32, Int32]:
    """All corners, 3·face + corner, those that begin the same edge one after the other, and where each edge begins.

    Edges come by their lower vertex, then by the other one; corners of an edge ascend. A degenerate face has edges from
    a vertex to itself. Shapes (3·m,) and (e + 1,): edge i has the corners from number ``begins[i]`` up to
    ``begins[i + 1]``.
    """
    count = 3 * len(faces)
    first = np.zeros(faces.max() + 2, np.int32)
    for f in range(len(faces)):
        for k in range(3):
            first[min(faces[f, k], faces[f, (k + 1) % 3]) + 1] += 1
    for i in range(len(first) - 1):
        first[i + 1] += first[i]
    place = first[:-1].copy()
    order, other = np.empty(count, np.int32), np.empty(count, np.int32)
    for f in range(len(faces)):
        for k in range(3):
            a, b = faces[f, k], faces[f, (k + 1) % 3]
            at = place[min(a, b)]
            order[at], other[at] = 3 * f + k, max(a, b)
            place[min(a, b)] += 1
    begins = np.empty(count + 1, np.int32)
    edges = 0
    for i in range(len(first) - 1):
        begin, end = first[i], first[i + 1]
        _sort_by_keys(other[begin:end], order[begin:end])
        for at in range(begin, end):
            if at == begin or other[at] != other[at - 1]:
                begins[edges] = at
                edges += 1
    begins[edges] = count
    return order, begins[: edges + 1].copy()


@kernel
def next_corner(corner: Any) -> Any:
    """The corner after a corner in its face; of one or of an array."""
    return corner - corner % 3 + (corner + 1) % 3


@kernel
def _sort_by_keys(keys: Int32, values: Int32) -> None:
    # both in place, by Shell's method; values of equal keys ascend. NumPy's sorting takes seconds to compile
    gap = 1
    while len(keys) > 32 and gap < len(keys) // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, len(keys)):
            key, value, j = keys[i], values[i], i
            while j >= gap and (keys[j - gap] > key or (keys[j - gap] == key and values[j - gap] > value)):
                keys[j], values[j] = keys[j - gap], values[j - gap]
                j -= gap
            keys[j], values[j] = key, value
        gap //= 3


@kernel
def join(parent: Int32, x: int, y: int) -> None:
    """Make two elements of a union-find structure one set, whose root is the lower one; halves paths."""
    while parent[x] != x:
        parent[x] = parent[parent[x]]
        x = parent[x]
    while parent[y] != y:
        parent[y] = parent[parent[y]]
        y = parent[y]
    parent[max(x, y)] = min(x, y)


@kernel
def _merged(rows: Any) -> tuple[Int32, Int32]:
    n, k = rows.shape
    size = 16
    while size < 2 * n:
        size *= 2
    mask = np.uint64(size - 1)
    table = np.full(size, -1, dtype=np.int32)
    first = np.empty(n, dtype=np.int32)
    inverse = np.empty(n, dtype=np.int32)
    unique = 0
    for i in range(n):
        h = np.uint64(0x9E3779B97F4A7C15)
        for j in range(k):
            # adding 0.0 turns −0.0 into 0.0, so that equal numbers have equal bits
            h = (h ^ np.uint64(bits_of_float(np.float64(rows[i, j]) + 0.0))) * np.uint64(0xFF51AFD7ED558CCD)
            h ^= h >> np.uint64(32)
        slot = h & mask
        while True:
            found = table[slot]
            if found < 0:
                table[slot] = unique
                first[unique] = i
                inverse[i] = unique
                unique += 1
                break
            same = True
            for j in range(k):
                same = same and rows[first[found], j] == rows[i, j]
            if same:
                inverse[i] = found
                break
            slot = (slot + np.uint64(1)) & mask
    return first[:unique].copy(), inverse


@dataclass(frozen=True, eq=False)
class Repaired:
    """Faces with a winding that agrees across every edge of two faces."""

    faces: Int32
    pairs: EdgePairs
    warnings: tuple[str, ...]  # what was turned, with numbers


def repair_winding(vertices: Float64, faces: Int32) -> Repaired:
    """Turn the faces that wind against their neighbours, then the closed surfaces that are inside out.

    Of each connected surface the smaller share is turned. A closed surface of negative volume is turned
    unless it lies inside another one: then it is a cavity and faces the right way.

    vertices: Positions without coinciding ones [mm], shape (n, 3)
    faces: Vertex indices, all of them with an area, shape (m, 3)
    """
    pairs = edge_pairs(faces)
    label, turn = _flood(len(faces), pairs.corners, pairs.same_direction)
    components = int(label.max()) + 1
    size = np.bincount(label, minlength=components)
    minority = np.bincount(label, weights=turn, minlength=components) * 2 > size
    turn = turn ^ minority[label]
    warnings: list[str] = []
    if turn.any():
        warnings.append(f"{np.count_nonzero(turn)} of {len(faces)} triangles wound against their neighbours: turned")
        faces = _turned(faces, turn)
        pairs = edge_pairs(faces)
    twisted = pairs.corners[pairs.same_direction, 0] // 3
    if len(twisted):
        kept = "between triangles whose winding cannot be made to agree (a one-sided surface): kept"
        warnings.append(f"{counted(len(twisted), 'edge')} {kept}")
    is_open = np.bincount(label, weights=pairs.rim, minlength=components) > 0
    is_open[label[twisted]] = True
    inside_out = _inside_out(vertices, faces, label, ~is_open)
    if inside_out.any():
        turn = inside_out[label]
        triangles = counted(int(np.count_nonzero(turn)), "triangle")
        surfaces = counted(int(np.count_nonzero(inside_out)), "closed surface")
        warnings.append(f"{surfaces} ({triangles}) inside out: turned")
        faces = _turned(faces, turn)
        pairs = edge_pairs(faces)
    return Repaired(faces, pairs, tuple(warnings))


def _turned(faces: Int32, turn: Bool) -> Int32:
    return np.where(turn[:, None], faces[:, (0, 2, 1)], faces)


def _inside_out(vertices: Float64, faces: Int32, label: Int32, closed: Bool) -> Bool:
    # the volume of a closed surface does not depend on the origin, its rounding error does
    middle = vertices.mean(axis=0)
    centred, cross = vertices - middle, face_crosses(vertices, faces)
    volume = np.bincount(label, np.einsum("ij,ij->i", centred[faces[:, 0]], cross) / 6.0, len(closed))
    area = np.bincount(label, 0.5 * np.sqrt(np.einsum("ij,ij->i", cross, cross)), len(closed))
    result = closed & (volume < -_NO_VOLUME * area**1.5)
    if not result.any() or np.count_nonzero(closed) == 1:
        return result
    corners = centred[faces]
    low, high = np.full((len(closed), 3), np.inf), np.full((len(closed), 3), -np.inf)
    np.minimum.at(low, label, corners.min(axis=1))
    np.maximum.at(high, label, corners.max(axis=1))
    in_closed = closed[label]
    for c in np.flatnonzero(result):
        around = closed & (low <= low[c]).all(axis=1) & (high >= high[c]).all(axis=1)
        around[c] = False
        if not around.any():
            continue
        point = corners[int(np.argmax(label == c)), 0]
        others = corners[in_closed & around[label]]
        result[c] = abs(winding_number(others, point)) < 0.5
    return result


@kernel
def _flood(face_count: int, corners: Int32, same_direction: Bool) -> tuple[Int32, Bool]:
    """Label connected faces; turn[f] is whether f winds against the first face of its surface."""
    neighbour = np.full(3 * face_count, -1, dtype=np.int32)  # of each corner, across the edge that it begins
    against = np.zeros(3 * face_count, dtype=np.bool_)
    for e in range(len(corners)):
        c, d = corners[e]
        neighbour[c], neighbour[d] = d // 3, c // 3
        against[c] = against[d] = same_direction[e]
    label = np.full(face_count, -1, dtype=np.int32)
    turn = np.zeros(face_count, dtype=np.bool_)
    queue = np.empty(face_count, dtype=np.int32)
    component = 0
    for seed in range(face_count):
        if label[seed] >= 0:
            continue
        label[seed] = component
        queue[0] = seed
        head, tail = 0, 1
        while head < tail:
            f = queue[head]
            head += 1
            for corner in range(3 * f, 3 * f + 3):
                g = neighbour[corner]
                if g >= 0 and label[g] < 0:
                    label[g] = component
                    turn[g] = turn[f] ^ against[corner]
                    queue[tail] = g
                    tail += 1
        component += 1
    return label, turn


def points_inside(points: Float64, mesh: TriangleMesh) -> Bool:
    """Whether points lie inside a surface: one that is mostly closed, around which it winds more than half a time.

    points: [mm], shape (k, 3), frame of the mesh
    mesh: Its faces wind alike, whichever way
    Returns: Shape (k,).
    """
    low, high = mesh.bounds
    inside = np.all((points >= low) & (points <= high), axis=1)
    if inside.any():
        triangles = mesh.vertices[mesh.faces]
        for i in np.flatnonzero(inside):
            inside[i] = abs(winding_number(triangles, points[i])) > 0.5
    return inside


def winding_number(triangles: Float64, point: Float64) -> float:
    """How often closed surfaces surround a point.

    Solid angles by van Oosterom and Strackee 1983, doi:10.1109/TBME.1983.325207, eq. 8.

    triangles: Corners [mm], shape (m, 3, 3)
    point: [mm], shape (3,)
    """
    a, b, c = (triangles - point).swapaxes(0, 1)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", *sides) for sides in ((a, b), (b, c), (c, a)))
    over = np.einsum("ij,ij->i", a, np.cross(b, c))
    return float(np.arctan2(over, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2.0 * np.pi))
