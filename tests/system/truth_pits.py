"""Predicted against counted on the walls of pits that are strewn over a part."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from contrasts import off
from numpy.typing import NDArray
from pieces import leans_of
from strewn import strew
from truth_case import MEANS, SEED, SEEN_IN, Case, Point, noisy_levels, trace

from lightopt.config import PartConfig, RigConfig
from lightopt.config._defects import CatalogueEntryConfig
from lightopt.defects import CatalogueEntry, PlacedDefect, mark_surface, radial_place, surface_coordinates
from lightopt.design import defect_hypotheses, unpack_flags
from lightopt.rendering import render_posture

__all__ = ["pits_of"]

SLOPES = (4.0, 8.0)
WIDTH_MM = 1.5

WALL = 0.3, 0.7
"""From the middle to the rim: where a cone has its full slope, a pixel further on each side too."""

DIRECTIONS = 32
"""Around, of which the one is predicted that a pixel's wall leans to: a cone leans to all, not to eight."""

AROUND = sorted(itertools.product((-1, 0, 1), repeat=2), key=lambda at: abs(at[0]) + abs(at[1]))
"""A pixel and its neighbours, rows and columns from it."""


def pits_of(case: Case, rig: RigConfig, part: PartConfig, finish: str, count: int) -> Iterator[Point]:
    """Strew pits of known slope, render, count the pixels on their walls: each, and the mean of it and its neighbours.

    Parameters
    ----------
    case
        The part.
    rig, part
        Where the pits come from.
    finish
        Its name.
    count
        How many pits.
    """
    posture = case.scene.postures[0]
    patches = case.table.patches
    good = render_posture(case.scene, posture, caster=case.caster, patches=patches)
    shown = good.geometry.patch.ravel()
    around = np.array([row * good.geometry.patch.shape[1] + column for row, column in AROUND])
    for slope in SLOPES:
        entry = CatalogueEntryConfig(kind="pit", name="pit", size_mm=WIDTH_MM, slope_deg=slope)
        trials = defect_hypotheses([CatalogueEntry("pit", entry.shape)], directions=DIRECTIONS)
        visibility = case.predict(trials).visibility
        assert visibility is not None
        placed = strew(rig, part, case.scene, count=count, seed=SEED, catalogue=[entry])
        bad = render_posture(replace(case.scene, defects=placed), posture, caster=case.caster, patches=patches)
        row_of = np.full(len(patches), -1)
        row_of[visibility.patch] = np.arange(len(visibility.patch))
        pixels, toward = _on_walls(placed, case)
        known = row_of[shown[pixels]] >= 0
        pixels, toward = pixels[known], toward[known]
        rows = row_of[shown[pixels]]
        counts = {mean: np.zeros(len(pixels), np.int64) for mean in MEANS}
        for k, (one, other) in enumerate(zip(good.lights, bad.lights, strict=True)):
            plain, level = (x.level.ravel()[pixels + around[:, None]].astype(np.float64) for x in (one, other))
            noisy = noisy_levels(case, level, light=k, trial=1000 + int(slope))
            # a mean of pixels of which some are saturated is one of clipped levels
            plain = np.minimum(plain, case.saturated_from)
            for mean, own in counts.items():
                own += off(noisy[:mean].mean(axis=0), plain[:mean].mean(axis=0), case.scene, case.contrast.threshold)
        for min_images, mean in itertools.product(SEEN_IN, MEANS):
            flags = unpack_flags(
                visibility.rows([np.zeros(1, np.int64)] * len(good.lights)).reachable(min_images), len(trials)
            )
            yield Point(
                part=part.name, finish=finish, kind=f"pits of {slope:g}°", min_images=min_images, pixels=mean,
                predicted=float(flags[rows, toward].mean()),
                measured=float((counts[mean] >= min_images).mean()),
            )  # fmt: skip


def _on_walls(placed: tuple[PlacedDefect, ...], case: Case) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    # pixels whose centres see the walls of cones where they have their full slope, and to which direction these lean
    pixels, surface = trace(case)
    marks = mark_surface(placed, surface.points, surface.normals)
    assert marks is not None
    _, angles = leans_of(case.scene, surface, marks)
    turn = np.rint(angles / (2.0 * math.pi / DIRECTIONS)).astype(np.intp) % DIRECTIONS
    on_wall = np.zeros(len(turn), np.bool_)
    for label, defect in enumerate(placed):
        own = np.flatnonzero(marks.label == label)
        at = marks.index[own]
        x, y, same = surface_coordinates(defect, surface.points[at], surface.normals[at])
        place = radial_place(defect.shape, x, y)
        on_wall[own] = same & (place > WALL[0]) & (place < WALL[1])
    return pixels[marks.index[on_wall]], turn[on_wall]
