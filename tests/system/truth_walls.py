"""Predicted against counted where the whole surface leans, is stained or is hazed."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from contrasts import off
from numpy.typing import NDArray
from truth_case import MEANS, SEEN_IN, Case, Point, noisy_levels, trace

from lightopt.config import PartConfig
from lightopt.defects import tangent_references
from lightopt.design import DefectHypothesis, defect_hypotheses, unpack_flags
from lightopt.lights import PanelLight
from lightopt.rendering import GRAZING_COSINE, SurfacePoints, shade_points
from lightopt.scene import Scene, build_catalogue, view_from_part

__all__ = ["walls"]

EVERY = 4
"""Pixel and row that is looked at."""

FILLS_MM = 1000.0
"""Defects of this size fill every pixel."""


def walls(case: Case, part: PartConfig, finish: str) -> Iterator[Point]:
    """Lean the whole surface, shade and expose some of its pixels, count by the area that they see.

    Parameters
    ----------
    case
        The part.
    part, finish
        Its catalogue, and the finish's name.
    """
    # walls that fill the pixel, whatever the size of the defect: how far it does is for narrow.py
    trials = tuple(
        replace(trial, length=FILLS_MM, width=FILLS_MM) for trial in defect_hypotheses(build_catalogue(part))
    )
    visibility = case.predict(trials).visibility
    assert visibility is not None
    surface, areas = _pixels(case)
    references = _references(case.scene, surface)
    lights = view_from_part(case.scene, case.scene.postures[0]).lights
    good = [_level(case, surface, light) for light in lights]
    counts = {pixels: np.zeros((len(trials), len(surface)), np.uint8) for pixels in MEANS}
    for t, trial in enumerate(trials):
        lean = math.cos(trial.direction) * references
        lean += math.sin(trial.direction) * np.cross(surface.normals, references)
        turned = replace(surface, normals=math.cos(trial.slope) * surface.normals + math.sin(trial.slope) * lean)
        for k, light in enumerate(lights):
            level = _level(case, turned, light, trial)
            noisy = noisy_levels(case, np.tile(level, (max(MEANS), 1)), light=k, trial=t)
            for pixels, own in counts.items():
                own[t] += off(noisy[:pixels].mean(axis=0), good[k], case.scene, case.contrast.threshold)
    weights = np.array([trial.weight for trial in trials])
    names = [trial.name for trial in trials]
    for min_images, pixels in itertools.product(SEEN_IN, MEANS):
        measured = (counts[pixels] >= min_images) @ areas / areas.sum()
        flags = unpack_flags(visibility.rows([np.zeros(1, np.int64)] * len(lights)).reachable(min_images), len(trials))
        predicted = visibility.areas @ flags / visibility.areas.sum()
        for kind in (*dict.fromkeys(names), "all"):
            own = weights * np.array([kind in (name, "all") for name in names])
            shares = (float(own @ values / own.sum()) for values in (predicted, measured))
            yield Point(
                part=part.name, finish=finish, kind=kind, min_images=min_images, pixels=pixels,
                predicted=next(shares), measured=next(shares),
            )  # fmt: skip


def _pixels(case: Case) -> tuple[SurfacePoints, NDArray[np.float64]]:
    # what the pixels of the image see, and the area of surface that each stands for [mm²]
    camera = view_from_part(case.scene, case.scene.postures[0]).camera
    pixels, surface = trace(case)
    rows, columns = np.divmod(pixels, camera.width)
    surface = surface.take(np.flatnonzero((rows % EVERY == 0) & (columns % EVERY == 0)))
    cosines = np.einsum("ij,ij->i", surface.normals, surface.views)
    surface = surface.take(np.flatnonzero(cosines >= GRAZING_COSINE))
    depth = (surface.points - camera.position) @ camera.forward
    # a pixel's solid angle goes with cos³ off the axis, its footprint with the squared distance
    distance = np.linalg.norm(surface.points - camera.position, axis=1)
    solid = (depth / distance) ** 3 * (camera.pixel_size / camera.image_distance) ** 2
    return surface, solid * distance**2 / np.einsum("ij,ij->i", surface.facets, surface.views)


def _references(scene: Scene, surface: SurfacePoints) -> NDArray[np.float64]:
    axes = scene.placement.rotation
    return tangent_references(surface.normals, x_axis=axes[:, 0], y_axis=axes[:, 1])


def _level(
    case: Case, surface: SurfacePoints, light: PanelLight, trial: DefectHypothesis | None = None
) -> NDArray[np.float64]:
    assert light.points != "auto"
    own = case.scene.reflectance
    if trial is not None:
        own = own.changed(R_d_factor=trial.R_d_factor, sigma_factor=trial.sigma_factor)
    diffuse, specular = shade_points(surface, light, points=light.points, sigma=own.sigma, caster=case.caster)
    return own.R_d * diffuse + own.R_s * specular
