"""Defects strewn over a part, looked at in noisy images: the pixels that each touches, and a plain contrast test.

A pixel shows a defect in an image where its level is off the noise-free image of the good part by the threshold times
the noise there. The test knows nothing of patches, trials and fill factors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightopt.config import CatalogueEntryConfig, PartConfig, RigConfig
from lightopt.defects import (
    Marks,
    PlacedDefect,
    mark_surface,
    surface_coordinates,
    tangent_direction,
    tangent_references,
)
from lightopt.errors import InputError
from lightopt.mesh import Patches, SurfaceFinder
from lightopt.optimize import DIRECTIONS, Contrast, Visibility, flags_of
from lightopt.raycast import RayCaster
from lightopt.rendering import SurfacePoints, shade_points, trace_samples
from lightopt.scatter import scatter_defects
from lightopt.scene import PanelLight, PartView, Scene, pixel_footprint, project, view_from_part
from lightopt.sensor import expose, image_rng
from lightopt.transforms import Posture

__all__ = ["Touched", "counted", "off", "predicted", "strew", "touched"]

Flags = NDArray[np.bool_]
Float64 = NDArray[np.float64]

AT_ONCE = 200_000
"""Rays that are traced at once."""

STEEP = 0.9
"""Of the steepest slope: where a defect's wall counts as its trial."""


def strew(
    rig: RigConfig,
    part: PartConfig,
    scene: Scene,
    *,
    count: int,
    seed: int,
    catalogue: Sequence[CatalogueEntryConfig] = (),
    turns: int | None = None,
) -> tuple[PlacedDefect, ...]:
    """Defects where the function behind ``lightopt defects`` puts them; as many as there is room for.

    Parameters
    ----------
    rig, part, scene
        The scene's postures are those in which the defects must be seen.
    count, seed
        As for :func:`lightopt.scatter.scatter_defects`.
    catalogue
        Instead of the part's.
    turns
        So many directions in turn, evenly from the part's X axis on, instead of those drawn.
    """
    postures = tuple(
        part.postures[0].model_copy(
            update={"elevation_deg": posture.elevation_deg, "rotation_deg": posture.rotation_deg}
        )
        for posture in scene.postures
    )
    own = part.model_copy(update={"postures": postures, "defects": ()})
    if catalogue:
        own = own.model_copy(update={"defect_catalogue": tuple(catalogue)})
    while True:
        try:
            found = scatter_defects(rig, own, count=count, seed=seed)
            break
        except InputError:
            if count < 4:
                raise
            count = count * 2 // 3
    placement, finder = scene.placement, SurfaceFinder(scene.mesh)
    axes = placement.rotation
    placed: list[PlacedDefect] = []
    for index, one in enumerate(found):
        place = finder.nearest(placement.to_part(np.array(one.at_mm)))
        turn = math.radians(one.direction_deg) if turns is None else 2.0 * math.pi * (index % turns) / turns
        along = tangent_direction(place.normal, turn, x_axis=axes[:, 0], y_axis=axes[:, 1])
        placed.append(
            PlacedDefect(
                name=one.name,
                shape=one.entry.shape,
                position=place.point,
                normal=place.normal,
                along=along,
            )
        )
    return tuple(placed)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Piece:
    """Some of the pixels: their samples without and with the defects, and to which pixel each belongs."""

    defect: NDArray[np.intp]
    patch: NDArray[np.int32]
    wall: NDArray[np.int32]
    surface: SurfacePoints
    pixel: NDArray[np.intp]
    changed: tuple[tuple[NDArray[np.intp], SurfacePoints, float, float], ...]

    def levels(self, scene: Scene, panel: PanelLight, caster: RayCaster) -> tuple[Float64, Float64]:
        """Without and with the defects [grey level], shape (pixels,) each; the panel in the part's frame."""
        plain = _levels(scene, self.surface, panel, caster)
        turned = plain.copy()
        for index, leaning, R_d_factor, sigma_factor in self.changed:
            reflectance = scene.reflectance.changed(R_d_factor=R_d_factor, sigma_factor=sigma_factor)
            turned[index] = _levels(replace(scene, reflectance=reflectance), leaning, panel, caster)
        samples = np.maximum(1, np.bincount(self.pixel, minlength=len(self.defect)))
        return (
            np.bincount(self.pixel, plain, minlength=len(self.defect)) / samples,
            np.bincount(self.pixel, turned, minlength=len(self.defect)) / samples,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Touched:
    """Pixels of a posture's image that touch defects, n of them.

    Attributes
    ----------
    posture
        Of the part.
    defect
        Index of the defect, shape (n,).
    patch
        That the pixel's centre sees, shape (n,).
    wall
        To which of the eight directions the surface leans there where it has its steepest slope; −1 elsewhere, 0 for
        stains and hazes; shape (n,).
    """

    posture: Posture
    defect: NDArray[np.intp]
    patch: NDArray[np.int32]
    wall: NDArray[np.int32]
    pieces: tuple[_Piece, ...]

    def levels(self, scene: Scene, caster: RayCaster) -> tuple[Float64, Float64]:
        """Levels without and with the defects under each light of a scene [grey level], shape (lights, n) each."""
        lights = view_from_part(scene, self.posture).lights
        both = [[piece.levels(scene, panel, caster) for piece in self.pieces] for panel in lights]
        good, bad = (
            np.stack([np.concatenate([one[which] for one in light]) for light in both]) for which in (0, 1)
        )
        return good, bad


def touched(
    scene: Scene,
    posture: Posture,
    defects: Sequence[PlacedDefect],
    *,
    caster: RayCaster,
    patches: Patches,
    samples: int = 1,
    thin_from_px: float = math.inf,
    stretch_px: float = math.inf,
) -> Touched:
    """Trace the defects' pixels, n × n rays each.

    Parameters
    ----------
    scene, posture
        What is looked at.
    defects
        Part frame.
    caster, patches
        Of the part.
    samples
        n.
    thin_from_px
        Of defects of this width and more only every second pixel of every second row.
    stretch_px
        Of each defect only the pixels that are no further along it from its middle.
    """
    view = view_from_part(scene, posture)
    pieces = tuple(
        _piece(scene, view, defects, pixels, labels, caster, patches, samples, stretch_px)
        for pixels, labels in _around(view, defects, thin_from_px, stretch_px, max(1, AT_ONCE // samples**2))
    )
    return Touched(
        posture=posture,
        defect=np.concatenate([p.defect for p in pieces]),
        patch=np.concatenate([p.patch for p in pieces]),
        wall=np.concatenate([p.wall for p in pieces]),
        pieces=pieces,
    )


def _around(
    view: PartView, defects: Sequence[PlacedDefect], thin_from_px: float, stretch_px: float, at_once: int
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    # pixels (column, row) around each defect, and whose they are
    camera = view.camera
    pixels: list[NDArray[np.intp]] = [np.zeros((0, 2), np.intp)]
    labels: list[NDArray[np.intp]] = [np.zeros(0, np.intp)]
    for index, defect in enumerate(defects):
        column, row, depth = (float(x[0]) for x in project(camera, defect.position[None]))
        footprint = pixel_footprint(camera, depth)
        wide = 0.5 * defect.shape.width / footprint
        half = math.ceil(min(defect.reach / footprint, stretch_px + 1.0 + wide))
        step = 2 if defect.shape.width >= thin_from_px * footprint else 1
        columns, rows = np.meshgrid(
            np.arange(int(column) - half, int(column) + half + 1, step),
            np.arange(int(row) - half, int(row) + half + 1, step),
        )
        inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
        pixels.append(np.stack([columns[inside], rows[inside]], axis=1))
        labels.append(np.full(int(inside.sum()), index))
    everything, owners = np.concatenate(pixels), np.concatenate(labels)
    for start in range(0, max(1, len(owners)), at_once):
        yield everything[start : start + at_once], owners[start : start + at_once]


def _piece(
    scene: Scene,
    view: PartView,
    defects: Sequence[PlacedDefect],
    pixels: NDArray[np.intp],
    labels: NDArray[np.intp],
    caster: RayCaster,
    patches: Patches,
    samples: int,
    stretch_px: float,
) -> _Piece:
    camera, each = view.camera, samples * samples
    inner = (np.arange(samples) + 0.5) / samples
    right, down = (a.ravel() for a in np.meshgrid(inner, inner))
    hits, surface = trace_samples(
        caster,
        scene.mesh,
        camera,
        (pixels[:, :1] + right).ravel(),
        (pixels[:, 1:] + down).ravel(),
    )
    pixel = (hits.ray // each).astype(np.intp)
    inside, whole = np.zeros(len(pixels), np.bool_), np.zeros(len(pixels), np.int64)
    np.add.at(whole, pixel, surface.front)
    # those whose pixels these are; neighbours are far enough
    start = int(labels.min(initial=len(defects)))
    defects = defects[start : int(labels.max(initial=-1)) + 1]
    labels = labels - start
    marks = mark_surface(defects, surface.points, surface.normals)
    # a pixel counts for the defect that it was taken for
    own = np.zeros(len(surface), np.bool_)
    if marks is not None:
        own[marks.index] = marks.label == labels[pixel[marks.index]]
        inside[pixel[own]] = True
    inside &= whole == each
    if math.isfinite(stretch_px):
        inside &= _near(view, defects, labels, surface, pixel, len(pixels), stretch_px)
    rows = np.flatnonzero(inside[pixel])
    # the middle sample stands for the pixel's centre
    middle = np.flatnonzero(inside) * each + (samples // 2) * (samples + 1)
    at = np.searchsorted(hits.ray, middle)
    return _Piece(
        defect=labels[inside] + start,
        patch=patches.patch_at(hits.face[at], hits.u[at], hits.v[at]),
        wall=_walls(scene, defects, surface, marks, own)[at],
        surface=surface.take(rows),
        pixel=(np.cumsum(inside) - 1)[pixel[rows]],
        changed=_changed(surface, rows, marks),
    )


def _near(
    view: PartView,
    defects: Sequence[PlacedDefect],
    labels: NDArray[np.intp],
    surface: SurfacePoints,
    pixel: NDArray[np.intp],
    count: int,
    stretch_px: float,
) -> Flags:
    along = np.zeros(len(surface))
    for index in np.unique(labels):
        mine = np.flatnonzero(labels[pixel] == index)
        x, _, _ = surface_coordinates(defects[index], surface.points[mine], surface.normals[mine])
        along[mine] = x
    means = np.bincount(pixel, along, minlength=count) / np.maximum(1, np.bincount(pixel, minlength=count))
    depths = np.array([float((d.position - view.camera.position) @ view.camera.forward) for d in defects])
    return np.abs(means) <= stretch_px * pixel_footprint(view.camera, 1.0) * depths[labels]


def _levels(scene: Scene, surface: SurfacePoints, panel: PanelLight, caster: RayCaster) -> Float64:
    assert panel.points != "auto"
    own = scene.reflectance
    diffuse, specular = shade_points(surface, panel, points=panel.points, sigma=own.sigma, caster=caster)
    return own.R_d * diffuse + own.R_s * specular


def _changed(
    surface: SurfacePoints, rows: NDArray[np.intp], marks: Marks | None
) -> tuple[tuple[NDArray[np.intp], SurfacePoints, float, float], ...]:
    # of some samples those in defects: which they are, how they lean, what their coefficients are multiplied by
    if marks is None:
        return ()
    row_of = np.full(len(surface), -1)
    row_of[rows] = np.arange(len(rows))
    factors = np.stack([marks.R_d_factor, marks.sigma_factor], axis=1)
    groups: list[tuple[NDArray[np.intp], SurfacePoints, float, float]] = []
    for R_d_factor, sigma_factor in np.unique(factors, axis=0).tolist():
        some = (factors == (R_d_factor, sigma_factor)).all(axis=1) & (row_of[marks.index] >= 0)
        index = marks.index[some]
        leaning = replace(surface.take(index), normals=marks.normals[some])
        groups.append((row_of[index], leaning, R_d_factor, sigma_factor))
    return tuple(groups)


def _walls(
    scene: Scene,
    defects: Sequence[PlacedDefect],
    surface: SurfacePoints,
    marks: Marks | None,
    own: Flags,
) -> NDArray[np.int32]:
    wall = np.full(len(surface), -1, np.int32)
    if marks is None:
        return wall
    normals = surface.normals[marks.index]
    axes = scene.placement.rotation
    references = tangent_references(normals, x_axis=axes[:, 0], y_axis=axes[:, 1])
    cosine = np.einsum("ij,ij->i", normals, marks.normals)
    lean = marks.normals - cosine[:, None] * normals
    angle = np.arctan2(
        np.einsum("ij,ij->i", lean, np.cross(normals, references)), np.einsum("ij,ij->i", lean, references)
    )
    steepest = np.array([defect.shape.slope for defect in defects])[marks.label]
    turn = np.rint(angle / (2.0 * math.pi / DIRECTIONS)).astype(np.int32) % DIRECTIONS
    steep = np.arccos(np.clip(cosine, -1.0, 1.0)) >= STEEP * steepest
    wall[marks.index] = np.where(steepest == 0.0, 0, np.where(steep, turn, -1))
    wall[~own] = -1
    return wall


def counted(
    seen: Touched,
    levels: tuple[Float64, Float64],
    scene: Scene,
    defects: int,
    *,
    contrast: Contrast,
    exposure: float = 1.0,
    image: int = 0,
) -> Flags:
    """Which defects the noisy images show, shape (lights, defects).

    Parameters
    ----------
    seen, levels
        The pixels, and what :meth:`Touched.levels` says of them.
    scene
        Its sensor and full scale.
    defects
        How many there are.
    contrast
        The threshold.
    exposure
        Of the images.
    image
        Number of the posture or comparison, for other noise than elsewhere.
    """
    shown = np.zeros((len(levels[0]), defects), np.bool_)
    for light, (good, bad) in enumerate(zip(*levels, strict=True)):
        rng = image_rng(0, light=light, posture=image, exposure=round(1000 * exposure))
        delivered = expose(
            bad[None].astype(np.float32),
            sensor=scene.sensor,
            exposure=exposure,
            full_scale=scene.reflectance.full_scale,
            rng=rng,
        )[0].astype(np.float64)
        flags = off(delivered, good, scene, contrast.threshold, exposure)
        shown[light, seen.defect[flags]] = True
    return shown


def off(delivered: Float64, good: Float64, scene: Scene, threshold: float, exposure: float = 1.0) -> Flags:
    """The plain contrast test: delivered levels against the noise-free ones of the good part [grey level]."""
    sensor = scene.sensor
    scale = exposure * sensor.max_level / scene.reflectance.full_scale
    expected = np.minimum(sensor.black_level + scale * good, sensor.saturated_from)
    photons = (
        0.0
        if sensor.electrons_per_level is None
        else (expected - sensor.black_level) / sensor.electrons_per_level
    )
    noise = np.sqrt(sensor.read_noise_levels**2 + photons + 1.0 / 12.0)
    return np.abs(np.minimum(delivered, sensor.saturated_from) - expected) >= threshold * noise


def predicted(
    seen: Touched, visibility: Sequence[Visibility], first_trial: NDArray[np.intp], defects: int
) -> Flags:
    """Which defects the objective's bits say the images show: on the patch of one of their walls; (lights, defects).

    Parameters
    ----------
    seen
        The pixels.
    visibility
        Of one position of each light, one for each exposure.
    first_trial
        Of each defect, the first of its trials.
    defects
        How many there are.
    """
    first = visibility[0]
    row_of = np.full(int(max(first.patch.max(), seen.patch.max())) + 1, -1)
    row_of[first.patch] = np.arange(len(first.patch))
    on = np.flatnonzero((seen.wall >= 0) & (row_of[seen.patch] >= 0))
    rows, trial = row_of[seen.patch[on]], first_trial[seen.defect[on]] + seen.wall[on]
    shown = np.zeros((len(first.words), defects), np.bool_)
    for one in visibility:
        for light, layer in enumerate(one.words):
            flags = flags_of(layer[0][rows], len(one.trials))[np.arange(len(on)), trial]
            shown[light, seen.defect[on[flags.astype(bool)]]] = True
    return shown
