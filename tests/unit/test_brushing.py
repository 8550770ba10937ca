"""Fields of directions in which a surface is brushed, and what scenes and files make of them."""

import math
import re

import numpy as np
import pytest
import trimesh

from lightopt import build_scene, render
from lightopt.config import load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.geometry import (
    BoxRegion,
    CurvedBrushing,
    LoadedMesh,
    NamedRegion,
    RoundBrushing,
    StraightBrushing,
    TriangleMesh,
    load_mesh,
    mesh_with_regions,
    texture_brushing,
    transformed,
)
from lightopt.optics import Reflectance, SpecularModel, least_white_level
from lightopt.preflight import check_scene
from lightopt.scene import move_part

PLATE = TriangleMesh(
    np.array([[-20.0, -15.0, 0.0], [20.0, -15.0, 0.0], [20.0, 15.0, 0.0], [-20.0, 15.0, 0.0]]),
    np.array([[0, 1, 2], [0, 2, 3]]),
)
UP = np.array([[0.0, 0.0, 1.0]])
ANY_FACE = np.zeros(1, np.int32)


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
        texture_brushing(
            LoadedMesh(PLATE, (), texture=(PLATE.vertices @ [[1, 2], [0.4, 1], [0, 0]])[PLATE.faces]), "u"
        ),
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
    assert np.allclose(field.along(np.zeros((1, 3)), ANY_FACE), [[0.0, 1.0, 0.0]])
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    (field,) = move_part(scene, quarter, np.zeros(3)).mesh.brushing
    assert np.allclose(field.along(np.zeros((1, 3)), ANY_FACE), [[-1.0, 0.0, 0.0]])


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
    own = Reflectance(R_d=0.0, R_s=100.0, sigma=0.003, model=SpecularModel(name=name))
    brushed = Reflectance(R_d=0.0, R_s=100.0, sigma=0.003, model=SpecularModel(name=name, across_ratio=6.0))
    assert least_white_level(brushed) / least_white_level(own) == pytest.approx(6.0, rel=tolerance)


def grid(columns, rows):
    """Corners of the triangles of a grid over the unit square, shape (m, 3, 2), cut along either diagonal in turn."""
    s, t = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
    a = np.stack([s.ravel(), t.ravel()], axis=1)
    b, c, d = (a + np.array(step) for step in ((1, 0), (1, 1), (0, 1)))
    other = (a.sum(axis=1) % 2 == 1)[:, None, None]
    first = np.where(other, np.stack([a, b, d], axis=1), np.stack([a, b, c], axis=1))
    second = np.where(other, np.stack([b, c, d], axis=1), np.stack([a, c, d], axis=1))
    return np.concatenate([first, second]) / (columns, rows)


def flat(square):
    """The square as a plate of 40 mm."""
    return np.concatenate([40.0 * square - 20.0, np.zeros((len(square), 3, 1))], axis=2)


def tube(texture):
    """The square as a cylinder about Z of radius 12 mm and height 30 mm, open at its ends."""
    turn = 2.0 * math.pi * (texture[..., 0] % 1.0)
    return np.stack([12.0 * np.cos(turn), 12.0 * np.sin(turn), 30.0 * texture[..., 1]], axis=2)


def write_mesh(path, corners, texture):
    """A file of triangles and texture coordinates, (m, 3, 3) and (m, 3, 2), as the format has them."""
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    if path.suffix == ".obj":
        lines = [f"v {x} {y} {z}" for x, y, z in corners.reshape(-1, 3).tolist()]
        lines += [f"vt {u} {v}" for u, v in texture.reshape(-1, 2).tolist()]
        lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in (faces + 1).tolist()]
        path.write_text("\n".join(lines))
        return
    vertices = corners.reshape(-1, 3)
    if path.suffix == ".glb":  # Y up, and trimesh writes 1 − v
        vertices = np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], axis=1)
    visual = trimesh.visual.TextureVisuals(uv=texture.reshape(-1, 2))
    mesh = trimesh.Trimesh(vertices, faces, visual=visual, process=False)
    path.write_bytes(mesh.export(file_type=path.suffix[1:]))


def load(path, **changes):
    options = {"unit_mm": 1.0, "normals": "smooth", "crease_angle": 0.5, "pieces": True, **changes}
    return load_mesh(path, **options)


@pytest.mark.parametrize("suffix", [".obj", ".glb", ".ply"])
def test_a_texture_around_a_cylinder_is_brushing_around_its_axis(tmp_path, suffix):
    """Also at the seam, where the texture ends and begins again; to the single precision of the files."""
    path, texture = tmp_path / f"part{suffix}", grid(40, 3)
    write_mesh(path, tube(texture), texture)
    loaded = load(path)
    face = np.arange(len(loaded.mesh.faces), dtype=np.int32)
    for weights in ([0.2, 0.3, 0.5], [0.0, 0.05, 0.95]):
        points = np.einsum("c,mcj->mj", weights, loaded.mesh.vertices[loaded.mesh.faces])
        normals = np.einsum("c,mcj->mj", weights, loaded.mesh.normals[loaded.mesh.faces])
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        for along, field in (("u", RoundBrushing(np.zeros(3), UP[0])), ("v", StraightBrushing(UP[0]))):
            ours = TriangleMesh(
                loaded.mesh.vertices, loaded.mesh.faces, brushing=(texture_brushing(loaded, along),)
            ).across_brushing(points, normals, face)
            other = TriangleMesh(PLATE.vertices, PLATE.faces, brushing=(field,)).across_brushing(points, normals, face)
            assert np.abs(np.cross(ours, other)).max() < 2e-5
            assert np.linalg.norm(ours, axis=1) == pytest.approx(1.0)


def brushed_bench(bench, corners, texture, brushing, file="part.obj"):
    write_mesh(bench.folder / file, corners, texture)
    units = "" if file.endswith(".glb") else ", units: mm"
    bench.edit("part.yaml", "mesh: {file: knob.stl, units: mm}", f"mesh: {{file: {file}{units}}}")
    bench.edit("part.yaml", "postures:", "postures: [{elevation_deg: 0, rotation_deg: 20}]  #")
    bench.edit("part.yaml", "sigma_rad: 0.0475", f"sigma_rad: 0.02, sigma_across_rad: 0.2, brushing: {brushing}")


def image(bench):
    return next(iter(render(build_scene(bench.rig, bench.part)))).lights[0].level


@pytest.mark.parametrize("file", ["part.obj", "part.glb"])
def test_a_cylinder_unrolled_gives_the_image_of_brushing_around_its_axis(bench, file):
    texture = grid(64, 3)
    corners = tube(texture) / (1000.0 if file == "part.glb" else 1.0)
    brushed_bench(bench, corners, texture, "{along_texture: u}", file)
    bench.edit("part.yaml", "placement: {", "placement: {rotate_deg: [90, 0, 0], ")
    found = image(bench)
    bench.edit("part.yaml", "{along_texture: u}", "{around_axis: {direction: [0, 0, 1]}}")
    expected = image(bench)
    assert expected.max() > 100.0
    assert found == pytest.approx(expected, abs=0.02)
    bench.edit("part.yaml", "{around_axis: {direction: [0, 0, 1]}}", "{along_texture: v}")
    assert np.abs(image(bench) - expected).max() > 20.0


@pytest.mark.parametrize(("angle", "scale"), [(0.0, (1.0, 1.0)), (0.7, (1.0, 1.0)), (0.7, (300.0, 0.02))])
def test_a_plate_is_brushed_along_its_texture(bench, angle, scale):
    """The texture lies aslant and is stretched: u grows along a direction of its own, and v does not change there."""
    square = grid(4, 3)
    corners = flat(square)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    brushed_bench(bench, corners, square @ turn * scale, "{along_texture: u}")
    near = "distance_mm: 330, elevation_deg: 84, azimuth_deg: 45"
    bench.edit("rig.yaml", "distance_mm: 330, elevation_deg: 60, azimuth_deg: 45", near)
    found = image(bench)
    bench.edit("part.yaml", "{along_texture: u}", f"{{direction: [{math.cos(angle)}, {math.sin(angle)}, 0]}}")
    expected = image(bench)
    assert expected.max() > 100.0
    assert found == pytest.approx(expected, abs=1e-3)
    bench.edit("part.yaml", f"{{direction: [{math.cos(angle)}, {math.sin(angle)}, 0]}}", "{along_texture: v}")
    assert np.abs(image(bench) - expected).max() > 20.0


def ring(texture):
    """A flat ring with radii of 5 and 20 mm, which the unit square is wound around."""
    turn, radius = 2.0 * math.pi * (texture[..., 0] % 1.0), 5.0 + 15.0 * texture[..., 1]
    return np.stack([radius * np.cos(turn), -radius * np.sin(turn), np.zeros_like(turn)], axis=2)


@pytest.mark.parametrize(("normals", "least", "most"), [("smooth", 0.0, 0.02), ("facet", 0.05, 0.1)])
def test_the_direction_turns_evenly_unless_facets_are_flat(tmp_path, normals, least, most):
    """Of a faced ring of 36 pieces: a direction is up to 0.8° off, that of a facet up to 5°."""
    texture = grid(36, 8)
    write_mesh(tmp_path / "part.obj", ring(texture), texture)
    loaded = load(tmp_path / "part.obj", normals=normals)
    field = texture_brushing(loaded, "u")
    face = np.repeat(np.arange(len(loaded.mesh.faces), dtype=np.int32), 4)
    weights = np.random.default_rng(3).dirichlet((1.0, 1.0, 1.0), len(face))
    points = np.einsum("kc,kcj->kj", weights, loaded.mesh.vertices[loaded.mesh.faces][face])
    found = field.along(points, face)
    found /= np.linalg.norm(found, axis=1)[:, None]
    off = np.abs(np.einsum("ij,ij->i", found, points / np.linalg.norm(points, axis=1)[:, None]))
    assert least < off.max() < most


def test_a_mirrored_texture_has_the_same_lines_on_both_sides(tmp_path):
    """Its u grows to both sides of the middle, whose vertices both sides share."""
    square = grid(6, 4)
    write_mesh(tmp_path / "part.obj", flat(square), np.abs(2.0 * square - [1.0, 0.0]))
    assert np.allclose(np.abs(texture_brushing(load(tmp_path / "part.obj"), "u").directions), [1.0, 0.0, 0.0])


def test_faces_without_direction_are_counted(bench):
    square = grid(4, 3)
    corners = flat(square)
    texture = square.copy()
    texture[:5, :, 1] = 0.5
    brushed_bench(bench, corners, texture, "{along_texture: u}")
    scene = build_scene(bench.rig, bench.part)
    (warning,) = scene.warnings
    assert "part.yaml:6: reflectance.brushing: 5 of 24 triangles have no texture coordinates" in warning
    assert not scene.mesh.across_brushing(np.zeros((5, 3)), np.repeat(UP, 5, axis=0), np.arange(5)).any()
    findings = check_scene(load_rig(bench.rig), load_part(bench.part)).findings
    (found,) = [one for one in findings if one.topic == "brushing"]
    assert found.level == "warning"
    assert found.text.endswith("79 % of this surface in view; on the rest the texture coordinates have none")
    write_mesh(bench.folder / "part.obj", corners, 0.0 * texture)
    with pytest.raises(InputError, match=r"part.yaml:6: reflectance\.brushing: 24 of 24 triangles .* no surface has"):
        build_scene(bench.rig, bench.part)


@pytest.mark.parametrize("bare", ["f {0} {1} {2}", "f {0}//1 {1}//1 {2}//1", "f {0} {1}/{1} {2}/{2}"])
def test_faces_without_texture_coordinates_in_a_group_of_faces_that_have_them(bench, bare):
    square = grid(4, 3)
    brushed_bench(bench, flat(square), square, "{along_texture: u}")
    path = bench.folder / "part.obj"
    lines = path.read_text().splitlines()
    lines[-24:] = ["vn 0 0 1", "g plate", *lines[-24:]]
    for n in range(-24, 0, 3):
        lines[n] = bare.format(*re.findall(r"(\d+)/", lines[n]))
    path.write_text("\n".join(lines))
    scene = build_scene(bench.rig, bench.part)
    (warning,) = [one for one in scene.warnings if "texture" in one]
    assert "part.yaml:6: reflectance.brushing: 8 of 24 triangles have no texture coordinates" in warning
    across = scene.mesh.across_brushing(np.zeros((24, 3)), np.repeat(UP, 24, axis=0), np.arange(24))
    assert across.any(axis=1).sum() == 16
    loaded = load(path)
    assert NamedRegion("plate").faces(loaded).all()
    # each triangle is where it was, with its own texture
    corners = loaded.mesh.vertices[loaded.mesh.faces]
    assert np.unique(corners.mean(axis=1).round(6), axis=0) == pytest.approx(
        np.unique(flat(square).mean(axis=1).round(6), axis=0)
    )
    textured = ~np.isnan(loaded.texture).any(axis=(1, 2))
    assert corners[textured, :, :2] == pytest.approx(40.0 * loaded.texture[textured] - 20.0)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".glb", ".ply"])
def test_files_without_texture_coordinates(bench, suffix):
    file = f"plain{suffix}"
    mesh = trimesh.creation.box(extents=(20, 20, 5))
    (bench.folder / file).write_bytes(_bytes(mesh.export(file_type=suffix[1:])))
    units = "" if suffix == ".glb" else ", units: mm"
    bench.edit("part.yaml", "mesh: {file: knob.stl, units: mm}", f"mesh: {{file: {file}{units}}}")
    own = "sigma_rad: 0.0475, sigma_across_rad: 0.19, brushing: {along_texture: v}"
    bench.edit("part.yaml", "sigma_rad: 0.0475", own)
    with pytest.raises(
        InputError, match=rf"part.yaml:6: reflectance.brushing: {file} has no texture coordinates; \.obj"
    ):
        build_scene(bench.rig, bench.part)


def _bytes(data):
    return data.encode() if isinstance(data, str) else data


def test_faces_that_are_cut_at_a_region_keep_their_directions(tmp_path):
    texture = grid(12, 2)
    write_mesh(tmp_path / "part.obj", ring(texture), texture)
    loaded = load(tmp_path / "part.obj")
    field = texture_brushing(loaded, "u")
    whole = TriangleMesh(loaded.mesh.vertices, loaded.mesh.faces, loaded.mesh.normals, brushing=(None, field))
    loaded = LoadedMesh(whole, (), loaded.pieces, loaded.piece)
    cut = mesh_with_regions(loaded, [BoxRegion((-3.0, -99.0, -1.0), (99.0, 4.0, 1.0))], most=10**6, place=str)
    assert len(cut.faces) > len(whole.faces)
    (_, of_cut), face = cut.brushing, np.arange(len(cut.faces), dtype=np.int32)
    points = cut.vertices[cut.faces].mean(axis=1)
    source = of_cut.source
    assert np.allclose(of_cut.along(points, face), field.along(points, source))
    # each piece lies in the face of the file that it is cut from
    a, b, c = (field.corners[source, k] for k in range(3))
    areas = [np.cross(q - p, points - p)[:, 2] for p, q in ((a, b), (b, c), (c, a))]
    assert min(one.min() for one in areas) > 0.0
    own = cut.across_brushing(points, np.repeat(UP, len(points), axis=0), face)
    assert own[cut.material == 1].any(axis=1).all()
    assert not own[cut.material == 0].any()


def test_a_triangle_that_is_turned_keeps_its_texture(tmp_path):
    square = grid(4, 3)
    corners = flat(square)
    texture = square @ [[1.0, 0.3], [-0.2, 1.0]]
    corners[3], texture[3] = corners[3, ::-1].copy(), texture[3, ::-1].copy()
    write_mesh(tmp_path / "part.obj", corners, texture)
    loaded = load(tmp_path / "part.obj")
    assert "1 of 24 triangles wound against their neighbours: turned" in loaded.warnings
    directions = texture_brushing(loaded, "u").directions.reshape(-1, 3)
    assert np.abs(np.cross(directions, directions[0])).max() < 1e-9


def test_texture_coordinates_of_the_corners_of_ply_files(tmp_path):
    """As MeshLab writes them: two triangles share vertices and have places of their own in the texture."""
    header = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element face 2\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n"
    points = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
    faces = "3 0 1 2 6 0 0 1 0 1 1\n3 0 2 3 6 0.1 0.1 0.1 0.6 0.6 0.1\n"
    (tmp_path / "part.ply").write_text(header + points + faces)
    field = texture_brushing(load(tmp_path / "part.ply"), "u")
    assert np.allclose(np.abs(field.directions[0]), [1.0, 0.0, 0.0])
    assert np.allclose(np.abs(field.directions[1]), [0.0, 1.0, 0.0])
