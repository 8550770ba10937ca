"""Images of a surface that is not of the model: a lobe with the tails of a polished metal's, drawn by this file alone.

Expected: the fit says that the model describes them badly, and still predicts every light that it has not seen to
within 5 levels rms: grey levels on what an image at exposure 1 can tell, sensor levels in each image as delivered.
"""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from captured import PART, PARTS, RIG
from drawn import draw_images

from lightopt import build_scene
from lightopt.estimate.reflectance._fit_samples import fit_reflectance
from lightopt.estimate.reflectance._quality import assess_quality, poor_fit_warnings
from lightopt.estimate.reflectance._samples import collect_samples
from lightopt.estimate.reflectance._setup import FitSetup
from lightopt.estimate.reflectance._validation import leave_lights_out
from lightopt.rendering import cast_rays_at


def heavy_tails(width):
    """A lobe that falls off like δ⁻⁴, as that of GGX does near its peak."""

    def lobe(normal, view, light):
        half = light + view
        half /= np.linalg.norm(half, axis=1)[:, None]
        delta = 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(normal - half, axis=1), 0.0, 1.0))
        n_dot_l, n_dot_v = np.einsum("ij,ij->i", normal, light), np.einsum("ij,ij->i", normal, view)
        value = 1.0 / (1.0 + 0.5 * (delta / width) ** 2) ** 2 / np.maximum(n_dot_v, 0.01)
        return np.where((n_dot_l > 0.0) & (n_dot_v > 0.0), value, 0.0)

    return lobe


@pytest.mark.nightly
@pytest.mark.parametrize(("R_s", "width"), [(2000.0, 0.03), (12500.0, 0.01)])
def test_a_lobe_with_heavy_tails(tmp_path, R_s, width):
    rig = RIG.replace("[160, 120]", "[320, 240]").replace("pixel_size_um: 44", "pixel_size_um: 22")
    (tmp_path / "rig.yaml").write_text(rig, encoding="utf-8")
    (tmp_path / "part.yaml").write_text(PART.replace("knob.stl, units: mm", "knob.step"), encoding="utf-8")
    shutil.copy(PARTS / "cover-knob.step", tmp_path / "knob.step")
    scene = build_scene(tmp_path / "rig.yaml", tmp_path / "part.yaml", points="auto")
    caster = cast_rays_at(scene)
    images = draw_images(scene, caster, heavy_tails(width), R_d=45.0, R_s=R_s, exposures=(1.0, 1 / 16))
    samples = collect_samples(scene, images, caster=caster, budget=4000)
    found = fit_reflectance(samples)
    quality = assess_quality(samples, found)
    print(quality)
    assert any("describes these images badly" in text for text in poor_fit_warnings(found, quality))
    assert quality.epsilon > 0.02
    left_out = leave_lights_out(FitSetup(scene, caster, samples.images), samples, found)
    shown = [image for left in left_out for image in left.images]
    print("unseen lights:", *(f"{i.image} {i.rms_sensor:.2f} sensor levels, {i.rms:.2f} grey levels;" for i in shown))
    assert len(left_out) == len(scene.lights)
    assert len(shown) == len(images)
    for image in shown:
        assert image.rms_sensor < 5.0
        if "×" not in image.image:
            assert image.rms == pytest.approx(image.rms_sensor)  # 8 bits at exposure 1
