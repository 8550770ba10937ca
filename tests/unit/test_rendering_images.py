"""Rendering a posture: supersampling, layers, threads, progress, and the Python interface."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

import lightopt
from lightopt import build_scene, load_part, load_rig, render
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.rendering import (
    RenderOptions,
    cast_rays_at,
    highlight_level,
    mask_pixels,
    render_image_set,
    render_posture,
)

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def scene(shared_bench):
    return build_scene(shared_bench.rig, shared_bench.part)


@pytest.fixture(scope="module")
def caster(scene):
    return cast_rays_at(scene)


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize("points", ["4", "auto"])
def test_supersampling_is_the_mean_of_a_finer_camera(bench, n, points):
    bench.edit("rig.yaml", "points: 4", f"points: {points}")
    coarse = build_scene(bench.rig, bench.part)
    bench.edit("rig.yaml", "[160, 120]", f"[{160 * n}, {120 * n}]")
    bench.edit("rig.yaml", "pixel_size_um: 44", f"pixel_size_um: {44 / n!r}")
    fine = build_scene(bench.rig, bench.part)
    posture = coarse.postures[1]
    averaged = render_posture(coarse, posture, caster=cast_rays_at(coarse), supersample=n)
    many = render_posture(fine, posture, caster=cast_rays_at(fine))
    for a, b in zip(averaged.lights, many.lights, strict=True):
        means = b.level.reshape(120, n, 160, n).mean(axis=(1, 3), dtype=np.float64)
        # the converged panel is exact to 0.1 level, and lays its grid through other samples here
        assert np.allclose(a.level, means, rtol=1e-5, atol=0.1 if points == "auto" else 1e-3)
    assert averaged.rays > many.rays  # the pixels' centres are traced as well


@pytest.mark.parametrize("points", ["4", "auto"])
def test_averaged_pixels_show_the_mean_over_their_area_and_others_their_centre(bench, points):
    bench.edit("rig.yaml", "points: 4", f"points: {points}")
    scene = build_scene(bench.rig, bench.part)
    posture, caster = scene.postures[0], cast_rays_at(scene)
    own = mask_pixels(scene, posture, caster).clean
    own[:, :80] = False
    centre, fine = (render_posture(scene, posture, caster=caster, supersample=n) for n in (1, 6))
    one, two = (
        render_posture(scene, posture, caster=caster, layers=True, averaged=own, threads=n).lights for n in (1, 2)
    )
    errors = np.zeros((2, 0))
    for a, b, middle, mean in zip(one, two, centre.lights, fine.lights, strict=True):
        for name in ("level", "diffuse", "specular", "inside"):
            assert np.array_equal(getattr(a, name), getattr(b, name)), name
        assert np.array_equal(a.level[~own], middle.level[~own])
        np.testing.assert_allclose(a.level + a.inside, middle.level, rtol=1e-5, atol=1e-4)
        np.testing.assert_allclose(a.diffuse + a.specular, a.level, rtol=1e-5, atol=1e-4)
        seen = own & (mean.level < 255.0)
        errors = np.hstack([errors, [np.abs(x.level - mean.level)[seen] for x in (a, middle)]])
    averaged, centres = np.sqrt(np.mean(errors**2, axis=1))
    assert centres > 0.5
    assert averaged < 0.2 * centres
    assert np.quantile(errors[0], 0.995) < 0.6


def test_geometry_is_that_of_the_pixels_centre_whatever_the_supersampling(scene, caster):
    one, two = (render_posture(scene, scene.postures[0], caster=caster, supersample=n).geometry for n in (1, 2))
    for name in ("points", "normals", "distance", "patch", "hit"):
        assert np.array_equal(getattr(one, name), getattr(two, name)), name


def test_layers_are_the_two_terms(scene, caster):
    plain = render_posture(scene, scene.postures[0], caster=caster)
    layered = render_posture(scene, scene.postures[0], caster=caster, layers=True)
    for a, b in zip(plain.lights, layered.lights, strict=True):
        assert a.diffuse is None
        assert a.specular is None
        assert np.array_equal(a.level, b.level)
        assert np.allclose(b.diffuse.astype(np.float64) + b.specular, b.level, rtol=2e-7, atol=0)
        assert b.diffuse.max() <= 45.0 * 1.000001  # R_d · cos, times a gain of at most 1


def test_arrays_are_float32_of_the_cameras_shape(scene, caster):
    images = render_posture(scene, scene.postures[0], caster=caster)
    assert [image.light for image in images.lights] == ["light1", "light3"]
    for image in images.lights:
        assert image.level.shape == (120, 160)
        assert image.level.dtype == np.float32
        assert (image.level[~images.geometry.hit] == 0).all()
        assert (image.level >= 0).all()
    assert images.geometry.points.shape == (120, 160, 3)


@pytest.mark.parametrize(("points", "tolerance"), [(4, 0.0), ("auto", 0.1)])
def test_the_size_of_blocks_does_not_show(shared_bench, monkeypatch, points, tolerance):
    from lightopt.rendering import _images

    scene = build_scene(shared_bench.rig, shared_bench.part, points=points)
    caster = cast_rays_at(scene)
    whole = render_posture(scene, scene.postures[1], caster=caster, threads=1)
    monkeypatch.setattr(_images, "BLOCK_SAMPLES", 700)
    pieces = render_posture(scene, scene.postures[1], caster=caster, threads=3)
    for a, b in zip(whole.lights, pieces.lights, strict=True):
        assert np.abs(a.level - b.level).max() <= tolerance
    assert np.array_equal(whole.geometry.points, pieces.geometry.points)


def test_progress_rises_to_one(scene, caster, monkeypatch):
    from lightopt.rendering import _images

    monkeypatch.setattr(_images, "BLOCK_SAMPLES", 700)
    calls = []
    images = render_posture(scene, scene.postures[0], caster=caster, threads=3, progress=calls.append)
    assert len(calls) > 5
    assert calls == sorted(calls)
    assert 0.0 < calls[0] < 1.0
    assert calls[-1] == 1.0
    assert images.rays > 0


def test_progress_of_a_set_names_the_posture(shared_bench, tmp_path):
    calls = []
    done = render_image_set(
        shared_bench.rig,
        shared_bench.part,
        tmp_path,
        options=RenderOptions(patch_budget=500),
        run=RunContext(progress=lambda *call: calls.append(call)),
    )
    assert dict(calls) == {"rendering 0,0": 0.5, "rendering -10,170": 1.0}
    assert done.rays > 0
    assert (done.folder, done.images, done.resumed, done.warnings) == (tmp_path, 4, 0, ())


def test_what_a_resumed_set_reports(shared_bench, tmp_path):
    options = RenderOptions(patch_budget=500, lights=("light1",))
    render_image_set(shared_bench.rig, shared_bench.part, tmp_path, options=options)
    again = render_image_set(shared_bench.rig, shared_bench.part, tmp_path, options=options)
    assert (again.images, again.resumed, again.rays, again.patches) == (2, 2, 0, None)


def test_warnings_are_given_as_they_come_and_kept(bench, tmp_path):
    bench.edit("part.yaml", "sigma_rad: 0.0475", "sigma_rad: 0.003")
    heard = []
    options = RenderOptions(patch_budget=500)
    done = render_image_set(bench.rig, bench.part, tmp_path, options=options, run=RunContext(warn=heard.append))
    assert tuple(heard) == done.warnings
    assert len(heard) == 1  # of two panels alike
    assert heard[0].startswith("light1, light3: the panel's 4 points stand apart by 30 mm")
    again = render_image_set(bench.rig, bench.part, tmp_path, options=options)
    assert again.warnings == done.warnings


def test_warnings_of_unlike_panels_stay_apart(bench, tmp_path):
    bench.edit("part.yaml", "sigma_rad: 0.0475", "sigma_rad: 0.003")
    bench.edit("rig.yaml", "azimuth_deg: 225, gain: 0.8", "azimuth_deg: 225, size_mm: [90, 60]")
    done = render_image_set(bench.rig, bench.part, tmp_path, options=RenderOptions(patch_budget=500))
    assert [text.partition(":")[0] for text in done.warnings] == ["light1", "light3"]


def test_back_faces_are_black_counted_and_reported(bench, tmp_path):
    """A single triangle seen from behind: an open mesh, whose inside has no reflection."""
    bench.mesh.write_text(
        "solid s\nfacet normal 0 0 0\nouter loop\nvertex -15 -15 0\nvertex 0 15 3\nvertex 15 -15 0\n"
        "endloop\nendfacet\nendsolid s\n"
    )
    bench.edit("part.yaml", ", {elevation_deg: -10, rotation_deg: 170}", "")
    scene = build_scene(bench.rig, bench.part)
    images = render_posture(scene, scene.postures[0], caster=cast_rays_at(scene))
    hit = int(images.geometry.hit.sum())
    assert hit == pytest.approx(0.5 * 30 * 30 / 0.44**2, rel=0.02)
    assert images.back_faces == hit
    assert all((image.level == 0).all() for image in images.lights)
    done = render_image_set(bench.rig, bench.part, tmp_path, options=RenderOptions(patch_budget=100))
    assert len(done.warnings) == 1
    assert done.warnings[0].startswith(f"posture (0°, 0°): {hit:,} pixels on the back of a face, black")


# --- the Python interface


def test_ten_lines_of_python(shared_bench):
    rig = load_rig(shared_bench.rig)
    part = load_part(shared_bench.part)
    scene = build_scene(rig, part, points="auto")
    saturated = {}
    for images in render(scene):
        for image in images.lights:
            saturated[images.posture, image.light] = int((image.level >= 255).sum())
        assert images.geometry.points[images.geometry.hit][:, 2].max() < 30.0
    assert len(saturated) == 4
    assert all(0 < count < 5_000 for count in saturated.values())


@pytest.mark.slow
def test_the_readmes_python_runs(tmp_path):
    """The block of the README as it stands, on the sample seen by fewer pixels."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    block = re.search(r"```python\n(.*?)```", text, re.DOTALL)
    assert block is not None
    assert len([line for line in block[1].splitlines() if line.strip()]) <= 10
    script = tmp_path / "readme.py"
    script.write_text(block[1], encoding="utf-8")
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    rig = tmp_path / "configs" / "rigs" / "four-panel.yaml"
    text = rig.read_text(encoding="utf-8")
    for old, new in (
        ("resolution_px: [1600, 1200]", "resolution_px: [200, 150]"),
        ("pixel_size_um: 4.4", "pixel_size_um: 35.2"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    rig.write_text(text, encoding="utf-8")
    ran = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.count("pixels saturated") == 16


def test_the_package_has_no_other_names():
    assert set(lightopt.__all__) == {"__version__", "build_scene", "load_part", "load_rig", "render"}
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        lightopt.nothing  # noqa: B018


def test_highlight_level_is_that_of_a_mirroring_plate(bench):
    """In the middle of a plate that mirrors light 1 into the camera; R_s/cosθ_o where the lobe is wide."""
    plate = trimesh.creation.box((30, 30, 2))
    plate.apply_translation((0, 0, -1))
    plate.export(bench.folder / "knob.stl")
    bench.edit("rig.yaml", "  elevation_deg: 90\n", "  elevation_deg: 60\n  azimuth_deg: 225\n")
    bench.edit("part.yaml", "rest_on_table", "as_modelled")
    flat = [Posture(elevation_deg=0, rotation_deg=0)]
    for sigma in (0.01, 0.0475, 0.15):
        text = bench.part.read_text(encoding="utf-8")
        bench.part.write_text(re.sub(r"sigma_rad: [\d.]+", f"sigma_rad: {sigma}", text), encoding="utf-8")
        scene = build_scene(bench.rig, bench.part, points="auto", postures=flat)
        image = next(iter(render(scene, layers=True))).lights[0].specular
        level = highlight_level(scene, scene.lights[0])
        assert level == pytest.approx(image[58:62, 78:82].max(), rel=1e-2)
    assert level == pytest.approx(12500 / np.sin(np.deg2rad(60)), rel=0.1)
    text = bench.part.read_text(encoding="utf-8")
    levels = []
    for way in ("[1, 0, 0]", "[1, 1, 0]", "[0, 1, 0]"):
        brushed = f"sigma_rad: 0.01, sigma_across_rad: 0.2, brushing: {{direction: {way}}}"
        bench.part.write_text(text.replace("sigma_rad: 0.15", brushed), encoding="utf-8")
        scene = build_scene(bench.rig, bench.part, points="auto", postures=flat)
        levels.append(next(iter(render(scene, layers=True))).lights[0].specular[58:62, 78:82].max())
    assert highlight_level(scene, scene.lights[0]) == pytest.approx(max(levels), rel=0.03)
