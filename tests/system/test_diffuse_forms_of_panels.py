"""Images of each form of the diffuse component: panels, shadows and surroundings against plain sums and closed forms.

Expected: as of Lambert's form, see test_converged_panel.py, where R_d is 100.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import reference as ref
from worlds import BOX_CORNERS, box, cap, corners, levels, merged, plane, scene_from_mesh, sphere

from lightopt.optics import DiffuseForm

FORMS = {
    "exponent": DiffuseForm(exponent=1.12),
    "shallow": DiffuseForm(exponent=0.8),
    "oren-nayar": DiffuseForm(roughness=0.4),
    "rough": DiffuseForm(roughness=1.0),
}
R_D = 100.0
MOST_FORMS = [
    name if name in ("exponent", "rough") else pytest.param(name, marks=pytest.mark.nightly) for name in FORMS
]


def shine(form):
    return {"R_d": R_D, "R_s": 0.0, "sigma": 0.05, "diffuse": form}


def agree(image, expected):
    error = np.abs(image - expected)
    far = np.mean(error > np.maximum(0.1, 0.001 * expected))
    print(f"max {error.max():.4f}  over 0.1 level {far:.2%}")
    assert np.ptp(expected) > 5, "a picture of nothing would agree as well"
    assert far <= 0.002
    assert np.max(error - 0.001 * expected) <= 0.2


@pytest.mark.parametrize("points", [2, "auto"])
@pytest.mark.parametrize("name", MOST_FORMS)
def test_convex_part(name, points):
    camera = ref.Camera(width=60, height=45, pixel_um=85)
    light = ref.Light(elevation=65, azimuth=60, size=(60, 45), k=2, falloff="inverse_square", emission=1.3)
    mesh = cap(30.0, half=20.0, cells=90)
    hits = ref.trace(camera, *corners(mesh))
    lit = np.flatnonzero(hits.front)[::6]
    rule = ref.equally_spaced(2) if points == 2 else ref.product_rule(6, 12)
    form = partial(ref.diffuse, form=FORMS[name])
    unit = ref.panel_radiance(hits[lit], light, R_d=R_D, R_s=0.0, sigma=0.05, form=form, rule=rule)
    scene = scene_from_mesh(camera, [light], mesh, points=4 if points == 2 else "auto", reflectance=shine(FORMS[name]))
    image = levels(scene).ravel()[lit]
    agree(image, unit[0])
    lambert = levels(replace(scene, reflectance=replace(scene.reflectance, diffuse=DiffuseForm()))).ravel()[lit]
    assert np.abs(image - lambert).max() > 2.0


LOW, HIGH = np.array([-7.0, -4.0, 9.0]), np.array([6.0, 8.0, 14.0])


@pytest.mark.parametrize("name", ["exponent", "rough"])
def test_penumbra(name):
    camera, light = ref.Camera(width=80, height=60, pixel_um=66), ref.Light(elevation=60, azimuth=0)
    mesh = merged(plane(40), box(LOW, HIGH))
    hits = ref.trace(camera, *corners(mesh))
    lit = np.flatnonzero(hits.front & (hits.face < 2))[::7]
    how = {"R_d": R_D, "R_s": 0.0, "sigma": 0.05, "form": partial(ref.diffuse, form=FORMS[name])}
    unit = ref.panel_radiance(hits[lit], light, **how)
    *unit, penumbra = ref.subtract_convex(hits[lit], light, *unit, LOW + BOX_CORNERS * (HIGH - LOW), **how, n=24)
    assert np.count_nonzero(penumbra) > 14
    image = levels(scene_from_mesh(camera, [light], mesh, points="auto", reflectance=shine(FORMS[name]))).ravel()[lit]
    agree(image, unit[0])


@pytest.mark.parametrize("name", FORMS)
def test_a_convex_part_in_white_surroundings_shows_its_albedo(name):
    """The albedo for the direction of the view, which is that of the normal in the middle of a sphere."""
    form = FORMS[name]
    camera, lamp = ref.Camera(width=80, height=60, pixel_um=88), ref.Light(distance=300, elevation=60, azimuth=0, k=1)
    scene = scene_from_mesh(camera, [lamp], sphere(15.0), reflectance=shine(form))
    scene = replace(scene, reflectance=replace(scene.reflectance, white_level=200.0))
    added = levels(replace(scene, environment=8.0)) - levels(scene)
    share = 1.0 / (1.0 + (0.5 - 2.0 / (3.0 * np.pi)) * form.roughness) if form.roughness else 2.0 / (form.exponent + 1)
    assert added[30, 40] == pytest.approx(R_D / 200.0 * share * 8.0, rel=0.01)
