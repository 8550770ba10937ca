"""Fields of directions in which a surface is brushed, and what scenes and files make of them."""

import math

import numpy as np
import pytest

from lightopt import build_scene, render
from lightopt.config import load_part, load_rig
from lightopt.geometry import CurvedBrushing, RoundBrushing, StraightBrushing, TriangleMesh, transformed
from lightopt.optics import Reflectance, SpecularModel, least_white_level
from lightopt.preflight import check_scene
from lightopt.scene import move_part

PLATE = TriangleMesh(
    np.array([[-20.0, -15.0, 0.0], [20.0, -15.0, 0.0], [20.0, 15.0, 0.0], [-20.0, 15.0, 0.0]]),
    np.array([[0, 1, 2], [0, 2, 3]]),
)
UP = np.array([[0.0, 0.0, 1.0]])


def across(field, point, normal=UP):
    mesh = TriangleMesh(PLATE.vertices, PLATE.faces, brushing=(field,))
    (found,) = mesh.across_brushing(np.array([point]), np.asarray(normal, np.float64), np.zeros(1, np.int32))
    return found


def test_a_line_is_projected_onto_the_surface():
    assert np.allclose(np.abs(across(StraightBrushing(np.array([3.0, 0.0, 7.0])), [1.0, 2.0, 0.0])), [0.0, 1.0, 0.0])
    # along the normal, and nearly so
    assert not across(StraightBrushing(np.array([0.0, 0.0, 2.0])), [1.0, 2.0, 0.0]).any()
    assert not across(StraightBrushing(np.array([0.01, 0.0, 1.0])), [1.0, 2.0, 0.0]).any()


def test_around_an_axis_the_lobe_is_wider_towards_the_axis():
    field = RoundBrushing(np.array([5.0, 0.0, 9.0]), np.array([0.0, 0.0, -2.0]))
    assert np.allclose(np.abs(across(field, [5.0, 3.0, 0.0])), [0.0, 1.0, 0.0])
    assert np.allclose(np.abs(across(field, [8.0, 3.0, 0.0])), np.array([1.0, 1.0, 0.0]) / math.sqrt(2.0))
    assert not across(field, [5.0, 0.0, 0.0]).any()


def test_a_curve_counts_where_it_is_nearest():
    curve = CurvedBrushing(np.array([[-9.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 9.0, 0.0]]))
    assert np.allclose(np.abs(across(curve, [-12.0, 1.0, 0.0])), [0.0, 1.0, 0.0])
    assert np.allclose(np.abs(across(curve, [1.0, 11.0, 0.0])), [1.0, 0.0, 0.0])
    # beyond a corner, and half way to it
    assert np.allclose(np.abs(across(curve, [2.0, -3.0, 0.0])), np.array([1.0, 1.0, 0.0]) / math.sqrt(2.0))
    half = 0.5 * np.array([1.0, 0.0]) + 0.5 * np.array([1.0, 1.0]) / math.sqrt(2.0)
    found = across(curve, [-4.5, 1.0, 0.0])
    assert abs(found[:2] @ half) < 1e-12


@pytest.mark.parametrize(
    "field",
    [
        StraightBrushing(np.array([1.0, 0.4, 0.2])),
        RoundBrushing(np.array([5.0, 0.0, 9.0]), np.array([0.1, 0.0, 1.0])),
        CurvedBrushing(np.array([[-9.0, 0.0, 0.0], [0.0, 1.0, 0.0], [3.0, 9.0, 0.0]])),
    ],
)
def test_the_field_moves_with_the_part(field):
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    shift = np.array([3.0, -2.0, 1.0])
    mesh = TriangleMesh(PLATE.vertices, PLATE.faces, brushing=(field,))
    moved = transformed(mesh, turn, shift)
    points = np.array([[4.0, 1.0, 0.0], [-7.0, 2.0, 0.0]])
    normals, face = np.repeat(UP, 2, axis=0), np.zeros(2, np.int32)
    expected = mesh.across_brushing(points, normals, face) @ turn.T
    assert np.allclose(moved.across_brushing(points @ turn.T + shift, normals @ turn.T, face), expected)
    assert PLATE.across_brushing(points, normals, face) is None


def test_the_part_file_is_in_the_mesh_files_coordinates(bench):
    bench.edit("part.yaml", "placement: {", "placement: {rotate_deg: [0, 0, 90], ")
    own = "sigma_rad: 0.0475, sigma_across_rad: 0.19, brushing: {direction: [1, 0, 0]}"
    bench.edit("part.yaml", "sigma_rad: 0.0475", own)
    scene = build_scene(bench.rig, bench.part)
    assert scene.reflectance.model.across_ratio == pytest.approx(4.0)
    (field,) = scene.mesh.brushing
    assert np.allclose(field.along(np.zeros((1, 3))), [[0.0, 1.0, 0.0]])
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    (field,) = move_part(scene, quarter, np.zeros(3)).mesh.brushing
    assert np.allclose(field.along(np.zeros((1, 3))), [[-1.0, 0.0, 0.0]])


def test_a_highlight_is_longer_across_the_brushing(bench):
    """On a flat plate the lobe of a small light is an ellipse, whose axes are as σ_across to σ."""
    bench.edit("rig.yaml", "size_mm: [60, 60], points: 4", "size_mm: [1, 1], points: 1")
    mesh = bench.folder / "knob.stl"
    mesh.write_bytes(_stl(np.array([[-40, -40, 0], [40, -40, 0], [40, 40, 0], [-40, 40, 0]], np.float64)))
    bench.edit("part.yaml", "postures:", "postures: [{elevation_deg: 0, rotation_deg: 0}]  #")
    text = "sigma_rad: 0.01, sigma_across_rad: 0.04, brushing: {direction: [0, 1, 0]}"
    bench.edit("part.yaml", "sigma_rad: 0.0475", text)
    bench.edit("part.yaml", "R_d: 45.0, R_s: 12500", "R_d: 0.0, R_s: 200")
    bench.edit(
        "rig.yaml",
        "distance_mm: 330, elevation_deg: 60, azimuth_deg: 45",
        "distance_mm: 330, elevation_deg: 88, azimuth_deg: 45",
    )
    level = next(iter(render(build_scene(bench.rig, bench.part)))).lights[0].level
    rows, columns = np.indices(level.shape)
    centre = np.sum(rows * level) / level.sum(), np.sum(columns * level) / level.sum()
    spread = [np.sum((at - c) ** 2 * level) / level.sum() for at, c in zip((rows, columns), centre, strict=True)]
    assert spread[1] / spread[0] > 4.0


@pytest.mark.parametrize(
    ("direction", "kind", "words"), [("1, 0, 0", "ok", "100 %"), ("0, 0, 1", "warning", "mesh file")]
)
def test_check_says_where_the_brushing_has_a_direction(bench, direction, kind, words):
    (bench.folder / "knob.stl").write_bytes(
        _stl(np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], np.float64))
    )
    bench.edit("part.yaml", "postures:", "postures: [{elevation_deg: 0, rotation_deg: 0}]  #")
    text = f"sigma_rad: 0.02, sigma_across_rad: 0.1, brushing: {{direction: [{direction}]}}"
    bench.edit("part.yaml", "sigma_rad: 0.0475", text)
    findings = check_scene(load_rig(bench.rig), load_part(bench.part)).findings
    (found,) = [one for one in findings if one.topic == "brushing"]
    assert found.level == kind
    assert words in found.text
    assert "5 times as wide" in found.text


def test_bright_field_reaches_farther_across_the_brushing(bench):
    shares = {}
    for name, more in {"plain": "", "brushed": ", sigma_across_rad: 0.2, brushing: {direction: [0, 1, 0]}"}.items():
        folder = bench.folder / name
        folder.mkdir()
        for file in ("rig.yaml", "knob.stl"):
            (folder / file).write_bytes((bench.folder / file).read_bytes())
        part = bench.part.read_text(encoding="utf-8").replace("sigma_rad: 0.0475", f"sigma_rad: 0.02{more}")
        (folder / "part.yaml").write_text(part, encoding="utf-8")
        findings = check_scene(load_rig(folder / "rig.yaml"), load_part(folder / "part.yaml")).findings
        shares[name] = [one.values["bright field"] for one in findings if one.topic == "bright field"]
    assert np.all(np.array(shares["brushed"]) > 1.5 * np.array(shares["plain"]))


def _stl(corners):
    faces = ((0, 1, 2), (0, 2, 3))
    lines = ["solid plate"]
    for face in faces:
        lines += ["facet normal 0 0 1", "outer loop", *(f"vertex {x} {y} {z}" for x, y, z in corners[list(face)])]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid plate", ""]).encode()


@pytest.mark.parametrize(("name", "tolerance"), [("torrance-sparrow", 0.01), ("ggx", 0.05)])
def test_it_reflects_as_many_times_more_light_as_it_is_wider_across(name, tolerance):
    own = Reflectance(R_d=0.0, R_s=100.0, sigma=0.01, model=SpecularModel(name=name))
    brushed = Reflectance(R_d=0.0, R_s=100.0, sigma=0.01, model=SpecularModel(name=name, across_ratio=6.0))
    assert least_white_level(brushed) / least_white_level(own) == pytest.approx(6.0, rel=tolerance)
