"""Defects as displaced geometry against defects as normals: difference of the images, and of what ``inspect`` finds.

``python -m benchmarks.displaced [--seeds N] [--page]``. Lights are optimised and random defects are placed as in
``benchmarks.loop``. Each set of defects is rendered twice:

*model*: as the program does it: the surface stays, and its normals turn.
*displaced*: the mesh is refined under the defects and moved along its normals by the height of the profile. Rays then
make parallax, cast shadows and hidden walls.

The refined mesh without displacement is the control: its difference from the good part is the floor of the comparison.
Profiles are rendered as in the catalogue and with other slopes.
"""

from __future__ import annotations

import argparse
import itertools
import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from benchmarks._case import write_records
from benchmarks.inspection import FIRST, replace_block
from benchmarks.loop import OFF_MM, PARTS, files, run_command
from lightopt import build_scene, load_part, load_rig
from lightopt.config import PartConfig, RigConfig
from lightopt.core.arrays import Bool, Float32, Float64, Index
from lightopt.defects import (
    BUILT_IN_CATALOGUE,
    MOST_CHANGE,
    SHAPE_KINDS,
    DefectShape,
    PlacedDefect,
    mark_surface,
    radial_place,
    surface_coordinates,
)
from lightopt.geometry import TriangleMesh
from lightopt.images import ImageEntry, ImageSet, ImageSetWriter, read_image_set
from lightopt.inspection import InspectOptions, PredictionCache, evaluate_set, inspect_set
from lightopt.optics import expose, image_rng
from lightopt.rendering import PostureImages, cast_rays_at, render_posture, set_manifest
from lightopt.scene import Scene, move_part, pixel_footprint, place_defects, project

FACTORS = (0.5, 1.0, 2.0, 4.0)
"""Of the walls' tangents; 4 makes 55° of the pit's 20°."""
MIN_IMAGES = (1, 2)
FACETS_ACROSS = 30
"""A defect's width is so many edges of the refined mesh, or more."""
FACETS_PER_PIXEL = 3
RING_PX = 6.0
"""Pixels so near to an outline count as just outside."""
SEEN = 0.1
"""A difference of so many standard deviations of the noise is one."""
SLACK_MM = 0.01
"""Of bounds for a plane surface, on curved ones."""
HIDING = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, math.inf)
"""Bounds of the groups by :attr:`Difference.hiding`."""

WIDE, LEAST_PARALLAX_PX = ("dent", "bump", "blister"), 0.05
"""Kinds that are many pixels wide, so that a shift of their image can be measured, and from which parallax on."""


def relative_height(shape: DefectShape, rho: Float64) -> Float64:
    """Height or depth at ρ in units of tan(slope)·width/2: the integral of the relative slope from ρ to the outline."""
    rho = np.minimum(rho, 1.0)
    if shape.kind in ("dent", "bump", "blister"):
        top = 0.6 if shape.kind == "blister" else 0.0
        rest = 1.0 - top
        return rest / math.pi * (1.0 + np.cos(math.pi * np.maximum(rho - top, 0.0) / rest))
    rim, wall, tip = np.maximum(rho, 0.8), np.clip(rho, 0.2, 0.8), np.minimum(rho, 0.2)
    return (1.0 - rim) ** 2 / 0.4 + (0.8 - wall) + (0.04 - tip**2) / 0.4


def heights(defects: Sequence[PlacedDefect], points: Float64, normals: Float64) -> Float64:
    """Height of the disturbed surface above points of the undisturbed one [mm], shape (k,)."""
    total = np.zeros(len(points))
    for defect in defects:
        near = np.flatnonzero(np.linalg.norm(points - defect.position, axis=1) <= defect.reach)
        x, y, same = surface_coordinates(defect, points[near], normals[near])
        shape = defect.shape
        scale = _sign(shape) * math.tan(shape.slope) * 0.5 * shape.width
        total[near] += np.where(same, scale * relative_height(shape, radial_place(shape, x, y)), 0.0)
    return total


def _is_hill(kind: str) -> bool:
    return kind in ("bump", "blister")


def _sign(shape: DefectShape) -> float:
    return 1.0 if _is_hill(shape.kind) else -1.0


def refined(mesh: TriangleMesh, defects: Sequence[PlacedDefect], pixel: float) -> TriangleMesh:
    """The same surface with small triangles under defects: edges of a third of a pixel or a share of their width.

    Triangles are cut at the middle of their longest edge. Normals are interpolated as shading does it.
    """
    assert mesh.normals is not None
    vertices, normals, faces = mesh.vertices, mesh.normals, mesh.faces.astype(np.int64)
    for defect in defects:
        edge = min(pixel / FACETS_PER_PIXEL, defect.shape.width / FACETS_ACROSS)
        done: list[np.ndarray] = []
        while len(faces):
            corners = vertices[faces]
            sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
            cut = (sides.max(axis=1) > edge) & _under(defect, corners, edge)
            done.append(faces[~cut])
            first = sides[cut].argmax(axis=1)
            a, b, c = (faces[cut][np.arange(len(first)), (first + k) % 3] for k in range(3))
            pairs, which = np.unique(np.sort(np.stack([a, b], axis=1), axis=1), axis=0, return_inverse=True)
            middle = len(vertices) + which.ravel()
            vertices = np.concatenate([vertices, vertices[pairs].mean(axis=1)])
            # not of unit length yet: the interpolated normal has to be that of the whole triangle
            normals = np.concatenate([normals, normals[pairs].mean(axis=1)])
            faces = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        faces = np.concatenate(done)
    return TriangleMesh(vertices, faces.astype(np.int32), normals / np.linalg.norm(normals, axis=1)[:, None])


def _under(defect: PlacedDefect, corners: Float64, margin: float) -> Bool:
    # triangles that may reach into the outline widened by the margin
    centroid = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centroid[:, None], axis=2).max(axis=1)
    offset = centroid - defect.position
    near = np.linalg.norm(offset, axis=1) <= defect.reach + margin + radius
    return near & (_beyond(defect, offset) <= margin + radius)


def _beyond(defect: PlacedDefect, offset: Float64) -> Float64:
    # how far from the outline of a round defect or a scratch, in its tangent plane [mm]; negative inside
    shape = defect.shape
    x, y = offset @ defect.along, offset @ defect.across
    half = 0.5 * (shape.length - shape.width)
    return np.hypot(x - np.clip(x, -half, half), y) - 0.5 * shape.width


def displaced(mesh: TriangleMesh, defects: Sequence[PlacedDefect]) -> TriangleMesh:
    """A mesh moved by the heights of defects, with the normals of the disturbed surface."""
    assert mesh.normals is not None
    marks = mark_surface(defects, mesh.vertices, mesh.normals)
    assert marks is not None
    normals = mesh.normals.copy()
    normals[marks.index] = marks.normals
    height = heights(defects, mesh.vertices, mesh.normals)
    return TriangleMesh(mesh.vertices + height[:, None] * mesh.normals, mesh.faces, normals)


def steeper(defect: PlacedDefect, factor: float) -> PlacedDefect:
    """The defect with the tangent of its walls times a factor, and so its depth."""
    slope = math.atan(factor * math.tan(defect.shape.slope))
    return replace(defect, shape=replace(defect.shape, slope=slope))


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Displaced against model for one defect under all lights; levels as the camera clips them, in units of its noise.

    signal: Root mean square of the change that the model makes inside the footprint
    inside_rms, inside_max, outside_rms, outside_max: Of the difference, in the footprint and in a ring around it
    floor_max: Greatest difference between the refined mesh without defects and the good part
    energy: Σ m² of the displaced defect over that of the model, m the change, at most 8
    correlation: Of the two changes m
    slope: Steepest of the walls [°]
    light_deg, view_deg: Least elevation of a light and of the camera above the undisturbed surface [°]
    reach: How far from its outline pixels differ, joined to the footprint, less the size of a pixel there [mm]
    reach_bound: From :func:`reach_bound` [mm]
    shift: Of the displaced image against the model, along the image of the normal, by least squares [px]
    parallax: Of the deepest or highest place, likewise [px]
    found_model, found_displaced: Whether ``inspect`` finds it, one for each of :data:`MIN_IMAGES`; None if not judged
    """

    name: str
    kind: str
    signal: float
    inside_rms: float
    inside_max: float
    outside_rms: float
    outside_max: float
    floor_max: float
    energy: float
    correlation: float
    slope: float
    light_deg: float
    view_deg: float
    reach: float
    reach_bound: float
    shift: float
    parallax: float
    part: str = ""
    seed: int = 0
    factor: float = 1.0
    found_model: tuple[bool | None, ...] = ()
    found_displaced: tuple[bool | None, ...] = ()

    @property
    def relative(self) -> float:
        """Difference inside over signal."""
        return self.inside_rms / self.signal

    @property
    def hiding(self) -> float:
        """Slope of the walls over that of the camera's view; from 1 on, walls hide surface."""
        return math.tan(math.radians(self.slope)) / math.tan(math.radians(max(self.view_deg, 0.1)))

    @property
    def above_bound(self) -> bool:
        """Whether it reaches further than its bound, by more than the bound is good to."""
        return self.reach > self.reach_bound + SLACK_MM


def reach_bound(shape: DefectShape, elevation: float) -> float:
    """How far a defect reaches beyond its outline, as shadow of a light or as seen by the camera [mm].

    A place at height z is projected by z/tan(elevation) along the surface. Nothing of a dent or a groove gets out, and
    nothing of a hill whose walls are less steep than the elevation.

    elevation: Of the light or the camera above the undisturbed surface [rad]
    """
    if not _is_hill(shape.kind):
        return 0.0
    rho = np.linspace(0.0, 1.0, 201)
    beyond = math.tan(shape.slope) / math.tan(elevation) * relative_height(shape, rho) - (1.0 - rho)
    return 0.5 * shape.width * max(0.0, float(beyond.max()))


class Comparison:
    """The pixels around the defects of a scene, and what the good part looks like there."""

    def __init__(self, scene: Scene, defects: Sequence[PlacedDefect], good: PostureImages, control: Float32) -> None:
        self.scene, self.defects = scene, defects
        self.good, self.control = levels(good), control
        sensor = scene.sensor
        self.scale = sensor.max_level / scene.reflectance.full_scale
        self.limit = sensor.saturated_from - sensor.black_level
        geometry = good.geometry
        self.row, self.column = np.nonzero(geometry.hit)
        self.points = geometry.points[self.row, self.column].astype(np.float64)
        self.normals = geometry.normals[self.row, self.column].astype(np.float64)
        self.pixel = pixel_footprint(scene.camera, float(geometry.distance[geometry.hit].mean()))
        # each pixel belongs to the defect whose outline is nearest
        self.owner = np.full(len(self.row), -1)
        self.beyond = np.full(len(self.row), np.inf)
        for number, defect in enumerate(defects):
            offset = self.points - defect.position
            _, _, same = surface_coordinates(defect, self.points, self.normals)
            own = _beyond(defect, offset)
            reach = defect.reach + 3.0 * RING_PX * self.pixel
            nearer = same & (np.linalg.norm(offset, axis=1) < reach) & (own < self.beyond)
            self.owner[nearer], self.beyond[nearer] = number, own[nearer]

    def differences(self, model: Float32, moved: Float32) -> Iterator[Difference]:
        """One for each defect that changes the image; `model` and `moved` are levels, shape (lights, height, width)."""
        change = self._clipped(model) - self._clipped(self.good)
        gradients = np.gradient(change, axis=1), np.gradient(change, axis=2)
        for number, defect in enumerate(self.defects):
            shape = defect.shape
            mine = np.flatnonzero(self.owner == number)
            good, control, one, other = (
                a[:, self.row[mine], self.column[mine]] for a in (self.good, self.control, model, moved)
            )
            footprint = (one != good).any(axis=0)
            good, control, one, other = map(self._clipped, (good, control, one, other))
            offsets = self.scene.camera.position - self.points[mine]
            view = np.einsum("ij,ij->i", offsets, self.normals[mine]) / np.linalg.norm(offsets, axis=1)
            size = self.pixel / np.maximum(view, 0.1)  # of a pixel on the surface
            ring = ~footprint & (self.beyond[mine] < RING_PX * size)
            if not footprint.any():
                continue
            noise = np.sqrt(self.scene.sensor.noise_variance(good))
            floor = (control - good) / noise
            off = (other - one) / noise - floor
            used = footprint | ring
            m_model, m_moved = (
                np.clip((b - a)[:, used] / noise[:, used], -MOST_CHANGE, MOST_CHANGE)
                for a, b in ((good, one), (control, other))
            )
            e_model, e_moved = float((m_model**2).sum()), float((m_moved**2).sum())
            if e_model == 0.0:
                continue
            lights, camera = self._elevations(mine[footprint], shape.slope), _elevation(view[footprint])
            around = (*self._elevations(mine[used], shape.slope), _elevation(view[used]))
            differs = self._joined(mine, footprint, ring & (np.abs(off) > SEEN).any(axis=0))
            along = self._image_of_normal(defect)
            down, right = (a[:, self.row[mine], self.column[mine]] / noise for a in gradients)
            slide = ((down * along[0] + right * along[1]) / np.linalg.norm(along))[:, footprint]
            reach = np.where(differs, self.beyond[mine] - size, 0.0)
            yield Difference(
                name=defect.name,
                kind=shape.kind,
                signal=_rms(((one - good) / noise)[:, footprint]),
                inside_rms=_rms(off[:, footprint]),
                inside_max=float(np.abs(off[:, footprint]).max()),
                outside_rms=_rms(off[:, ring]),
                outside_max=float(np.abs(off[:, ring]).max(initial=0.0)),
                floor_max=float(np.abs(floor[:, used]).max()),
                energy=e_moved / e_model,
                correlation=float((m_model * m_moved).sum()) / math.sqrt(max(e_model * e_moved, 1e-12)),
                slope=math.degrees(shape.slope),
                light_deg=math.degrees(min(lights, default=0.5 * math.pi)),
                view_deg=math.degrees(camera),
                reach=max(0.0, float(reach.max())),
                reach_bound=max(reach_bound(shape, max(e, 0.02)) for e in around),
                shift=-float((off[:, footprint] * slide).sum() / max(float((slide**2).sum()), 1e-12)),
                parallax=_sign(shape) * shape.depth * float(np.linalg.norm(along)),
            )

    def _clipped(self, level: Float32) -> Float64:
        return np.clip(self.scale * level.astype(np.float64), 0.0, self.limit)

    def _joined(self, pixels: Index, footprint: Bool, others: Bool) -> Bool:
        # the footprint and those of the other pixels that are joined to it: elsewhere the part's own shadows change
        image = np.zeros(self.good.shape[1:], np.bool_)
        row, column = self.row[pixels], self.column[pixels]
        image[row, column] = footprint | others
        label = np.asarray(ndimage.label(image, np.ones((3, 3)))[0])[row, column]  # pyright: ignore[reportIndexIssue]
        return (label > 0) & np.isin(label, label[footprint])

    def _image_of_normal(self, defect: PlacedDefect) -> Float64:
        # how many pixels down and to the right a millimetre of height is
        tip = defect.position + 0.1 * defect.normal
        column, row, _ = project(self.scene.camera, np.stack([defect.position, tip]))
        return np.array([row[1] - row[0], column[1] - column[0]]) / 0.1

    def _elevations(self, pixels: Index, slope: float) -> list[float]:
        # least of each light above the undisturbed surface of some pixels [rad]; no lights that no wall can face
        least: list[float] = []
        for light in self.scene.lights:
            offset = light.centre - self.points[pixels]
            sine = np.einsum("ij,ij->i", offset, self.normals[pixels]) / np.linalg.norm(offset, axis=1)
            if sine.max() > -math.sin(slope):
                least.append(_elevation(sine))
        return least


def _elevation(sines: Float64) -> float:
    return math.asin(min(max(float(sines.min()), 0.0), 1.0))


def _rms(values: Float64) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def levels(images: PostureImages) -> Float32:
    """Levels under all lights, shape (lights, height, width)."""
    return np.stack([image.level for image in images.lights])


def rendered(scene: Scene, *supersample: int) -> tuple[PostureImages, ...]:
    """Images of a scene in the first posture, one for each number of rays along a side of a pixel."""
    caster = cast_rays_at(scene)
    return tuple(render_posture(scene, FIRST, caster=caster, supersample=n) for n in supersample)


def image_set(folder: Path, rig: RigConfig, part: PartConfig, scene: Scene, level: Float32, seed: int) -> ImageSet:
    """Images as the camera delivers them; the noise of a seed is the same for all levels."""
    writer = ImageSetWriter(folder, set_manifest("simulated", rig, part, scene, options={"noise": seed}))
    for number, (light, own) in enumerate(zip(scene.lights, level, strict=True)):
        rng = image_rng(seed, light=number, posture=0, exposure=0)
        png = expose(own, sensor=scene.sensor, exposure=1.0, full_scale=scene.reflectance.full_scale, rng=rng)
        entry = ImageEntry(
            light=light.name,
            light_elevation_deg=round(math.degrees(light.elevation), 9),
            light_azimuth_deg=round(math.degrees(light.azimuth), 9),
            posture=FIRST,
            exposure=1.0,
        )
        writer.add_image(entry, png=png)
    return read_image_set(folder)


class Inspector:
    """Inspects images of a part, and says which defects are found."""

    def __init__(self, rig: RigConfig, part: PartConfig) -> None:
        self.rig, self.part = rig, part
        self.cache = PredictionCache()

    def found(self, images: ImageSet, defects: PartConfig) -> list[dict[str, bool]]:
        """Of each name whether it was found, for each of :data:`MIN_IMAGES`."""
        answers: list[dict[str, bool]] = []
        for min_images in MIN_IMAGES:
            options = InspectOptions(fusion=None, min_images=min_images)
            result = inspect_set(self.rig, self.part, images, options=options, cache=self.cache)
            known = [d for d in place_defects(result.nominal, self.rig, defects) if d.shape.kind in SHAPE_KINDS]
            evaluation = evaluate_set(images, result, known=known)
            answers.append({defect.name: defect.found for defect in evaluation.defects})
        return answers


def compare_part(folder: Path, name: str, options: argparse.Namespace) -> Iterator[Difference]:
    """All differences of a part."""
    rig_file, part_file = files(folder, name, width=options.width)
    chosen = rig_file
    if not options.toy:
        best = folder / f"{name}-best"
        run_command(
            "optimize", rig_file, part_file, "-o", best, "--objective", "detectability", "--posture", "0,0",
            "--step", 5, "--patches", 50_000, "--no-images", "--no-report", "-q",
        )  # fmt: skip
        chosen = best / "rig.optimized.yaml"
    rig, nominal = load_rig(chosen), load_part(part_file)
    inspector = Inspector(rig, nominal)
    for seed in range(1, options.seeds + 1):
        path = folder / f"{name}-{seed}.yaml"
        run_command("defects", rig_file, part_file, "--seed", seed, "--count", options.count, "-o", path, "-q")
        part = load_part(path)
        scene = move_part(build_scene(rig, part), np.eye(3), np.array(OFF_MM))
        defects = tuple(d for d in scene.defects if d.shape.kind in SHAPE_KINDS)
        scene = replace(scene, defects=())
        fine = refined(scene.mesh, defects, pixel_footprint(scene.camera, rig.camera.distance_mm))
        (good,), (control,) = (rendered(s, options.supersample) for s in (scene, replace(scene, mesh=fine)))
        comparison = Comparison(scene, defects, good, levels(control))
        for factor in options.factors:
            walls = tuple(steeper(defect, factor) for defect in defects)
            variants = replace(scene, defects=walls), replace(scene, mesh=displaced(fine, walls))
            # the inspection predicts the middles of pixels, and the virtual bench captures these
            pixels, middles = zip(*(rendered(variant, options.supersample, 1) for variant in variants), strict=True)
            comparison.defects = walls
            found: list[list[dict[str, bool]]] = []
            for kind, images in zip(("model", "displaced"), middles, strict=True):
                out = folder / f"{name}-{seed}-{factor:g}-{kind}"
                found.append(inspector.found(image_set(out, rig, nominal, scene, levels(images), seed), part))
            for one in comparison.differences(*map(levels, pixels)):
                yield replace(
                    one,
                    part=name,
                    seed=seed,
                    factor=factor,
                    found_model=tuple(answers.get(one.name) for answers in found[0]),
                    found_displaced=tuple(answers.get(one.name) for answers in found[1]),
                )
        print(f"{name}, seed {seed}: done; {len(fine.faces):,} triangles", flush=True)


def table(differences: Sequence[Difference]) -> str:
    """The images, a line per slope and kind, and what is found in them."""
    heads = (
        *("slope ×", "kind", "slope", "defects", "change [σ]", "difference: rms, max [σ]"),
        *("just outside: rms, max [σ]", "energy ratio: median, 5 to 95 %", "correlation: median, 5 %"),
    )
    lines = _head(heads)
    groups = [
        (factor, kind, [d for d in differences if (d.factor, d.kind) == (factor, kind)])
        for factor in sorted({d.factor for d in differences})
        for kind in SHAPE_KINDS
    ]
    for factor, kind, own in groups:
        if own:
            energy, correlation = [d.energy for d in own], [d.correlation for d in own]
            low, middle, high = np.percentile(energy, [5.0, 50.0, 95.0])
            signal, inside, outside = (
                _rms(np.array([getattr(d, name) for d in own])) for name in ("signal", "inside_rms", "outside_rms")
            )
            lines.append(
                f"| {factor:g} | {kind} | {own[0].slope:.3g}° | {len(own)} | {_number(signal)} "
                f"| {_number(inside)}, {_number(max(d.inside_max for d in own))} "
                f"| {_number(outside)}, {_number(max(d.outside_max for d in own))} "
                f"| {middle:.3f}, {low:.2f} to {high:.2f} "
                f"| {np.median(correlation):.4f}, {np.percentile(correlation, 5.0):.3f} |"
            )
    heads = (
        *("slope ×", "kind", "1 image: model, displaced", "only model, only displaced"),
        *("2 images: model, displaced", "only model, only displaced"),
    )
    lines += ["", *_head(heads)]
    for factor, kind, own in groups:
        if own:
            cells = [_found(own, which) for which in range(len(MIN_IMAGES))]
            lines.append(f"| {factor:g} | {kind} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _found(own: Sequence[Difference], which: int) -> str:
    pairs = [(d.found_model[which], d.found_displaced[which]) for d in own]
    pairs = [(a, b) for a, b in pairs if a is not None and b is not None]
    model, moved = (sum(map(bool, found)) for found in zip(*pairs, strict=True))
    only_model, only_moved = sum(a and not b for a, b in pairs), sum(b and not a for a, b in pairs)
    return f"{model}, {moved} of {len(pairs)} | {only_model}, {only_moved}"


def _number(value: float) -> str:
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}" if value >= 0.01 else "< 0.01"


def _head(names: Sequence[str]) -> list[str]:
    return [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]


def hiding_table(differences: Sequence[Difference]) -> str:
    """A line per group of the ratio of walls to view, all slopes and kinds together."""
    heads = (
        *("tan slope / tan view elevation", "defects", "difference / change: median, 95 %"),
        *("the same over the ratio: 95 %", "energy ratio: median, 5 to 95 %", "correlation: median, 5 %"),
        *("2 images: model, displaced", "only model, only displaced"),
    )
    lines = _head(heads)
    for low, high in itertools.pairwise(HIDING):
        own = [d for d in differences if low <= d.hiding < high]
        if not own:
            continue
        relative = [d.relative for d in own]
        by_ratio = np.percentile([d.relative / d.hiding for d in own], 95.0)
        energy = np.percentile([d.energy for d in own], [5.0, 50.0, 95.0])
        correlation = [d.correlation for d in own]
        lines.append(
            f"| {f'{low:g} to {high:g}' if math.isfinite(high) else f'{low:g} and more'} | {len(own)} "
            f"| {np.median(relative):.2f}, {np.percentile(relative, 95.0):.2f} | {by_ratio:.1f} "
            f"| {energy[1]:.3f}, {energy[0]:.2f} to {energy[2]:.2f} "
            f"| {np.median(correlation):.3f}, {np.percentile(correlation, 5.0):.2f} | {_found(own, 1)} |"
        )
    return "\n".join(lines)


def bounds_text(differences: Sequence[Difference]) -> str:
    """How the formulas of parallax and of shadows hold."""
    wide = [d for d in differences if d.kind in WIDE and abs(d.parallax) > LEAST_PARALLAX_PX]
    shifts = np.percentile([d.shift / d.parallax for d in wide] or [math.nan], [5.0, 50.0, 95.0])
    within = sum(0.0 <= d.shift / d.parallax <= 1.0 for d in wide)
    hills = [d for d in differences if _is_hill(d.kind)]
    shaded = [d for d in hills if d.reach_bound > 0.0]
    changed = [d for d in differences if d.reach > SLACK_MM]
    low, middle, high = shifts
    reach, floor = max(d.reach for d in differences), max(d.floor_max for d in differences)
    above, rough = sum(d.above_bound for d in differences), sum(d.floor_max > SEEN for d in differences)
    shift = (
        f"Parallax: {len(wide)} dents, bumps and blisters have one of more than {LEAST_PARALLAX_PX:g} px. The image's "
        f"shift, by least squares, is {middle:.2f} of it (median; 5 to 95 %: {low:.2f} to {high:.2f}), and from 0 to 1 "
        f"of it for {within}."
    )
    shadow = (
        f"Shadows and hidden surface: the formula lets {len(shaded)} of {len(hills)} bumps and blisters reach beyond "
        f"their outline. Of all {len(differences)} defects {len(changed)} change pixels more than {SLACK_MM:g} mm "
        f"beyond it, up to {reach:.2f} mm, and {above} further than the formula says (by more than {SLACK_MM:g} mm)."
    )
    control = (
        f"Control: the refined mesh differs from the good part by at most {floor:.2g} σ, and by more than {SEEN:g} σ "
        f"around {rough} of {len(differences)} defects."
    )
    return f"- {shift}\n- {shadow}\n- {control}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare, print the tables, write all differences."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.displaced", description=__doc__)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--seeds", type=int, default=9, help="sets of defects per part")
    parser.add_argument("--count", type=int, default=6 * len(BUILT_IN_CATALOGUE), help="defects per set")
    parser.add_argument("--factors", type=float, nargs="+", default=list(FACTORS), help="of the walls' tangents")
    parser.add_argument("--width", type=int, default=800, help="of the images [px]")
    parser.add_argument("--supersample", type=int, default=5, help="rays along a side of a pixel")
    parser.add_argument("--out", type=Path, default=Path("out/displaced"), help="folder of displaced.csv")
    parser.add_argument("--page", action="store_true", help="put the tables into docs/validation/inspection.md")
    parser.add_argument("--toy", action="store_true", help="the lights as filed")
    options = parser.parse_args(arguments)
    differences: list[Difference] = []
    for name in options.parts:
        with tempfile.TemporaryDirectory(prefix="lightopt-displaced-") as folder:
            differences += compare_part(Path(folder), name, options)
    write_records(options.out / "displaced.csv", differences)
    tables = {
        "displaced": table(differences),
        "displaced-hiding": hiding_table(differences),
        "displaced-bounds": bounds_text(differences),
    }
    for block, text in tables.items():
        print(f"\n{text}")
        if options.page:
            replace_block(block, text)


if __name__ == "__main__":
    main()
