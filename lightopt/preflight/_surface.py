"""The mesh as such: what was repaired, whether it is closed, whether its back shows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lightopt.core.errors import counted
from lightopt.geometry import merge_rows, mesh_edges
from lightopt.preflight._report import Finding, percent
from lightopt.preflight._subject import SceneSubject

SILHOUETTE_SHARE = 1e-4
"""Share of the part's pixels that may see back faces without a warning: rays that graze the silhouette of a closed mesh
may slip through between two faces."""


def check_mesh(subject: SceneSubject) -> Iterator[Finding]:
    """Repairs made while loading, and edges that belong to one face only or to more than two."""
    where = subject.part.source.at("mesh", "file")
    # whether the part leaves the view is a check of its own
    framing = tuple(f"posture {posture}: " for posture in subject.scene.postures)
    for text in subject.scene.warnings:
        if not text.startswith(framing):
            yield Finding("warning", "mesh", text, where)
    mesh = subject.scene.mesh
    found = mesh_edges(merge_rows(mesh.vertices)[1][mesh.faces])
    open_edges = int(np.count_nonzero(found.uses == 1))
    tangled = int(np.count_nonzero(found.uses > 2))
    values = {"triangles": len(mesh.faces), "open_edges": open_edges, "nonmanifold_edges": tangled}
    text = counted(len(mesh.faces), "triangle")
    if not open_edges and not tangled:
        yield Finding("ok", "mesh", f"{text}, a closed surface", where, values)
        return
    kinds: list[str] = []
    if open_edges:
        kinds.append(
            f"{counted(open_edges, 'edge')} of one triangle only (backs of faces are black where they show)"
        )
    if tangled:
        kinds.append(f"{counted(tangled, 'edge')} shared by three or more triangles")
    told = f"{text}, not a closed surface: {' and '.join(kinds)}. It renders as it is"
    yield Finding("note", "mesh", told, where, values)


def check_back_faces(subject: SceneSubject) -> Iterator[Finding]:
    """How much of the part's image shows backs of faces, which are black."""
    for index, look in enumerate(subject.looks):
        back = int(np.count_nonzero(~look.surface.front))
        if back <= SILHOUETTE_SHARE * len(look.surface):
            continue
        pixels = back * look.step**2
        share = back / len(look.surface)
        yield Finding(
            "warning",
            "back faces",
            f"posture {look.posture}: about {pixels:,} px ({percent(share)} of the part's image) show the back of "
            "faces and will be black; close the surface, give it a thickness, or turn its faces outwards",
            subject.at_posture(index),
            {"posture": look.posture.as_dict(), "pixels": pixels, "share": share},
        )
