"""Make all faces of a surface wind the same way, and closed surfaces face outwards."""

from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Bool, Float64, Int32
from lightopt.core.errors import counted
from lightopt.core.kernels import kernel
from lightopt.geometry._topology import EdgePairs, edge_pairs
from lightopt.geometry._triangle_mesh import TriangleMesh, face_crosses

_NO_VOLUME = 1e-9  # closed surfaces with less volume than this part of area^1.5 are folded sheets without an inside


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
