"""Lights that the part itself hides in part, as it hides some of a dome: its place and its reflectance from images."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from captured import PART, PARTS, RIG, captured, expose_all

from lightopt import build_scene, render
from lightopt.core.transforms import Posture
from lightopt.estimate.reflectance._fit import fit_reflectance
from lightopt.estimate.reflectance._samples import collect_samples
from lightopt.estimate.registration import (
    PixelSet,
    Placement,
    light_at,
    place_part,
    register,
    shares_seen,
    view_of_placed,
)
from lightopt.rendering import (
    PARTLY,
    WHOLE,
    cast_rays_at,
    light_layer,
    specular_of_layers,
    trace_pixels,
    trace_samples,
    visibility_of_lights,
)
from lightopt.scene import Scene, project, view_from_part
from lightopt.scene._scene import PartRegion

FLAT = Posture(0.0, 0.0)
TRUTH = Placement(x=0.4, y=-0.3, turn=math.radians(0.4))
LIGHTS = {
    "dome": "{name: dome, kind: dome, radius_mm: 150, camera_hole_mm: 33, distance_mm: 25, segments: 4, leak: 0.2}",
    "low ring": "{name: ring, kind: low_angle_ring, radius_mm: 90, height_mm: 15, distance_mm: 22, segments: 4}",
}


def scene_of(folder: Path, mesh: trimesh.Trimesh, light: str, *, pixels: int = 1) -> Scene:
    mesh.export(folder / "part.stl")
    head, _ = RIG.split("light_source:")
    head = head.replace("[160, 120]", f"[{160 * pixels}, {120 * pixels}]")
    head = head.replace("pixel_size_um: 44", f"pixel_size_um: {44 / pixels}")
    stage = "stage: {elevation_range_deg: [-45, 45], rotation_range_deg: [0, 360]}\n"
    (folder / "rig.yaml").write_text(f"{head}lights:\n  - {light}\n{stage}", encoding="utf-8")
    (folder / "part.yaml").write_text(PART.replace("knob.stl", "part.stl"), encoding="utf-8")
    return build_scene(folder / "rig.yaml", folder / "part.yaml", postures=(FLAT,))


@pytest.fixture(scope="module", params=LIGHTS)
def spout(request, tmp_path_factory) -> Scene:
    """A channel with a bridge over it."""
    body = trimesh.load_mesh(PARTS / "spout.stl")
    return scene_of(tmp_path_factory.mktemp("spout"), body, LIGHTS[request.param])


def test_most_of_the_part_sees_some_of_these_lights(spout: Scene) -> None:
    """Of the dome about as much as beside it; of the low ring a share that changes from pixel to pixel."""
    caster = cast_rays_at(spout)
    pixels = trace_pixels(spout, FLAT, caster)
    seen = visibility_of_lights(pixels, pixels.view.lights, caster)[:, pixels.clean]
    print("seen in part:", np.mean(seen == PARTLY), "wholly:", np.mean(seen == WHOLE))
    assert np.mean(seen == PARTLY) > (0.5 if spout.lights[0].name.startswith("dome") else 0.03)
    assert np.mean(seen == WHOLE) < 0.3


def test_layers_of_segments_keep_what_the_part_hides_of_each(spout: Scene) -> None:
    """Whether it hides some of one segment or nothing: those at the same points are not worked out alike."""
    caster, wide = cast_rays_at(spout), replace(spout.reflectance, R_d=0.0, R_s=1.0, sigma=0.2)
    pixels = trace_pixels(spout, FLAT, caster)
    surface = pixels.surface.take(np.flatnonzero(pixels.clean)[::7])
    layers = [
        light_layer(surface, light, caster, form=wide.diffuse, shadows=shadows)
        for light, shadows in zip(pixels.view.lights[:2], (False, True), strict=True)
    ]
    expected = [layer.specular(wide) for layer in layers]
    unhidden = replace(layers[1], caster=None).specular(wide)
    assert np.max(unhidden - expected[1]) > 0.02 * unhidden.max()
    found = specular_of_layers(layers, wide)
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(specular_of_layers(layers[::-1], wide), expected[::-1])


@pytest.mark.usefixtures("few_pixels_for_the_rest")
def test_the_place_of_the_part_is_found(spout: Scene) -> None:
    found = register(spout, captured(place_part(spout, TRUTH), seed=3), caster=cast_rays_at(spout))
    print(found)
    assert found.warnings == ()
    off = np.array([getattr(found.placement, name) - getattr(TRUTH, name) for name in ("x", "y", "turn")])
    assert np.all(np.abs(off) < 5.0 * np.array(found.placement.errors))
    assert np.hypot(*off[:2]) < 0.02
    assert abs(off[2]) < math.radians(0.05)


def test_the_reflectance_is_found(spout: Scene) -> None:
    truth = replace(spout.reflectance, R_d=38.0, R_s=9000.0, sigma=0.06)
    images = captured(spout, reflectance=truth, seed=4)
    samples = collect_samples(spout, images, caster=cast_rays_at(spout), budget=400)
    lit = sum(len(group) for group in samples.groups if group.layer is not None and group.layer.caster is not None)
    assert lit > 500
    found = fit_reflectance(samples)
    assert found.R_d == pytest.approx(truth.R_d, rel=0.01)
    assert found.R_s == pytest.approx(truth.R_s, rel=0.03)
    assert found.sigma == pytest.approx(truth.sigma, rel=0.02)


def floor_with_wall(high: float) -> trimesh.Trimesh:
    floor, wall = trimesh.creation.box([60, 60, 2]), trimesh.creation.box([2, 60, high])
    floor.apply_translation([0, 0, -1])
    wall.apply_translation([-1, 0, 0.5 * high])
    return trimesh.util.concatenate([floor, wall])


@pytest.mark.parametrize("light", LIGHTS)
def test_light_by_shares_is_that_with_shadows(tmp_path, light) -> None:
    """Of two reflectances, in two postures and exposures, with one ray in a pixel and with three; and as in images."""
    scene = scene_of(tmp_path, floor_with_wall(6.0), LIGHTS[light])
    own = replace(scene.reflectance, sigma=0.15)
    # rough enough for a low ring to be seen in it
    other = PartRegion(name="other", reflectance=replace(own, R_d=20.0, R_s=4000.0, sigma=0.2))
    material = (np.arange(len(scene.mesh.faces)) % 2).astype(np.uint8)
    mesh = replace(scene.mesh, material=material)
    postures = FLAT, Posture(-10.0, 170.0)
    scene = replace(scene, mesh=mesh, reflectance=own, regions=(other,), postures=postures)
    caster, hidden = cast_rays_at(scene), 0.0
    images = list(render(scene))
    observations = expose_all(scene, images, exposures=(1.0, 2.0))
    for rendered in images:
        mine = [image for image in observations if image.posture == rendered.posture]
        clean = trace_pixels(scene, rendered.posture, caster)
        some = np.flatnonzero(clean.clean)[::41]
        row, column = clean.row[some], clean.column[some]
        view = view_of_placed(scene, rendered.posture, Placement())
        for rays in (1, 3):
            pixels = PixelSet.look_up(rendered.posture, row, column, mine, 0.0, rays=rays)
            shares = shares_seen(scene, pixels, view, caster, sigma=own.sigma)
            assert shares.shape == (2, len(mine), rays * len(row))
            assert shares.min() >= 0.0
            assert shares.max() <= 1.0
            hidden = max(hidden, 1.0 - shares.min())
            searched = light_at(scene, pixels, view, caster, sigmas=[own.sigma])
            known = light_at(scene, pixels, view, caster, sigmas=[own.sigma], shares=shares)
            for a, b in zip(known, searched, strict=True):
                np.testing.assert_allclose(a, b, atol=1e-6 * b.max())
            if rays == 1:
                levels = {one.light: one.level[row, column] for one in rendered.lights}
                expected = np.stack([levels[image.light] for image in mine])
                found = own.R_d * known[0] + own.R_s * known[1][0]
                # images leave out what adds less than this [grey level]
                np.testing.assert_allclose(found, expected, atol=0.05)
    assert hidden > 0.3


@pytest.mark.parametrize("away", [2.0, 4.0, 8.0])
def test_a_wall_hides_the_share_of_a_dome_that_its_angle_says(tmp_path, away) -> None:
    """A half space of even light, less what a wall of an elevation φ takes of it: (1 − cos φ) / 2."""
    high, radius, hole = 6.0, 150.0, 33.0
    even = f"{{name: dome, kind: dome, radius_mm: {radius}, camera_hole_mm: {hole}}}"
    scene = scene_of(tmp_path, floor_with_wall(high), even)
    view, caster = view_from_part(scene, FLAT), cast_rays_at(scene)
    vertices = scene.mesh.vertices
    # x is measured from the wall's face; the part stands on the table with the middle of its box on the axis
    face = vertices[vertices[:, 2] > vertices[:, 2].max() - 1e-3][:, 0].max()
    place = np.array([[face + away, 0.0, vertices[:, 2].min() + 2.0]])
    (column,), (row,), _ = project(view.camera, place)
    image = captured(scene)[0]
    pixels = PixelSet.look_up(FLAT, np.array([row], np.int32), np.array([column], np.int32), [image], 0.0)
    shares = shares_seen(scene, pixels, view_of_placed(scene, FLAT, Placement()), caster, sigma=0.05)
    _, seen = trace_samples(caster, scene.mesh, view.camera, *pixels.positions)
    from_wall = seen.points[0, 0] - face  # the pixel's middle is not quite there
    hidden = 0.5 * (1.0 - math.cos(math.atan2(high, from_wall)))
    whole = 1.0 - (0.5 * hole / radius) ** 2
    # an element is seen or not: half a row of them is about so much
    assert shares[0, 0, 0] == pytest.approx(1.0 - hidden / whole, abs=0.06)
    assert shares[1, 0, 0] == pytest.approx(1.0, abs=0.01)  # the camera is above


@pytest.mark.usefixtures("few_pixels_for_the_rest")
@pytest.mark.parametrize("truth", [Placement(x=1.5, y=1.2, turn=0.014), Placement(x=-2.0, y=0.5, turn=-0.017)])
def test_a_part_that_lies_far_off_is_found_under_light_from_its_sides(tmp_path, truth) -> None:
    """Each segment leaves most of the part dark, and shadows end everywhere."""
    ring = scene_of(tmp_path, trimesh.load_mesh(PARTS / "spout.stl"), LIGHTS["low ring"])
    found = register(ring, captured(place_part(ring, truth), seed=3), caster=cast_rays_at(ring))
    assert found.warnings == ()
    assert np.hypot(found.placement.x - truth.x, found.placement.y - truth.y) < 0.02
    assert abs(found.placement.turn - truth.turn) < math.radians(0.05)
