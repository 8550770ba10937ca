"""Fits of a measured lobe to images whose light is summed from a formula, with noise and saturation.

The table in the part file is that of GGX, whose tails no single Gaussian lobe has. The surface in the images has a lobe
of the same form, wider than the table says. Expected: R_s, width_factor and R_d within 1 %, which the sum of Gaussian
lobes that follows the table is off in places.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drawn import draw_images

from lightopt import build_scene
from lightopt.estimate.reflectance import FitOptions
from lightopt.estimate.reflectance._fit import _fit_one
from lightopt.estimate.reflectance._setup import FitSetup
from lightopt.optics import Reflectance, SpecularModel, gaussian_sum
from lightopt.rendering import cast_rays_at

ALPHA = 0.06
DELTA = np.radians(np.concatenate([[0.0], np.geomspace(0.1, 60.0, 100)]))


def heights(delta):
    """GGX's distribution of facets, over its greatest value."""
    return 1.0 / (np.cos(delta) ** 4 * (1.0 + (np.tan(delta) / ALPHA) ** 2) ** 2)


def lobe_of_width(factor):
    """The lobe of the table, angles multiplied by a factor, as images show it."""

    def lobe(normal, view, light):
        half = light + view
        half = half / np.linalg.norm(half, axis=-1, keepdims=True)
        delta = 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(normal - half, axis=-1), 0.0, 1.0))
        n_dot_l, n_dot_v = np.sum(normal * light, axis=-1), np.sum(normal * view, axis=-1)
        within = np.minimum(delta / factor, 1.5)
        value = heights(within) / np.maximum(n_dot_v, 0.01)
        return np.where((n_dot_l > 0.0) & (n_dot_v > 0.0), value, 0.0)

    return lobe


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "R_s"), [(1.4, 4500.0), pytest.param(0.7, 18000.0, marks=pytest.mark.nightly)])
def test_height_and_width_of_a_table_are_found(shared_bench, factor, R_s):
    scene = build_scene(shared_bench.rig, shared_bench.part, points="auto")
    scene = replace(scene, postures=scene.postures[:1])
    caster = cast_rays_at(scene)
    images = draw_images(scene, caster, lobe_of_width(factor), R_d=45.0, R_s=R_s, exposures=(1.0, 1 / 16))
    lobes = gaussian_sum(DELTA, heights(DELTA)).lobes
    model = SpecularModel(name="measured", measured=lobes)
    held = Reflectance(R_d=30.0, R_s=2000.0, sigma=lobes[0][1], model=model)
    options = FitOptions(joint=True, pixels=4000)
    result, _, _ = _fit_one(FitSetup(replace(scene, reflectance=held), caster, images, options=options))
    for name, truth in {"R_s": R_s, "width_factor": factor, "R_d": 45.0}.items():
        found = next(v for v in result.values if v.name == name)
        print(f"{name}: {found.value:.5g} ± {found.standard_error:.2g}, {truth:g}")
        assert found.value == pytest.approx(truth, rel=0.01), name
