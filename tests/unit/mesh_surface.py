"""How the triangles of a mesh hang together: open and branching edges, connected surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from lightopt.geometry import TriangleMesh, merge_rows, mesh_edges


@dataclass(frozen=True)
class Surface:
    """open_edges, nonmanifold_edges: Of one triangle, and of three or more; components: Joined by edges of two."""

    open_edges: int
    nonmanifold_edges: int
    components: int

    @property
    def watertight(self) -> bool:
        return self.open_edges == 0 and self.nonmanifold_edges == 0


def surface_of(mesh: TriangleMesh) -> Surface:
    edges = mesh_edges(merge_rows(mesh.vertices)[1][mesh.faces])
    one, other = edges.faces[edges.uses == 2].T
    count = len(mesh.faces)
    joined = coo_array((np.ones(len(one)), (one, other)), shape=(count, count))
    return Surface(
        open_edges=int((edges.uses == 1).sum()),
        nonmanifold_edges=int((edges.uses > 2).sum()),
        components=int(connected_components(joined, directed=False)[0]),
    )
