"""Kernels that bisect triangles at their longest edge, count the pieces, and find the one under a point."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float64, Int32, UInt8
from lightopt.core.kernels import kernel

# Pending triangles of one face: one for each level of its tree. Two cuts at most halve the longest edge, so
# 512 levels outlast float64.
_LEVELS = 512


@kernel
def _longest_edge(a: Float64, b: Float64, c: Float64, limit: float) -> int:
    """Edge k (from corner k to k + 1) that is longest, the first of equals; −1 if none is over the limit."""
    best, edge = limit * limit, -1
    for k in range(3):
        p, q = (a, b) if k == 0 else ((b, c) if k == 1 else (c, a))
        x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        square = x * x + y * y + z * z
        if square > best:
            best, edge = square, k
    return edge


@kernel
def _halves(
    triangle: NDArray[Any], edge: int, middle: Any, first: NDArray[Any], second: NDArray[Any]
) -> None:
    """Cut a triangle, keeping its sense of rotation; the first half holds the start of the cut edge."""
    for k in range(3):
        first[k] = triangle[k]
        second[k] = triangle[k]
    first[(edge + 1) % 3] = middle
    second[edge] = middle


@kernel
def count_pieces(vertices: Float64, faces: Int32, selected: Bool, limit: float, enough: int) -> int:
    """Count the pieces of all faces, up to `enough`."""
    stack = np.empty((_LEVELS, 3, 3))
    triangle = np.empty((3, 3))
    middle = np.empty(3)
    total = len(faces)
    for f in range(len(faces)):
        if not selected[f]:
            continue
        for k in range(3):
            stack[0, k] = vertices[faces[f, k]]
        top = 1
        while top > 0:
            top -= 1
            triangle[:] = stack[top]
            edge = _longest_edge(triangle[0], triangle[1], triangle[2], limit)
            if edge < 0 or top + 2 > _LEVELS:
                continue
            for axis in range(3):
                middle[axis] = 0.5 * (triangle[edge, axis] + triangle[(edge + 1) % 3, axis])
            _halves(triangle, edge, middle, stack[top + 1], stack[top])
            top += 2
            total += 1
            if total >= enough:
                return total
    return total


@kernel
def build_pieces(
    vertices: Float64, faces: Int32, selected: Bool, limit: float, count: int
) -> tuple[NDArray[Any], ...]:
    """Cut all faces: vertices, triangles, centroid weights, depths, faces, and the trees of `Patches`.

    Follows `count_pieces` exactly. A child's tree entry is written into its parent when the child is taken
    up.
    """
    n, m = len(vertices), len(faces)
    cuts = count - m
    points = np.empty((n + cuts, 3))
    points[:n] = vertices
    triangles = np.empty((count, 3), dtype=np.int32)
    weights = np.empty((count, 3))
    depths = np.empty(count, dtype=np.int32)
    face = np.empty(count, dtype=np.int32)
    roots = np.empty(m, dtype=np.int32)
    children = np.empty((cuts, 2), dtype=np.int32)
    cut_edge = np.empty(cuts, dtype=np.uint8)
    stack = np.empty((_LEVELS, 3), dtype=np.int32)
    stack_weights = np.empty((_LEVELS, 3, 3))
    stack_depth = np.empty(_LEVELS, dtype=np.int32)
    stack_parent = np.empty((_LEVELS, 2), dtype=np.int32)
    triangle = np.empty(3, dtype=np.int32)
    corner_weights = np.empty((3, 3))
    middle = np.empty(3)
    patch, node = 0, 0
    for f in range(m):
        stack[0] = faces[f]
        stack_weights[0] = np.eye(3)
        stack_depth[0] = 0
        stack_parent[0, 0] = -1
        top = 1
        while top > 0:
            top -= 1
            triangle[:] = stack[top]
            corner_weights[:] = stack_weights[top]
            depth, parent, side = stack_depth[top], stack_parent[top, 0], stack_parent[top, 1]
            edge = -1
            if selected[f] and top + 2 <= _LEVELS:
                edge = _longest_edge(points[triangle[0]], points[triangle[1]], points[triangle[2]], limit)
            entry = -1 - patch if edge < 0 else node
            if parent < 0:
                roots[f] = entry
            else:
                children[parent, side] = entry
            if edge < 0:
                triangles[patch] = triangle
                for axis in range(3):
                    weights[patch, axis] = corner_weights[:, axis].sum() / 3.0
                depths[patch] = depth
                face[patch] = f
                patch += 1
                continue
            new = n + node
            after = (edge + 1) % 3
            for axis in range(3):
                points[new, axis] = 0.5 * (points[triangle[edge], axis] + points[triangle[after], axis])
                middle[axis] = 0.5 * (corner_weights[edge, axis] + corner_weights[after, axis])
            _halves(triangle, edge, new, stack[top + 1], stack[top])
            _halves(corner_weights, edge, middle, stack_weights[top + 1], stack_weights[top])
            for half in range(2):
                stack_depth[top + half] = depth + 1
                stack_parent[top + half, 0] = node
                stack_parent[top + half, 1] = 1 - half
            cut_edge[node] = edge
            node += 1
            top += 2
    return points, triangles, weights, depths, face, roots, children, cut_edge


@kernel
def find_pieces(
    roots: Int32, children: Int32, cut_edge: UInt8, faces: Int32, us: Float64, vs: Float64
) -> Int32:
    """Patch of each point; −1 for face −1.

    Down the tree the weights of the corners tell the half: the point is nearer to the end of the cut edge
    that weighs more, and against the half's own corners it has weights w_near − w_far, 2·w_far (the middle)
    and the third as it was.
    """
    found = np.full(len(faces), -1, dtype=np.int32)
    weight = np.empty(3)
    for i in range(len(faces)):
        if faces[i] < 0:
            continue
        weight[0], weight[1], weight[2] = 1.0 - us[i] - vs[i], us[i], vs[i]
        entry = roots[faces[i]]
        while entry >= 0:
            start = cut_edge[entry]
            end = (start + 1) % 3
            if weight[start] >= weight[end]:
                weight[start] -= weight[end]
                weight[end] *= 2.0
                entry = children[entry, 0]
            else:
                weight[end] -= weight[start]
                weight[start] *= 2.0
                entry = children[entry, 1]
        found[i] = -1 - entry
    return found
