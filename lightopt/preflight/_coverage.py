"""The surface that no camera ray reaches in any posture."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lightopt.geometry import Patches, TriangleMesh, estimate_patch_count, face_areas, face_normals, refine
from lightopt.preflight._report import Finding, Level, percent
from lightopt.preflight._subject import SceneSubject
from lightopt.rendering import visible_points

BUDGET = 200_000
"""Patches that are looked at; a mesh with more triangles is taken as it is."""

WORTH_A_WARNING = 0.01
"""Share of the upper side that is unseen."""

UPPER = math.sin(math.radians(5.0))
"""A patch belongs to the upper side from this Z component of its normal on: not the vertical walls."""

_SOME = 0.38


def check_unseen_surface(subject: SceneSubject) -> Iterator[Finding]:
    """Area of the surface that the camera sees in no posture, of the upper side and of all, and where it is."""
    mesh = subject.scene.mesh
    patches = _patches(mesh)
    normals = face_normals(mesh)[patches.face]
    seen = np.zeros(len(patches), np.bool_)
    for look in subject.looks:
        seen |= visible_points(patches.centroids, normals, look.view, subject.caster)
    upper = normals[:, 2] > UPPER
    total, top = float(patches.areas.sum()), float(patches.areas[upper].sum())
    unseen = float(patches.areas[~seen].sum())
    unseen_top = float(patches.areas[~seen & upper].sum())
    values: dict[str, object] = {
        "area_mm2": total,
        "unseen_mm2": unseen,
        "unseen_share": unseen / total,
        "upper_mm2": top,
        "unseen_upper_mm2": unseen_top,
        "unseen_upper_share": unseen_top / top if top > 0.0 else 0.0,
    }
    where = subject.part.source.at("postures")
    many = len(subject.looks)
    in_any = "in the only posture" if many == 1 else f"in any of the {many} postures"
    if unseen == 0.0:
        yield Finding(
            "ok", "unseen surface", f"the camera sees all of the part's {total:.4g} mm²", where, values
        )
        return
    text = (
        f"the camera does not see {unseen:.4g} mm² {in_any}, {percent(unseen / total)} of the part's "
        f"{total:.4g} mm²"
    )
    if unseen_top == 0.0:
        yield Finding("ok", "unseen surface", f"{text}, none of it on the upper side", where, values)
        return
    share = unseen_top / top
    which = ~seen & upper
    mean = patches.areas[which] @ normals[which]
    corners = patches.corners[which].reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    values["unseen_upper_box_mm"] = [low.tolist(), high.tolist()]
    box = ", ".join(f"{axis} {a:.3g} to {b:.3g}" for axis, a, b in zip("XYZ", low, high, strict=True))
    text += (
        f"; of the upper side it is {unseen_top:.4g} mm² or {percent(share)}, {facing(mean / unseen_top)}, "
        f"within {box} mm in posture (0°, 0°)"
    )
    level: Level = "warning" if share > WORTH_A_WARNING else "note"
    if level == "warning":
        text += ". Add postures that turn it to the camera"
    yield Finding(level, "unseen surface", text, where, values)


def facing(mean: NDArray[np.float64]) -> str:
    """The direction of a mean normal in words.

    Parameters
    ----------
    mean
        Area-weighted mean of unit normals, world frame at posture (0, 0), shape (3,); short where they point all ways.

    Examples
    --------
    >>> facing(np.array([0.7, 0.0, 0.6]))
    'facing +X and up'
    """
    words = [
        name
        for value, (plus, minus) in zip(
            mean.tolist(), (("+X", "−X"), ("+Y", "−Y"), ("up", "down")), strict=True
        )
        for name, sign in ((plus, 1.0), (minus, -1.0))
        if sign * value > _SOME
    ]
    return f"facing {' and '.join(words)}" if words else "facing several ways"


def _patches(mesh: TriangleMesh) -> Patches:
    # equilateral patches of this edge would be half of the budget; bisection makes up to twice as many
    edge = math.sqrt(4.0 / math.sqrt(3.0) * 2.0 * float(face_areas(mesh).sum()) / BUDGET)
    most = max(BUDGET, len(mesh.faces))
    while estimate_patch_count(mesh, edge, limit=most + 1) > most:
        edge *= 1.3
    return refine(mesh, max_edge_mm=edge, max_patches=most)
