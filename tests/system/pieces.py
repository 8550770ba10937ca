"""Samples of the pixels that touch defects: what they see without and with the defects, and how it leans."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightopt.defects import PlacedDefect, mark_surface, surface_coordinates, tangent_references
from lightopt.defects._placed_defects import Marks
from lightopt.design import DIRECTIONS
from lightopt.geometry import Patches, RayCaster
from lightopt.lights import PanelLight
from lightopt.rendering import SurfacePoints, shade_points, trace_samples
from lightopt.scene import PartView, Scene, pixel_footprint

__all__ = ["Piece", "leans_of", "piece_of"]

Flags = NDArray[np.bool_]
Float64 = NDArray[np.float64]

STEEP = 0.9
"""Of the steepest slope: where a defect's wall counts as its trial."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Piece:
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


def piece_of(
    scene: Scene,
    view: PartView,
    defects: Sequence[PlacedDefect],
    pixels: NDArray[np.intp],
    labels: NDArray[np.intp],
    caster: RayCaster,
    patches: Patches,
    samples: int,
    stretch_px: float,
) -> Piece:
    """Trace some pixels that may touch defects, samples × samples rays each, and keep those that do.

    Parameters
    ----------
    scene, view, defects, caster, patches
        The part as the camera has it before itself, and what lies on it.
    pixels, labels
        Column and row of each, shape (n, 2), and index of the defect that it is looked at for, ascending, shape (n,).
    samples, stretch_px
        As for :func:`touched.touched`.
    """
    camera, each = view.camera, samples * samples
    inner = (np.arange(samples) + 0.5) / samples
    right, down = (a.ravel() for a in np.meshgrid(inner, inner))
    hits, surface = trace_samples(
        caster, scene.mesh, camera, (pixels[:, :1] + right).ravel(), (pixels[:, 1:] + down).ravel()
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
    return Piece(
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
    scene: Scene, defects: Sequence[PlacedDefect], surface: SurfacePoints, marks: Marks | None, own: Flags
) -> NDArray[np.int32]:
    wall = np.full(len(surface), -1, np.int32)
    if marks is None:
        return wall
    cosine, angle = leans_of(scene, surface, marks)
    steepest = np.array([defect.shape.slope for defect in defects])[marks.label]
    turn = np.rint(angle / (2.0 * math.pi / DIRECTIONS)).astype(np.int32) % DIRECTIONS
    steep = np.arccos(np.clip(cosine, -1.0, 1.0)) >= STEEP * steepest
    wall[marks.index] = np.where(steepest == 0.0, 0, np.where(steep, turn, -1))
    wall[~own] = -1
    return wall


def leans_of(scene: Scene, surface: SurfacePoints, marks: Marks) -> tuple[Float64, Float64]:
    """How the marked points of a surface lean.

    Returns
    -------
    cosine
        Of the angle between the normals without and with the defect, shape (k,).
    angle
        To which the latter leans, as :attr:`lightopt.design.DefectHypothesis.direction` counts [rad], shape (k,).
    """
    normals = surface.normals[marks.index]
    axes = scene.placement.rotation
    references = tangent_references(normals, x_axis=axes[:, 0], y_axis=axes[:, 1])
    cosine = np.einsum("ij,ij->i", normals, marks.normals)
    lean = marks.normals - cosine[:, None] * normals
    angle = np.arctan2(
        np.einsum("ij,ij->i", lean, np.cross(normals, references)), np.einsum("ij,ij->i", lean, references)
    )
    return cosine, angle
