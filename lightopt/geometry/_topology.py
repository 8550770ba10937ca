"""Which vertices coincide and which edges two faces share: what repairing and smoothing stand on."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float32, Float64, Int32, Int64
from lightopt.core.kernels import bits_of_float, kernel


@dataclass(frozen=True, eq=False)
class EdgePairs:
    """Edges that exactly two faces use."""

    corners: Int32  # the corners that begin the edge, one in each face, 3·face + corner, lower face first; (e, 2)
    same_direction: Bool  # whether both faces run along the edge the same way (their windings disagree), shape (e,)
    rim: Bool  # whether a face touches an edge used once or more than twice, shape (m,)


@dataclass(frozen=True, eq=False)
class MeshEdges:
    """Every edge once."""

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
    """Match the edges of all faces."""
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
