"""Building a scene: placement, lens, lights, postures, and what is refused with which words."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st

from lightopt import build_scene, load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture

# a block whose three sides differ and that stands off the origin: every shift and turn shows
SIDES = np.array([30.0, 20.0, 10.0])
AT = np.array([5.0, -3.0, 40.0])


@pytest.fixture
def block(bench):
    """The bench with that block for a part."""
    mesh = trimesh.creation.box(SIDES, trimesh.transformations.translation_matrix(AT))
    bench.mesh.write_bytes(bytes(mesh.export(file_type="stl")))
    bench.edit("part.yaml", ", {elevation_deg: -10, rotation_deg: 170}", "")
    return bench


def bounds(bench, placement):
    bench.edit("part.yaml", "{anchor: rest_on_table, translate_mm: [0, 0, 0]}", placement)
    return build_scene(bench.rig, bench.part).mesh.bounds


# --- placement


@pytest.mark.parametrize(
    ("placement", "low"),
    [
        ("{anchor: as_modelled}", AT - SIDES / 2),
        ("{anchor: rest_on_table}", [-15, -10, 0]),
        ("{anchor: centred}", [-15, -10, -5]),
        ("{}", [-15, -10, 0]),
        ("{anchor: as_modelled, translate_mm: [1, 2, 3]}", AT - SIDES / 2 + [1, 2, 3]),
        ("{anchor: rest_on_table, translate_mm: [1, 2, 3]}", [-14, -8, 3]),
        ("{anchor: centred, translate_mm: [1, 2, 3]}", [-14, -8, -2]),
    ],
)
def test_anchors(block, placement, low):
    low_found, high_found = bounds(block, placement)
    assert np.allclose(low_found, low, atol=1e-5)
    assert np.allclose(high_found - low_found, SIDES, atol=1e-5)


@pytest.mark.parametrize(
    ("rotate", "sides"), [("[90, 0, 0]", (30, 10, 20)), ("[0, 90, 0]", (10, 20, 30)), ("[0, 0, 90]", (20, 30, 10))]
)
def test_the_part_is_turned_before_the_anchor(block, rotate, sides):
    low, high = bounds(block, f"{{anchor: rest_on_table, rotate_deg: {rotate}}}")
    assert np.allclose(high - low, sides, atol=1e-5)
    assert np.allclose([low[2], low[0] + high[0], low[1] + high[1]], 0.0, atol=1e-5)


def test_rotations_are_about_fixed_x_then_y_then_z(block):
    """X by 90° takes (x, y, z) to (x, −z, y); Y by 90° that to (y, −z, −x); Z by 90° that to (z, y, −x)."""
    low, high = bounds(block, "{anchor: as_modelled, rotate_deg: [90, 90, 90]}")
    centre = 0.5 * (low + high)
    assert np.allclose(centre, [AT[2], AT[1], -AT[0]], atol=1e-5)
    assert np.allclose(high - low, [10, 20, 30], atol=1e-5)


def test_the_part_file_unit_is_converted_to_mm(block):
    block.edit("part.yaml", "units: mm", "units: cm")
    scene = build_scene(block.rig, block.part)
    assert np.allclose(np.diff(scene.mesh.bounds, axis=0), 10 * SIDES, atol=1e-4)


def test_smooth_and_facet_normals(block):
    assert build_scene(block.rig, block.part).mesh.normals is not None
    block.edit("part.yaml", "units: mm}", "units: mm, normals: facet}")
    assert build_scene(block.rig, block.part).mesh.normals is None


# --- camera


@given(f=st.floats(5.0, 100.0), a=st.floats(150.0, 2000.0))
def test_a_focal_length_is_the_image_distance_it_focuses_to(shared_bench, f, a):
    from lightopt.config import RigConfig
    from lightopt.scene import build_camera

    plain = load_rig(shared_bench.rig)
    lens = {"focal_length_mm": f, "image_distance_mm": None, "distance_mm": a}
    rig = RigConfig.model_validate(
        {**plain.model_dump(exclude={"camera"}), "camera": {**plain.camera.model_dump(), **lens}}
    )
    b = build_camera(rig).image_distance
    assert 1.0 / f == pytest.approx(1.0 / a + 1.0 / b, rel=1e-12)
    assert b > f


def test_fifty_mm_focused_at_550_is_55_mm(block):
    plain = build_scene(block.rig, block.part)
    block.edit("rig.yaml", "image_distance_mm: 55", "focal_length_mm: 50")
    lens = build_scene(block.rig, block.part)
    assert lens.camera.image_distance == pytest.approx(plain.camera.image_distance, rel=1e-14) == 55.0


def test_a_camera_at_105_degrees_leans_beyond_the_zenith(block):
    block.edit("rig.yaml", "elevation_deg: 90\n  resolution", "elevation_deg: 105\n  resolution")
    camera = build_scene(block.rig, block.part).camera
    # azimuth 270 leans towards −Y up to the zenith and towards +Y beyond it
    lean = math.radians(15.0)
    assert np.allclose(camera.position, [0.0, 550 * math.sin(lean), 550 * math.cos(lean)], atol=1e-9)
    assert np.allclose(camera.forward, [0.0, -math.sin(lean), -math.cos(lean)], atol=1e-12)
    assert np.allclose(camera.right, [1.0, 0.0, 0.0], atol=1e-12)
    assert np.allclose(camera.up, [0.0, math.cos(lean), -math.sin(lean)], atol=1e-12)


def test_plan_view_has_x_right_and_y_up(block):
    camera = build_scene(block.rig, block.part).camera
    assert np.allclose([camera.right, camera.up, -camera.forward], np.eye(3), atol=1e-12)


def test_sensor_and_reflectance_arrive(block):
    block.edit(
        "rig.yaml",
        "{bit_depth: 8, read_noise_levels: 0.8, electrons_per_level: 60}",
        "{bit_depth: 12, saturation_level: 4080, black_level: 64, read_noise_levels: 2, electrons_per_level: 5}",
    )
    block.edit("part.yaml", "sigma_rad: 0.0475", "sigma_rad: 0.1, full_scale: 1000, diffuse_exponent: 1.12")
    scene = build_scene(block.rig, block.part)
    s, r = scene.sensor, scene.reflectance
    assert (s.bit_depth, s.saturated_from, s.black_level) == (12, 4080, 64)
    assert (s.read_noise_levels, s.electrons_per_level) == (2, 5)
    assert (r.R_d, r.R_s, r.sigma, r.full_scale) == (45.0, 12500, 0.1, 1000)
    assert r.diffuse == (1.12, 0.0)
    block.edit("part.yaml", "diffuse_exponent: 1.12", "oren_nayar_roughness: 0.3")
    assert build_scene(block.rig, block.part).reflectance.diffuse == (1.0, 0.3)


@pytest.mark.parametrize("coefficients", ["{k1: -1.5}", "{k1: 0.5, k2: -9}", "{p1: 3}"])
def test_a_lens_that_folds_is_refused_by_its_line(block, coefficients):
    block.edit("rig.yaml", "image_distance_mm: 55", f"image_distance_mm: 5\n  distortion: {coefficients}")
    with pytest.raises(InputError, match="folds the image over") as error:
        build_scene(block.rig, block.part)
    assert str(error.value).startswith(f"{block.rig}:9: camera.distortion: ")


def test_a_lens_of_usual_distortion_is_fine(block):
    block.edit(
        "rig.yaml", "image_distance_mm: 55", "image_distance_mm: 55\n  distortion: {k1: -0.3, k2: 0.1, p1: 0.001}"
    )
    assert not build_scene(block.rig, block.part).camera.distortion.is_zero


# --- lights


def test_lights_inherit_from_light_source_what_they_do_not_override(block):
    block.edit(
        "rig.yaml",
        "{size_mm: [60, 60], points: 4}",
        "{size_mm: [60, 40], points: 9, falloff: inverse_square, emission_exponent: 2, normalisation: sum}",
    )
    block.edit(
        "rig.yaml",
        "gain: 0.8}",
        "gain: 0.8, size_mm: [10, 20], points: 16, falloff: none, emission_exponent: 0, normalisation: mean}",
    )
    shared, own = build_scene(block.rig, block.part).lights
    assert (shared.size, shared.points, shared.inverse_square, shared.emission_exponent, shared.gain) == (
        (60, 40),
        9,
        True,
        2,
        1.0,
    )
    assert shared.total_weight == 9.0
    assert (own.size, own.points, own.inverse_square, own.emission_exponent, own.gain) == ((10, 20), 16, False, 0, 0.8)
    assert own.total_weight == 0.8


def test_one_key_may_be_overridden_alone(block):
    block.edit("rig.yaml", "gain: 0.8", "points: auto")
    first, second = build_scene(block.rig, block.part).lights
    assert (first.points, second.points) == (4, "auto")
    assert first.size == second.size == (60, 60)


def test_lights_stand_where_they_are_said_to(block):
    lights = {light.name: light for light in build_scene(block.rig, block.part).lights}
    s = math.sqrt(0.5)
    assert np.allclose(lights["light1"].centre, 330 * np.array([0.5 * s, 0.5 * s, math.sqrt(0.75)]))
    assert np.allclose(lights["light3"].centre, 330 * np.array([-0.5, -0.5, s]))


def test_points_requested_replace_all_others(block):
    block.edit("rig.yaml", "gain: 0.8", "points: 16")
    assert [light.points for light in build_scene(block.rig, block.part, points="auto").lights] == ["auto"] * 2
    assert [light.points for light in build_scene(block.rig, block.part, points=1).lights] == [1, 1]
    for wrong in (5, 0, -4, 4.0, "foo"):
        with pytest.raises(InputError, match="expected a square"):
            build_scene(block.rig, block.part, points=wrong)


def test_lights_requested_come_in_the_order_of_the_rig(block):
    names = [light.name for light in build_scene(block.rig, block.part, lights=["light3", "light1"]).lights]
    assert names == ["light1", "light3"]
    assert [light.name for light in build_scene(block.rig, block.part, lights=["light3"]).lights] == ["light3"]


def test_every_unknown_light_is_named(block):
    with pytest.raises(InputError) as error:
        build_scene(block.rig, block.part, lights=["light1", "light2", "Light3"])
    assert error.value.messages == (
        f'no light "light2" in {block.rig}; it has light1, light3',
        f'no light "Light3" in {block.rig}; it has light1, light3',
    )


# --- postures


def test_postures_are_those_of_the_part_or_those_requested(bench):
    assert build_scene(bench.rig, bench.part).postures == (Posture(0.0, 0.0), Posture(-10.0, 170.0))
    requested = [Posture(45.0, 360.0), Posture(-45.0, 0.0)]  # the ends of the stage's ranges
    assert build_scene(bench.rig, bench.part, postures=requested).postures == tuple(requested)


def test_postures_beyond_the_stage_name_both_places(bench):
    bench.edit("part.yaml", "{elevation_deg: 0, rotation_deg: 0}", "{elevation_deg: 46, rotation_deg: -1}")
    with pytest.raises(InputError) as error:
        build_scene(bench.rig, bench.part)
    assert error.value.messages == (
        (
            f"{bench.part}:5: postures[0]: elevation 46° is outside the stage's range -45° to 45° "
            f"({bench.rig}:14: stage.elevation_range_deg)"
        ),
        (
            f"{bench.part}:5: postures[0]: rotation -1° is outside the stage's range 0° to 360° "
            f"({bench.rig}:14: stage.rotation_range_deg)"
        ),
    )
    with pytest.raises(InputError, match=re.escape("elevation 45.01° is outside")):
        build_scene(bench.rig, bench.part, postures=[Posture(45.01, 0.0)])


def test_a_rig_without_a_stage_takes_any_posture(bench):
    bench.edit("rig.yaml", "stage: {elevation_range_deg: [-45, 45], rotation_range_deg: [0, 360]}\n", "")
    scene = build_scene(bench.rig, bench.part, postures=[Posture(20.0, -190.0)])
    assert np.array_equal(scene.pivot, np.zeros(3))


# --- paths and configurations


def test_paths_and_loaded_files_give_the_same_scene(bench):
    a = build_scene(bench.rig, bench.part)
    b = build_scene(load_rig(str(bench.rig)), load_part(bench.part))
    assert np.array_equal(a.mesh.vertices, b.mesh.vertices)
    assert a.postures == b.postures
    assert [light.name for light in a.lights] == [light.name for light in b.lights]
