"""The part: its size and unit, its mesh, surface that no camera ray reaches, and its regions."""

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
    text = f"{counted(len(mesh.faces), 'triangle')}, a closed surface"
    if open_edges or tangled:
        text = f"{counted(len(mesh.faces), 'triangle')}, not a closed surface: {counted(open_edges, 'edge')} of one "
        text += f"triangle only, {counted(tangled, 'edge')} of three or more. It renders as it is, backs of faces black"
    yield Finding("note" if open_edges or tangled else "ok", "mesh", text, where, values)


def check_back_faces(checked: CheckedScene) -> Iterator[Finding]:
    """How much of the part's image shows backs of faces, which are black."""
    for sample in checked.samples:
        back = int(np.count_nonzero(~sample.surface.front))
        if back <= BACK_FACE_SHARE * len(sample.surface):
            continue
        pixels = back * sample.step**2
        share = back / len(sample.surface)
        text = f"about {pixels:,} px ({percent(share)} of the part's image) show the back of faces and will be black; "
        text += "close the surface, give it a thickness, or turn its faces outwards"
        yield checked.of_posture(sample, "warning", "back faces", text, pixels=pixels, share=share)


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
    if unseen == 0.0:
        text = f"the camera sees all of the part's {total:.4g} mm²"
        yield Finding("ok", "unseen surface", text, where, values)
        return
    text = f"the camera does not see {unseen:.4g} mm² in any posture, {percent(unseen / total)} of the part's "
    text += f"{total:.4g} mm²"
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
    text += f"; of the upper side {unseen_top:.4g} mm², {percent(share)}, {facing(mean / unseen_top)}, within {box} mm"
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


_WITHOUT_DIRECTION = 0.1  # share of a brushed surface from which on a direction along its normal is worth a warning


def check_regions(checked: CheckedScene) -> Iterator[Finding]:
    """Area of each region, and its share of the pixels that show the part; nothing for a part without regions."""
    material, regions = checked.scene.mesh.material, checked.scene.regions
    if material is None:
        return
    area = np.bincount(material, geometry.face_areas(checked.scene.mesh), len(regions) + 1)
    pixels = np.zeros(len(regions) + 1)
    for sample in checked.samples:
        seen = sample.surface.material
        assert seen is not None
        pixels += sample.step**2 * np.bincount(seen[sample.surface.front], minlength=len(pixels))
    shares = pixels / max(float(pixels.sum()), 1.0)
    names = ["outside the regions", *(region.name for region in regions)]
    texts = [
        f"{name} {own:.4g} mm² ({percent(own / area.sum())}), {percent(share)} of the pixels"
        for name, own, share in zip(names, area.tolist(), shares.tolist(), strict=True)
    ]
    text = "of the surface, and of the pixels that show it in all postures: " + "; ".join((*texts[1:], texts[0]))
    where, values = checked.part.source.at("regions"), dict(zip(names, shares.tolist(), strict=True))
    yield Finding("ok", "regions", text, where, values)
    if area[0] == 0.0:
        text = "no surface is outside the regions: the part's own reflectance is not used"
        yield Finding("note", "regions", text, checked.part.source.at("reflectance"))
    for number, region in enumerate(regions):
        if not pixels[number + 1]:
            text = f"the camera does not see {region.name}: check where the region is, or add postures that show it"
            yield Finding("warning", "regions", text, checked.part.source.at("regions", number))


def check_brushing(checked: CheckedScene) -> Iterator[Finding]:
    """How much of a brushed surface in view has no direction: brushing along its normal, or no place in the texture."""
    for number, own in enumerate(checked.scene.reflectances):
        if own.model.across_ratio == 1.0:
            continue
        pixels = without = 0
        for sample in checked.samples:
            surface = sample.surface
            assert surface.across is not None
            seen = surface.front if surface.material is None else surface.front & (surface.material == number)
            pixels += int(seen.sum())
            without += int(np.sum(seen & ~surface.across.any(axis=1)))
        if not pixels:
            continue
        share, keys = without / pixels, ("reflectance",) if number == 0 else ("regions", number - 1, "reflectance")
        text = f"the lobe is {own.model.across_ratio:.3g} times as wide across the brushing; it has a direction on "
        text += f"{percent(1.0 - share)} of this surface in view"
        if share > _WITHOUT_DIRECTION:
            by_texture = isinstance(checked.scene.mesh.brushing[number], geometry.TextureBrushing)
            along = "it is along the normal: directions are in the mesh file's coordinates"
            text += f"; on the rest {'the texture coordinates have none' if by_texture else along}"
        kind = "warning" if share > _WITHOUT_DIRECTION else "ok"
        yield Finding(kind, "brushing", text, checked.part.source.at(*keys, "brushing"), {"share": 1.0 - share})
