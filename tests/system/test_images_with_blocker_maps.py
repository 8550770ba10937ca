"""What is computed with blocker maps has the bytes of what is computed with every ray cast."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lightopt import build_scene, load_part, load_rig
from lightopt.core.transforms import Posture
from lightopt.design.responses._image_evaluator import luminance_matrix
from lightopt.geometry import _blocker_maps as maps
from lightopt.rendering import build_patches, cast_rays_at, render_posture, trace_pixels
from lightopt.rendering._pixels import visibility_of_lights

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
POSTURE = Posture(-30.0, 50.0)


def scene_of(part, points):
    rig = load_rig(CONFIGS / "rigs" / "four-panel.yaml")
    camera = rig.camera.model_copy(update={"resolution_px": (320, 240), "pixel_size_um": 22.0})
    rig = rig.model_copy(update={"camera": camera})
    config = load_part(CONFIGS / "parts" / f"{part}.yaml")
    return build_scene(rig, config, points=points)


def both_ways(monkeypatch, work):
    """Result and rays cast, with maps and without."""
    monkeypatch.setattr(maps, "WORTHWHILE_SHARE", 0.0)
    with_maps = work()
    monkeypatch.setattr(maps, "WORTHWHILE_SHARE", 1e9)
    return with_maps, work()


@pytest.mark.parametrize("part", ["cover-knob", pytest.param("spout", marks=pytest.mark.nightly)])
@pytest.mark.parametrize("points", [4, "auto"])
def test_images_have_the_same_bytes(monkeypatch, part, points):
    scene = scene_of(part, points)

    def work():
        images = render_posture(scene, POSTURE, caster=cast_rays_at(scene), threads=2)
        return [image.level for image in images.lights], images.rays

    (mapped, few), (plain, many) = both_ways(monkeypatch, work)
    for a, b in zip(mapped, plain, strict=True):
        assert a.tobytes() == b.tobytes()
    assert few < 0.9 * many


@pytest.mark.parametrize("part", ["cover-knob", "spout"])
def test_luminance_matrices_and_verdicts_are_the_same(monkeypatch, part):
    scene = scene_of(part, 4)

    def work():
        caster = cast_rays_at(scene)
        table = build_patches(scene, caster=caster, budget=3000)
        begun = caster.rays_cast
        matrix = luminance_matrix(
            scene, table, scene.postures[0], [[light] for light in scene.lights], caster=caster, threads=2
        )
        pixels = trace_pixels(scene, POSTURE, caster)
        verdicts = [visibility_of_lights(pixels, [light], caster, threads=2)[0] for light in pixels.view.lights]
        return (*matrix.levels, *verdicts), caster.rays_cast - begun

    (mapped, few), (plain, many) = both_ways(monkeypatch, work)
    for a, b in zip(mapped, plain, strict=True):
        np.testing.assert_array_equal(a, b)
    assert few < 0.9 * many
