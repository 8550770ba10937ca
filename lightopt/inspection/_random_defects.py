"""Random defects for testing: places drawn evenly by area where an image shows the whole defect; the part file of them.

That file is the part's own text with a list at its end.
"""

import json
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.config import PartConfig, RigConfig, copied_text, input_hashes, with_list
from lightopt.core.arrays import Bool, Int32
from lightopt.core.errors import InputError, counted, refuse
from lightopt.core.provenance import provenance
from lightopt.core.run_context import RunContext
from lightopt.defects import CatalogueEntry, PlacedDefect, radial_place, surface_coordinates, tangent_direction
from lightopt.geometry import SurfaceFinder, face_areas, surface_place
from lightopt.rendering import PosturePixels, cast_rays_at, trace_pixels
from lightopt.scene import Scene, build_catalogue, build_scene, pixel_footprint, project

TRIES = 48  # places that are tried for each defect in a round
ROUNDS = 8  # rounds of tries for the defects that are not placed yet
MOST_DEFECTS = 500  # as many as a part file may name
GAP = 0.25  # between the circles around two defects there is at least this share of their radii
MARGIN_PX = 2.0  # so much around the outline of a defect must be visible, too

# the surface bends by no more than this over a defect: beyond, the tangent plane is a poor approximation
LEAST_COSINE = math.cos(math.radians(30.0))

NEAR_PX = 4.0  # a place is the one that a pixel sees where they are no further apart than this
_POSITION_DIGITS = 4
_ANGLE_DIGITS = 1
_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_PROVENANCE = "provenance: "


@dataclass(frozen=True, eq=False)
class RandomDefect:
    name: str
    entry: CatalogueEntry  # the kind of the catalogue
    at_mm: tuple[float, float, float]  # centre in the mesh file's coordinates [mm]
    direction_deg: float  # of its length, as part files count it [°]
    placed: PlacedDefect  # the defect in the part frame


def place_random_defects(
    rig: RigConfig, part: PartConfig, *, count: int, seed: int, run: RunContext | None = None
) -> tuple[RandomDefect, ...]:
    """Place random defects on the surface that the camera sees in at least one of the part's postures.

    The entries of the part's catalogue, or of the built-in one, follow each other in order; sizes and slopes are drawn
    evenly by their logarithm from an entry's ranges. Places are drawn evenly by area and directions evenly all around;
    a place is used where the defect is seen whole in one posture, off silhouettes, creases and grazing views, and apart
    from those before it. The same files, count and seed give the same defects.

    rig, part: The part's own defects do not matter.
    count: Number of defects, 1 to 500.
    seed: Of the random numbers, 0 or more.
    Raises InputError: whatever is wrong with the files; a count or seed out of range; no room for so many defects.
    """
    problems: list[str] = []
    if not 1 <= count <= MOST_DEFECTS:
        problems.append(f"count: expected 1 to {MOST_DEFECTS} defects, found {count}")
    if seed < 0:
        problems.append(f"seed: expected 0 or more, found {seed}")
    refuse(problems)
    catalogue = build_catalogue(part)
    scene = build_scene(rig, part, defects=False)
    within = np.random.default_rng([seed, 1]).random((count, 2)).tolist()
    kinds = [catalogue[slot % len(catalogue)].at(*within[slot]) for slot in range(count)]
    rng = np.random.default_rng(seed)
    chosen: dict[int, RandomDefect] = {}
    threads = None if run is None else run.threads
    for _ in range(ROUNDS):
        waiting = [slot for slot in range(count) if slot not in chosen]
        if not waiting:
            break
        candidates = _draw(scene, [kinds[slot] for slot in waiting], rng)
        for number, fits in enumerate(_fit(scene, candidates, threads)):
            # each defect takes the first of its places that is apart from those taken
            slot, one = waiting[number // TRIES], candidates[number]
            if fits and slot not in chosen and not any(_overlap(one.placed, o.placed) for o in chosen.values()):
                chosen[slot] = one
    if lost := [entry.name for slot, entry in enumerate(kinds) if slot not in chosen]:
        raise InputError(
            f"{part.source.path}: room for {count - len(lost)} of {counted(count, 'defect')}, each seen whole in a "
            f"posture and apart from the others, was found in {TRIES * ROUNDS} tries each; none for "
            f"{', '.join(dict.fromkeys(lost))}; place fewer, or give the part a defect_catalogue with smaller ones"
        )
    numbers: Counter[str] = Counter()
    result: list[RandomDefect] = []
    for slot, entry in enumerate(kinds):
        numbers[entry.name] += 1
        result.append(replace(chosen[slot], name=f"{entry.name[:190]}-{numbers[entry.name]}"))
    return tuple(result)


def place_in_image(
    scene: Scene, kind: CatalogueEntry, pixels: PosturePixels, others: Sequence[PlacedDefect], rng: np.random.Generator
) -> PlacedDefect | None:
    """Place one random defect as :func:`place_random_defects` does, where one image shows it whole.

    others: That it must be apart from.
    Returns None where none of :data:`TRIES` places will do.
    """
    index = _pixel_numbers(pixels)
    for one in _draw(scene, [kind], rng):
        if _is_visible(one.placed, pixels, index) and not any(_overlap(one.placed, other) for other in others):
            return one.placed
    return None


def _pixel_numbers(pixels: PosturePixels) -> Int32:
    # the number of each pixel of the image among `pixels`, or −1
    index = np.full(pixels.shape, -1, np.int32)
    index[pixels.row, pixels.column] = np.arange(len(pixels.row), dtype=np.int32)
    return index


def _draw(scene: Scene, kinds: list[CatalogueEntry], rng: np.random.Generator) -> list[RandomDefect]:
    # of each kind as many as are tried; all random numbers are drawn whatever becomes of them
    total = len(kinds) * TRIES
    cumulative = np.cumsum(face_areas(scene.mesh))
    faces = np.searchsorted(cumulative, rng.random(total) * cumulative[-1], side="right")
    # evenly over a triangle: a parallelogram folded at its diagonal
    u, v = rng.random(total), rng.random(total)
    beyond = u + v > 1.0
    u, v = np.where(beyond, 1.0 - u, u), np.where(beyond, 1.0 - v, v)
    directions = np.round(rng.random(total) * 360.0, _ANGLE_DIGITS) % 360.0
    axes = {"x_axis": scene.placement.rotation[:, 0], "y_axis": scene.placement.rotation[:, 1]}
    candidates: list[RandomDefect] = []
    for i in range(total):
        kind, direction = kinds[i // TRIES], float(directions[i])
        place = surface_place(scene.mesh, int(faces[i]), float(u[i]), float(v[i]))
        # the file's digits are what a later reader has
        x, y, z = (np.round(scene.placement.to_file(place.point), _POSITION_DIGITS) + 0.0).tolist()
        along = tangent_direction(place.normal, math.radians(direction), **axes)
        defect = PlacedDefect(name=kind.name, shape=kind.shape, position=place.point, normal=place.normal, along=along)
        candidates.append(RandomDefect(kind.name, kind, (x, y, z), direction_deg=direction, placed=defect))
    return candidates


def _fit(scene: Scene, candidates: list[RandomDefect], threads: int | None) -> Bool:
    # which of them an image shows whole; one posture at a time, so that the memory does not grow with their number
    fits = np.zeros(len(candidates), np.bool_)
    caster = cast_rays_at(scene)
    for posture in scene.postures:
        pixels = trace_pixels(scene, posture, caster, threads=threads)
        index = _pixel_numbers(pixels)
        for i in np.flatnonzero(~fits):
            fits[i] = _is_visible(candidates[i].placed, pixels, index)
    # a place that a later reader would take for another, on the other side of an edge, is no place
    finder = SurfaceFinder(scene.mesh)
    for i in np.flatnonzero(fits):
        again = finder.nearest(scene.placement.to_part(np.array(candidates[i].at_mm)))
        fits[i] = again.normal @ candidates[i].placed.normal > 1.0 - 1e-4
    return fits


def _overlap(one: PlacedDefect, other: PlacedDefect) -> bool:
    radii = 0.5 * (one.shape.length + other.shape.length)
    return float(np.linalg.norm(one.position - other.position)) < (1.0 + GAP) * radii


def _is_visible(defect: PlacedDefect, pixels: PosturePixels, index: Int32) -> bool:
    # whether an image shows all of a defect and a margin around it, off silhouettes, creases and grazing views; `index`
    # has the number of each pixel among `pixels`, or −1
    camera, surface = pixels.view.camera, pixels.surface
    columns, rows, depth = project(camera, defect.position[None])
    if not depth[0] > 0.0 or not (np.isfinite(columns[0]) and np.isfinite(rows[0])):
        return False
    footprint = pixel_footprint(camera, float(depth[0]))
    column, row = math.floor(columns[0]), math.floor(rows[0])
    half = math.ceil(defect.reach / footprint + 2.0 * MARGIN_PX)
    height, width = pixels.shape
    if column < half or row < half or column + half >= width or row + half >= height:
        return False
    centre = index[row, column]
    if centre < 0 or not pixels.clean[centre]:
        return False
    if np.linalg.norm(surface.points[centre] - defect.position) > NEAR_PX * footprint:
        return False
    window = index[row - half : row + half + 1, column - half : column + half + 1]
    near = window[window >= 0]
    x, y, same = surface_coordinates(defect, surface.points[near], surface.normals[near])
    margin = 2.0 * MARGIN_PX * footprint
    wider = replace(defect.shape, length=defect.shape.length + margin, width=defect.shape.width + margin)
    own = near[same & (radial_place(wider, x, y) < 1.0)]
    return bool(len(own) and pixels.clean[own].all() and (surface.normals[own] @ defect.normal >= LEAST_COSINE).all())


def random_defect_provenance(rig: RigConfig, part: PartConfig, *, count: int, seed: int) -> dict[str, Any]:
    """What random defects depend on, in the layout of :mod:`lightopt.core.provenance`."""
    return provenance(input_hashes(rig, part), {"seed": seed, "count": count})


def random_defects_text(
    part: PartConfig, defects: Sequence[RandomDefect], *, folder: Path, comment: str, made_from: Mapping[str, Any]
) -> str:
    """Text of a part file with defects: the part's own text with comments, and the list at its end.

    part: Read from a file that names no defects.
    folder: That the text will lie in: the mesh is named relative to it.
    comment: Of the list.
    made_from: From :func:`random_defect_provenance`: a second line of comment, as JSON.
    Raises InputError: the part file lists defects already, or its file is written so that nothing can be added to it.
    """
    if ("defects",) in part.source.lines:
        raise InputError(
            f"{part.source.at('defects')}: this part file lists defects already; remove the list, or use that "
            "of the good part"
        )
    text = copied_text(part, folder)
    comment = f"{comment}\n{_PROVENANCE}{json.dumps(made_from, ensure_ascii=False)}"
    return with_list(text, "defects", [_entry(defect) for defect in defects], comment=comment)


def _entry(defect: RandomDefect) -> str:
    shape = defect.entry.shape
    name = defect.name if _PLAIN.fullmatch(defect.name) else json.dumps(defect.name, ensure_ascii=False)
    size = f"{shape.length:g}" if shape.length == shape.width else f"[{shape.length:g}, {shape.width:g}]"
    place = ", ".join(f"{x:.4f}" for x in defect.at_mm)
    values = [f"name: {name}", f"kind: {shape.kind}", f"at_mm: [{place}]", f"size_mm: {size}"]
    if shape.slope > 0.0:
        values.append(f"slope_deg: {math.degrees(shape.slope):.6g}")
    if shape.kind == "stain":
        values.append(f"R_d_factor: {shape.R_d_factor:.6g}")
    if shape.kind == "haze":
        values.append(f"sigma_factor: {shape.sigma_factor:.6g}")
    if shape.length != shape.width:
        values.append(f"direction_deg: {defect.direction_deg:g}")
    return f"{{{', '.join(values)}}}"
