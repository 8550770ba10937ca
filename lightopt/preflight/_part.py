"""The mesh: its size and unit, repairs, back faces, and the surface that no camera ray reaches."""

import math
from collections.abc import Iterator

import numpy as np

from lightopt import geometry
from lightopt.core.arrays import Float64
from lightopt.core.errors import counted
from lightopt.preflight._findings import CheckedScene, Finding, Level, percent
from lightopt.rendering import BACK_FACE_SHARE, visible_points
from lightopt.scene import guess_unit, is_absurd, view_size


def check_size(checked: CheckedScene) -> Iterator[Finding]:
    """Size of the part, and what other units of its file would make of it."""
    low, high = checked.scene.mesh.bounds
    sides = [float(side) for side in high - low]
    where = checked.part.source.at("mesh", "units")
    values = {"size_mm": sides}
    size = view_size(checked.scene.camera)
    text = f"{' × '.join(f'{side:.4g}' for side in sides)} mm"
    if size is None:
        yield Finding("ok", "size", text, where, values)
        return
    longest, view = max(sides), min(size)
    share = longest / view
    absurd = is_absurd(longest, view)
    times = f"{share:.3g} times the length" if absurd and share > 1.0 else percent(share)
    text += f", {times} of the view's shorter side of {view:.4g} mm"
    guess = guess_unit(checked.part, longest, view)
    if guess is not None:
        values = {**values, "unit": guess.unit, "likely_units": list(guess.likely)}
        text += f": {guess.text}"
    elif absurd:
        text += f": very {'small' if longest < view else 'large'} for this camera"
    yield Finding("warning" if absurd else "ok", "size", text, where, values)


def check_mesh(checked: CheckedScene) -> Iterator[Finding]:
    """Repairs made while loading, and edges that belong to one face only or to more than two."""
    where = checked.part.source.at("mesh", "file")
    # whether the part leaves the view is a check of its own
    framing = tuple(f"posture {posture}: " for posture in checked.scene.postures)
    for text in checked.scene.warnings:
        if not text.startswith(framing):
            yield Finding("warning", "mesh", text, where)
    mesh = checked.scene.mesh
    found = geometry.mesh_edges(geometry.merge_rows(mesh.vertices)[1][mesh.faces])
    open_edges = int(np.count_nonzero(found.uses == 1))
    tangled = int(np.count_nonzero(found.uses > 2))
    values = {"triangles": len(mesh.faces), "open_edges": open_edges, "nonmanifold_edges": tangled}
    text = counted(len(mesh.faces), "triangle")
    if not open_edges and not tangled:
        yield Finding("ok", "mesh", f"{text}, a closed surface", where, values)
        return
    kinds: list[str] = []
    if open_edges:
        kinds.append(f"{counted(open_edges, 'edge')} of one triangle only (backs of faces are black where they show)")
    if tangled:
        kinds.append(f"{counted(tangled, 'edge')} shared by three or more triangles")
    text += f", not a closed surface: {' and '.join(kinds)}. It renders as it is"
    yield Finding("note", "mesh", text, where, values)


def check_back_faces(checked: CheckedScene) -> Iterator[Finding]:
    """How much of the part's image shows backs of faces, which are black."""
    for index, sample in enumerate(checked.samples):
        back = int(np.count_nonzero(~sample.surface.front))
        if back <= BACK_FACE_SHARE * len(sample.surface):
            continue
        pixels = back * sample.step**2
        share = back / len(sample.surface)
        text = (
            f"posture {sample.posture}: about {pixels:,} px ({percent(share)} of the part's image) show the back of "
            "faces and will be black; close the surface, give it a thickness, or turn its faces outwards"
        )
        values = {"posture": sample.posture.as_dict(), "pixels": pixels, "share": share}
        yield Finding("warning", "back faces", text, checked.at_posture(index), values)


BUDGET = 200_000  # patches that are checked; a mesh with more triangles is checked triangle by triangle
WARNING_SHARE = 0.01  # share of the upper side that is unseen

# a patch belongs to the upper side from this Z component of its normal on: not the vertical walls
UPPER = math.sin(math.radians(5.0))

# a mean normal faces along an axis if its component is at least this: short means point all ways
_CLEAR_COMPONENT = 0.38


def check_unseen_surface(checked: CheckedScene) -> Iterator[Finding]:
    """Area of the surface that the camera sees in no posture, of the upper side and of all, and where it is."""
    mesh = checked.scene.mesh
    # equilateral patches of this edge would be half of the budget; bisection makes up to twice as many
    edge = math.sqrt(4.0 / math.sqrt(3.0) * 2.0 * float(geometry.face_areas(mesh).sum()) / BUDGET)
    most = max(BUDGET, len(mesh.faces))
    while geometry.estimate_patch_count(mesh, edge, limit=most + 1) > most:
        edge *= 1.3
    patches = geometry.refine(mesh, max_edge_mm=edge, max_patches=most)
    normals = geometry.face_normals(mesh)[patches.face]
    seen = np.zeros(len(patches), np.bool_)
    for sample in checked.samples:
        seen |= visible_points(patches.centroids, normals, sample.view, checked.caster)
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
    where = checked.part.source.at("postures")
    many = len(checked.samples)
    in_any = "in the only posture" if many == 1 else f"in any of the {many} postures"
    if unseen == 0.0:
        text = f"the camera sees all of the part's {total:.4g} mm²"
        yield Finding("ok", "unseen surface", text, where, values)
        return
    text = f"the camera does not see {unseen:.4g} mm² {in_any}, {percent(unseen / total)} of the part's {total:.4g} mm²"
    if unseen_top == 0.0:
        yield Finding("ok", "unseen surface", f"{text}, none of it on the upper side", where, values)
        return
    share = unseen_top / top
    which = ~seen & upper
    mean = patches.areas[which] @ normals[which]
    corners = patches.vertices[patches.triangles[which]].reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    values["unseen_upper_box_mm"] = [low.tolist(), high.tolist()]
    box = ", ".join(f"{axis} {a:.3g} to {b:.3g}" for axis, a, b in zip("XYZ", low, high, strict=True))
    text += (
        f"; of the upper side it is {unseen_top:.4g} mm² or {percent(share)}, {facing(mean / unseen_top)}, "
        f"within {box} mm in posture (0°, 0°)"
    )
    level: Level = "warning" if share > WARNING_SHARE else "note"
    if level == "warning":
        text += ". Add postures that turn it to the camera"
    yield Finding(level, "unseen surface", text, where, values)


def facing(mean: Float64) -> str:
    """Text for the direction of an area-weighted mean of unit normals; world frame at posture (0, 0), shape (3,).

    >>> facing(np.array([0.7, 0.0, 0.6]))
    'facing +X and up'
    """
    directions = (("+X", "−X"), ("+Y", "−Y"), ("up", "down"))
    words = [
        plus if value > 0.0 else minus
        for value, (plus, minus) in zip(mean.tolist(), directions, strict=True)
        if abs(value) > _CLEAR_COMPONENT
    ]
    return f"facing {' and '.join(words)}" if words else "facing several ways"
