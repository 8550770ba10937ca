"""Fits of a brushed surface to images whose light is summed from the published formulas, with noise and saturation.

Expected: R_d, R_s and both widths within 2 % and four standard errors, from a start that is far from all of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drawn import draw_images
from reference import specular

from lightopt import build_scene
from lightopt.estimate.reflectance import FitOptions
from lightopt.estimate.reflectance._fit import _fit_one
from lightopt.estimate.reflectance._setup import FitSetup
from lightopt.geometry import StraightBrushing
from lightopt.optics import Reflectance, SpecularModel
from lightopt.rendering import cast_rays_at

ALONG = np.array([1.0, 0.4, 0.0])
TRUTHS = {
    "torrance-sparrow": Reflectance(R_d=45.0, R_s=4000.0, sigma=0.03, model=SpecularModel(across_ratio=4.0)),
    "ggx": Reflectance(R_d=45.0, R_s=3000.0, sigma=0.03, model=SpecularModel(name="ggx", across_ratio=4.0)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["torrance-sparrow", pytest.param("ggx", marks=pytest.mark.nightly)])
def test_both_widths_are_found(shared_bench, name):
    own = TRUTHS[name]
    scene = build_scene(shared_bench.rig, shared_bench.part, points="auto")
    scene = replace(scene, postures=scene.postures[:1])
    scene = replace(scene, mesh=replace(scene.mesh, brushing=(StraightBrushing(ALONG),)))

    def lobe(normal, view, light):
        across = np.cross(normal, ALONG)
        return specular(normal, view, light, own, across / np.linalg.norm(across, axis=-1, keepdims=True))

    images = draw_images(scene, cast_rays_at(scene), lobe, R_d=own.R_d, R_s=own.R_s, exposures=(1.0, 1 / 16))
    start = Reflectance(R_d=90.0, R_s=500.0, sigma=0.1, model=replace(own.model, across_ratio=1.5))
    options = FitOptions(joint=True, pixels=8_000)
    result, _, _ = _fit_one(FitSetup(replace(scene, reflectance=start), cast_rays_at(scene), images, options=options))
    width = own.model.width_factor * own.sigma
    truth = {"R_d": own.R_d, "R_s": own.R_s, own.model.width_key: width, own.model.across_key: 4.0 * width}
    assert result.fitted == tuple(truth)
    for key, value in truth.items():
        found = next(one for one in result.values if one.name == key)
        assert found.value == pytest.approx(value, rel=0.02), key
        assert abs(found.value - value) <= 4.0 * found.standard_error + 1e-3 * value, key
