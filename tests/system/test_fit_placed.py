"""What the uncertainty of a placement does to R_d, R_s and σ: nothing that their own standard errors would notice.

A part moved by two standard errors of its placement, along each axis, is fitted to the same images: highlights of
several lights and postures move against each other, so that a misplacement raises the one and lowers the other.
"""

from __future__ import annotations

import math
import shutil

import numpy as np
import pytest
from captured import PART, PARTS, RIG, captured

from lightopt import build_scene
from lightopt.estimate.reflectance._fit_samples import fit_reflectance
from lightopt.estimate.reflectance._samples import collect_samples
from lightopt.estimate.reflectance._vector import LOG_R_S, LOG_SIGMA, R_D
from lightopt.estimate.registration import Placement, place_part
from lightopt.estimate.registration._registration import refine_placement
from lightopt.rendering import cast_rays_at


@pytest.mark.nightly
def test_a_placement_is_known_well_enough_for_the_reflectance(tmp_path):
    for name, text in (("rig.yaml", RIG), ("part.yaml", PART)):
        (tmp_path / name).write_text(text, encoding="utf-8")
    shutil.copy(PARTS / "cover-knob.stl", tmp_path / "knob.stl")
    scene = build_scene(tmp_path / "rig.yaml", tmp_path / "part.yaml")
    truth = Placement(x=0.8, y=-0.6, turn=math.radians(1.0))
    images = captured(place_part(scene, truth), exposures=(1.0, 1 / 16))
    found = refine_placement(scene, images, truth, caster=cast_rays_at(scene)).placement

    def fit(x, y, turn):
        placed = place_part(scene, Placement(x=x, y=y, turn=turn))
        return fit_reflectance(collect_samples(placed, images, caster=cast_rays_at(placed), budget=20_000))

    here = fit(found.x, found.y, found.turn)
    places = (R_D, LOG_R_S, LOG_SIGMA)
    errors = np.array([here.standard_error(place) for place in places])
    moved = []
    for axis, error in enumerate(found.errors):
        where = np.array([found.x, found.y, found.turn])
        where[axis] += 2.0 * error
        moved.append((fit(*where).x[list(places)] - here.x[list(places)]) / (2.0 * errors))
    total = np.sqrt(np.sum(np.square(moved), axis=0))
    print("by one standard error of the placement, R_d, ln R_s, ln σ move by", total.round(3), "of their own")
    assert np.all(total < 0.5)
