"""Defects of part files on the part: where they come to lie, and what is refused."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import trimesh

from lightopt import build_scene
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture, rotation_z
from lightopt.defects import BUILT_IN_CATALOGUE, surface_coordinates
from lightopt.geometry import SurfaceFinder, TriangleMesh
from lightopt.scene import build_catalogue, defect_facts, move_part, project, view_from_part


def with_defects(bench, *defects, key="defects"):
    text = bench.part.read_text(encoding="utf-8")
    bench.part.write_text(f"{text}{key}: {json.dumps(defects)}\n", encoding="utf-8")


def dent(**values):
    return {"name": "a", "kind": "dent", "size_mm": 2, "slope_deg": 5, **values}


def at_pixel(column, row, posture=(0, 0)):
    return {"at_pixel": {"posture": {"elevation_deg": posture[0], "rotation_deg": posture[1]}, "pixel": [column, row]}}


@pytest.fixture
def box(bench):
    """A box of 20 × 12 × 6 mm about (100, 0, 0), turned by 90° about Z, resting on the table."""
    mesh = trimesh.creation.box((20, 12, 6))
    mesh.apply_translation((100, 0, 0))
    mesh.export(bench.mesh)
    bench.edit("part.yaml", "translate_mm: [0, 0, 0]", "rotate_deg: [0, 0, 90]")
    return bench


def test_positions_and_directions_are_the_mesh_files(box):
    """Top of the box at file (104, 1, 3): turned by 90° and centred it is at (−1, 4, 6), file X along world Y."""
    with_defects(box, dent(at_mm=[104, 1, 3], size_mm=[3, 1]))
    scene = build_scene(box.rig, box.part)
    (one,) = scene.defects
    np.testing.assert_allclose(one.position, [-1, 4, 6], atol=1e-9)
    np.testing.assert_allclose(one.normal, [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(one.along, [0, 1, 0], atol=1e-9)
    (facts,) = defect_facts(scene.defects, scene.placement)
    assert facts["position_mm"] == [104, 1, 3]
    assert (facts["normal"], facts["along"]) == ([0, 0, 1], [1, 0, 0])
    assert (facts["size_mm"], facts["slope_deg"]) == ([3, 1], 5)
    assert facts["depth_mm"] == pytest.approx(math.tan(math.radians(5)) / math.pi, abs=1e-6)
    assert facts["area_mm2"] == pytest.approx(math.pi * 3 / 4, abs=1e-6)


def test_what_is_on_a_part_moves_with_it(box):
    """Where it is on the part, in the file's coordinates, stays; where it is in the world moves as the mesh does."""
    with_defects(box, dent(at_mm=[104, 1, 3], size_mm=[3, 1]))
    scene = build_scene(box.rig, box.part)
    turn, shift = rotation_z(math.radians(30)), np.array([3.0, -2.0, 0.5])
    moved = move_part(scene, turn, shift)
    (one,) = moved.defects
    np.testing.assert_allclose(one.position, turn @ scene.defects[0].position + shift, atol=1e-12)
    np.testing.assert_allclose(SurfaceFinder(moved.mesh).nearest(one.position).point, one.position, atol=1e-9)
    np.testing.assert_allclose(one.along, turn @ [0, 1, 0], atol=1e-12)
    (before,) = defect_facts(scene.defects, scene.placement)
    (after,) = defect_facts(moved.defects, moved.placement)
    assert after["position_mm"] == pytest.approx(before["position_mm"])
    assert after["along"] == pytest.approx(before["along"], abs=1e-6)


def test_a_position_beside_the_surface_is_moved_to_it(box):
    with_defects(box, dent(at_mm=[104, 1, 3.3]))
    scene = build_scene(box.rig, box.part)
    np.testing.assert_allclose(scene.defects[0].position, [-1, 4, 6], atol=1e-9)


def test_a_position_off_the_surface_is_refused_with_the_nearest(box):
    with_defects(box, dent(at_mm=[104, 1, 5]), dent(name="b", at_mm=[0, 0, 0]))
    with pytest.raises(InputError) as error:
        build_scene(box.rig, box.part)
    first, second = error.value.messages
    assert first.startswith(f"{box.part}:7: defects[0].at_mm: expected a place on the part's surface, within 0.4 mm")
    assert "the nearest, [104, 1, 3], is 2 mm away" in first
    assert "defects[1].at_mm" in second
    build_scene(box.rig, box.part, defects=False)


def test_a_pixel_names_the_place_that_it_sees(bench):
    with_defects(bench, dent(**at_pixel(80, 50, (-10, 170))))
    scene = build_scene(bench.rig, bench.part)
    camera = view_from_part(scene, Posture(-10, 170)).camera
    columns, rows, _ = project(camera, scene.defects[0].position[None])
    assert (columns[0], rows[0]) == (pytest.approx(80.5, abs=1e-6), pytest.approx(50.5, abs=1e-6))


@pytest.mark.parametrize(
    ("pixel", "message"),
    [
        ((2, 2), "pixel [2, 2] does not see the part; choose one that does"),
        ((160, 5), "expected a pixel of the image, 160 × 120, found [160, 5]"),
        ((80, 60, (-60, 0)), "elevation -60° is outside the stage's range -45° to 45°"),
    ],
)
def test_a_pixel_that_sees_nothing_is_refused(bench, pixel, message):
    with_defects(bench, dent(**at_pixel(*pixel)))
    with pytest.raises(InputError) as error:
        build_scene(bench.rig, bench.part)
    assert message in str(error.value)
    assert "defects[0].at_pixel" in str(error.value)


def test_a_haze_that_no_lobe_can_have_is_refused(bench):
    haze = {"name": "h", "kind": "haze", "size_mm": 2, "sigma_factor": 20}
    with_defects(bench, {**haze, **at_pixel(80, 60)})
    with pytest.raises(
        InputError, match=r"sigma_factor: makes sigma 0\.95 rad of 0\.0475; expected from 1e-05 to 0\.5"
    ):
        build_scene(bench.rig, bench.part)


def test_the_catalogue_is_the_parts_or_the_built_in_one(bench):
    from lightopt.config import load_part

    assert build_catalogue(load_part(bench.part)) == BUILT_IN_CATALOGUE
    with_defects(bench, {"name": "mine", "kind": "pit", "size_mm": 1, "depth_mm": 0.1}, key="defect_catalogue")
    (entry,) = build_catalogue(load_part(bench.part))
    assert (entry.name, entry.shape.depth) == ("mine", pytest.approx(0.1))
    haze = {"name": "h", "kind": "haze", "size_mm": 2, "sigma_factor": 20}
    bench.part.write_text(bench.part.read_text(encoding="utf-8").rpartition("defect_cat")[0], encoding="utf-8")
    with_defects(bench, haze, key="defect_catalogue")
    with pytest.raises(InputError, match=r"defect_catalogue\[0\]\.sigma_factor: makes sigma"):
        build_catalogue(load_part(bench.part))


def test_the_nearest_place_is_that_of_dense_samples():
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=10.0)
    mine = TriangleMesh(mesh.vertices, mesh.faces.astype(np.int32), None)
    finder = SurfaceFinder(mine)
    rng = np.random.default_rng(0)
    weights = rng.dirichlet([1, 1, 1], size=(len(mesh.faces), 400))
    samples = np.einsum("fkw,fwj->fkj", weights, mesh.vertices[mesh.faces]).reshape(-1, 3)
    for point in [*rng.normal(0, 8, (20, 3)), *mesh.vertices[:3] * 1.2, mesh.triangles_center[5]]:
        place = finder.nearest(point)
        distance = np.linalg.norm(place.point - point)
        best = np.linalg.norm(samples - point, axis=1).min()
        assert best - 0.1 <= distance <= best + 1e-12
        corners = mesh.vertices[mesh.faces[place.face]]
        assert abs((place.point - corners[0]) @ mesh.face_normals[place.face]) < 1e-9
        np.testing.assert_allclose(place.normal, mesh.face_normals[place.face], atol=1e-9)


def test_surface_coordinates_of_a_placed_defect(box):
    with_defects(box, dent(at_mm=[104, 1, 3], size_mm=[3, 1], direction_deg=90))
    (one,) = build_scene(box.rig, box.part).defects
    x, y, same = surface_coordinates(one, np.array([[-2.0, 4, 6], [-1, 5, 6]]), np.array([[0, 0, 1.0]] * 2))
    np.testing.assert_allclose([x, y], [[1, 0], [0, -1]], atol=1e-9)
    assert same.all()


def test_the_bench_shows_defects_where_the_part_lies(box):
    """A stain that is 1 mm aside in the file, or the part 1 mm aside on the bench, looks the same but for the rim."""
    from lightopt.rig.simulated._bench_process import BenchTruth
    from lightopt.rig.simulated._optics import BenchOptics

    clean = box.part.read_text(encoding="utf-8")

    def change(x, offset):
        images = []
        for text in (clean, None):
            box.part.write_text(clean, encoding="utf-8")
            if text is None:
                with_defects(box, {"name": "a", "kind": "stain", "size_mm": 3, "R_d_factor": 0.2, "at_mm": [x, 0, 3]})
            scene = build_scene(box.rig, box.part)
            optics = BenchOptics(scene, BenchTruth(part_offset_mm=offset))
            images.append(optics.frame({scene.lights[0].name: 1.0}, scene.postures[0], exposure=1.0).astype(float))
        dark = images[0] - images[1] > 5
        rows, columns = np.nonzero(dark)
        return len(rows), rows.mean(), columns.mean()

    still, aside = change(100, (0.0, 0.0, 0.0)), change(100, (0.0, 1.0, 0.0))
    other = change(101, (0.0, 0.0, 0.0))  # file X is world Y here
    assert still[0] > 20
    assert aside[0] == pytest.approx(still[0], abs=0.2 * still[0])
    np.testing.assert_allclose(aside[1:], other[1:], atol=0.3)
    assert math.dist(aside[1:], still[1:]) > 1
