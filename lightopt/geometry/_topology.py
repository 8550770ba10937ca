"""Which vertices coincide and which edges two faces share: what repairing and smoothing stand on."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float64, Int32, Int64, UInt64
from lightopt.core.kernels import kernel


@dataclass(frozen=True, eq=False)
class EdgePairs:
    """Edges that exactly two faces use.

    corners: The two corners that begin the edge, one in each face, as 3·face + corner, lower face first, shape (e, 2),
        int32
    same_direction: True where both faces run along the edge in the same direction (their windings disagree), shape (e,)
    rim: True for faces that touch an edge used once or more than twice, shape (m,)
    """

    corners: Int32
    same_direction: Bool
    rim: Bool


@dataclass(frozen=True, eq=False)
class MeshEdges:
    """Every edge once.

    ends: Vertex indices, the lower one first, shape (e, 2)
    uses: Number of faces at the edge, shape (e,)
    corners: The corners that begin the edge in the first and in the last of them, as 3·face + corner, shape (e, 2)
    order: All corners, those of an edge together, shape (3·m,)
    """

    ends: Int64
    uses: Int64
    corners: Int64
    order: Int64

    @property
    def faces(self) -> Int64:
        """The first and the last of the faces at the edge, shape (e, 2)."""
        return self.corners // 3


def merge_rows(rows: Float64) -> tuple[Int32, Int32]:
    """Find the unique rows of an array by exact value, in order of first occurrence.

    rows: Positions, or positions with normals, shape (n, k)
    Returns: Row numbers of the first occurrences, shape (u,), and for each row the number of its unique row, shape
        (n,).
    """
    # adding 0.0 turns −0.0 into 0.0, so that equal numbers have equal bits
    bits = np.ascontiguousarray(rows + 0.0).view(np.uint64)
    return _merge_bits(bits)


def mesh_edges(faces: NDArray[np.integer]) -> MeshEdges:
    """Every edge of some faces once.

    faces: Vertex indices, shape (m, 3); edges meet where these are the same, whatever the positions are
    """
    start, end = _corner_vertices(faces)
    count = int(start.max()) + 1
    key = np.minimum(start, end) * count + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    key = key[order]
    first = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
    last = np.append(first[1:], len(key)) - 1
    return MeshEdges(
        ends=np.stack([key[first] // count, key[first] % count], axis=1),
        uses=last - first + 1,
        corners=np.stack([order[first], order[last]], axis=1),
        order=order,
    )


def edge_pairs(faces: Int32) -> EdgePairs:
    """Match the edges of all faces."""
    edges = mesh_edges(faces)
    start, _ = _corner_vertices(faces)
    corners = edges.corners[edges.uses == 2].astype(np.int32)
    rim = np.zeros(len(faces), dtype=np.bool_)
    rim[edges.order[np.repeat(edges.uses != 2, edges.uses)] // 3] = True
    return EdgePairs(corners=corners, same_direction=start[corners[:, 0]] == start[corners[:, 1]], rim=rim)


def _corner_vertices(faces: NDArray[np.integer]) -> tuple[Int64, Int64]:
    """The vertices at which the edge of each corner begins and ends, shape (3·m,)."""
    return faces.reshape(-1).astype(np.int64), faces[:, (1, 2, 0)].reshape(-1).astype(np.int64)


@kernel
def _merge_bits(bits: UInt64) -> tuple[Int32, Int32]:
    n, k = bits.shape
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
            h = (h ^ bits[i, j]) * np.uint64(0xFF51AFD7ED558CCD)
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
                same = same and bits[first[found], j] == bits[i, j]
            if same:
                inverse[i] = found
                break
            slot = (slot + np.uint64(1)) & mask
    return first[:unique].copy(), inverse
