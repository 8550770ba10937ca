"""The edges of a triangle mesh and the faces at them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Edges", "coinciding_vertices", "edges"]


@dataclass(frozen=True, eq=False)
class Edges:
    """Every edge once.

    Attributes
    ----------
    ends
        Vertex indices, the lower one first, shape (e, 2).
    uses
        Number of faces at the edge, shape (e,).
    faces
        The first and the last of them, shape (e, 2).
    """

    ends: NDArray[np.int64]
    uses: NDArray[np.int64]
    faces: NDArray[np.int64]


def edges(faces: NDArray[np.integer]) -> Edges:
    """The edges of faces, by vertex index.

    Parameters
    ----------
    faces
        Vertex indices, shape (m, 3).
    """
    start = faces.reshape(-1).astype(np.int64)
    end = faces[:, (1, 2, 0)].reshape(-1).astype(np.int64)
    count = int(start.max()) + 1
    key = np.minimum(start, end) * count + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    key = key[order]
    first = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
    last = np.append(first[1:], len(key)) - 1
    return Edges(
        ends=np.stack([key[first] // count, key[first] % count], axis=1),
        uses=last - first + 1,
        faces=np.stack([order[first] // 3, order[last] // 3], axis=1),
    )


def coinciding_vertices(vertices: NDArray[np.float64]) -> NDArray[np.int64]:
    """A number for each vertex that is the same where positions are the same, shape (n,)."""
    order = np.lexsort(vertices.T)
    ordered = vertices[order]
    new = np.concatenate([[False], np.any(ordered[1:] != ordered[:-1], axis=1)])
    number = np.empty(len(vertices), np.int64)
    number[order] = np.cumsum(new)
    return number
