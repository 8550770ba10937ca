"""Loading meshes of all faceted formats: what arrives, what is repaired and what is said about it."""

import dataclasses
import json
import math
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from mesh_surface import Surface, surface_of

from lightopt.core.errors import InputError
from lightopt.core.transforms import rotation_x
from lightopt.geometry import TriangleMesh, face_areas, face_normals, load_mesh, transformed
from lightopt.geometry._glb import parse_glb
from lightopt.geometry._load_mesh import _READERS, LoadedMesh

CREASE = math.radians(30)


def load(path: Path, **changes) -> LoadedMesh:
    options = {"unit_mm": 1.0, "normals": "smooth", "crease_angle": CREASE}
    return load_mesh(path, **{**options, **changes})


def export(tmp_path: Path, mesh, suffix: str, **options) -> Path:
    path = tmp_path / f"part.{suffix}"
    mesh.export(path, **options)
    return path


def soup_stl(tmp_path: Path, vertices, faces) -> Path:
    """ASCII STL written by hand, triangle by triangle."""
    lines = ["solid hand made"]
    for face in faces:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex " + " ".join(repr(float(x)) for x in vertices[k]) for k in face]
        lines += ["endloop", "endfacet"]
    path = tmp_path / "hand.stl"
    path.write_text("\n".join([*lines, "endsolid hand made\n"]))
    return path


def signed_volume(mesh: TriangleMesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6.0)


FORMATS = [
    ("stl", {}, "binary STL"),
    ("stl", {"file_type": "stl_ascii"}, "ASCII STL"),
    ("ply", {"encoding": "binary"}, "binary PLY"),
    ("ply", {"encoding": "ascii"}, "ASCII PLY"),
    ("obj", {"include_normals": False}, "OBJ"),
]


@pytest.mark.parametrize(("suffix", "options", "kind"), FORMATS)
def test_every_unitless_format_gives_the_same_box(tmp_path, suffix, options, kind):
    box = trimesh.creation.box(extents=(1, 2, 3))
    path = export(tmp_path, box, suffix, **options)
    assert _READERS[path.suffix](path.name, path.read_bytes(), 12).format == kind
    loaded = load(path, unit_mm=25.4)
    assert loaded.warnings == ()
    assert surface_of(loaded.mesh) == Surface(open_edges=0, nonmanifold_edges=0, components=1)
    assert np.ptp(loaded.mesh.bounds, axis=0) == pytest.approx((25.4, 50.8, 76.2), rel=1e-6)
    assert loaded.mesh.bounds == pytest.approx(box.bounds * 25.4, rel=1e-6)
    assert face_areas(loaded.mesh).sum() == pytest.approx(box.area * 25.4**2, rel=1e-6)
    assert signed_volume(loaded.mesh) == pytest.approx(6 * 25.4**3, rel=1e-6)


def test_glb_is_metres_and_y_up_with_its_scene_in_place(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box(extents=(0.01, 0.02, 0.03)))
    moved = trimesh.transformations.rotation_matrix(math.pi / 2, [0, 1, 0])
    moved[:3, 3] = (0.1, 0.2, 0.0)
    scene.add_geometry(trimesh.creation.box(extents=(0.01, 0.02, 0.03)), transform=moved)
    path = tmp_path / "part.glb"
    scene.export(path)
    loaded = load(path, unit_mm=None)
    # (x, y, z) of the file is (x, −z, y) here: the second box is 30 × 20 × 10 at (100, 200, 0) in the file
    assert loaded.mesh.bounds == pytest.approx(np.array([[-5, -15, -10], [115, 15, 210]]), abs=1e-4)
    assert surface_of(loaded.mesh).components == 2
    assert signed_volume(loaded.mesh) == pytest.approx(2 * 10 * 20 * 30, rel=1e-5)
    assert np.ptp(load(path, unit_mm=1.0).mesh.bounds, axis=0) == pytest.approx((0.12, 0.03, 0.22), rel=1e-5)


def test_glb_mirrored_node_keeps_its_outside_and_its_normals(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.01)
    ball = trimesh.Trimesh(ball.vertices, ball.faces, vertex_normals=ball.vertices / 0.01, process=False)
    mirror = np.diag([2.0, 1.0, -1.0, 1.0])
    scene = trimesh.Scene()
    scene.add_geometry(ball, transform=mirror)
    path = tmp_path / "part.glb"
    scene.export(path)
    loaded = load(path, unit_mm=None)
    assert loaded.warnings == ()
    assert signed_volume(loaded.mesh) > 0
    gradient = loaded.mesh.vertices / np.array([4.0, 1.0, 1.0])
    gradient /= np.linalg.norm(gradient, axis=1)[:, None]
    assert loaded.mesh.normals == pytest.approx(gradient, abs=1e-5)


@pytest.mark.parametrize(("order", "number", "index"), [("<", "float", "int"), (">", "double", "uint")])
def test_binary_ply_of_triangles_is_read_as_trimesh_reads_it(tmp_path, monkeypatch, order, number, index):
    ball = trimesh.creation.icosphere(subdivisions=2)
    names = ["x", "y", "z", "nx", "ny", "nz", "quality"]
    head = f"ply\nformat binary_{'little' if order == '<' else 'big'}_endian 1.0\ncomment by hand\n"
    head += f"element vertex {len(ball.vertices)}\n" + "".join(f"property {number} {name}\n" for name in names)
    head += f"element face {len(ball.faces)}\nproperty list uchar {index} vertex_indices\nend_header\n"
    vertices = np.concatenate([ball.vertices, ball.vertex_normals, ball.vertices[:, :1]], axis=1)
    faces = np.zeros(len(ball.faces), [("count", "u1"), ("corners", f"{order}i4", 3)])
    faces["count"], faces["corners"] = 3, ball.faces
    path = tmp_path / "part.ply"
    kind = f"{order}{'f4' if number == 'float' else 'f8'}"
    path.write_bytes(head.encode() + vertices.astype(kind).tobytes() + faces.tobytes())
    own = load(path, unit_mm=25.4)
    monkeypatch.setattr("lightopt.geometry._mesh_formats._plain_ply", lambda *_: None)
    other = load(path, unit_mm=25.4)
    assert own.warnings == other.warnings == ()
    for name in ("vertices", "faces", "normals"):
        assert np.array_equal(getattr(own.mesh, name), getattr(other.mesh, name))


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_unit_is_required_where_the_format_has_none(tmp_path, suffix):
    path = export(tmp_path, trimesh.creation.box(), suffix)
    with pytest.raises(InputError, match="carry no unit"):
        load(path, unit_mm=None)


def test_polygons_of_obj_and_ply_become_triangles(tmp_path):
    obj = tmp_path / "quad.obj"
    obj.write_text("v 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nv 1 3 0\nf 1 2 3 4\nf 4 3 5\n")
    assert face_areas(load(obj).mesh).sum() == pytest.approx(4.0)
    ply = tmp_path / "quad.ply"
    head = "ply\nformat ascii 1.0\nelement vertex 4\n" + "".join(f"property float {c}\n" for c in "xyz")
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    ply.write_text(head + "0 0 0\n2 0 0\n2 1 0\n0 1 0\n4 0 1 2 3\n")
    assert face_areas(load(ply).mesh).sum() == pytest.approx(2.0)


def test_same_file_same_bytes(tmp_path):
    path = export(tmp_path, trimesh.creation.icosphere(subdivisions=3), "stl")
    a, b = load(path).mesh, load(path).mesh
    for name in ("vertices", "faces", "normals"):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes()


def test_coinciding_vertices_are_merged_and_reported_except_in_stl(tmp_path):
    box = trimesh.creation.box()
    loose = trimesh.Trimesh(box.vertices[box.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    loaded = load(export(tmp_path, loose, "ply"), crease_angle=math.pi)
    assert loaded.warnings == ("28 of 36 vertices repeat another one: merged",)
    assert len(loaded.mesh.vertices) == 8
    assert load(export(tmp_path, loose, "stl")).warnings == ()


def test_negative_zero_coincides_with_zero(tmp_path):
    vertices = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (-0.0, 0, -0.0), (0, 0, 1), (-0.0, 1, 0)]
    mesh = load(soup_stl(tmp_path, vertices, [(0, 1, 2), (3, 5, 4)]), crease_angle=math.pi).mesh
    assert len(mesh.vertices) == 4


def test_triangles_without_area_are_left_out_with_a_number(tmp_path):
    vertices = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.5, 0, 0)]
    loaded = load(soup_stl(tmp_path, vertices, [(0, 1, 2), (0, 3, 1), (0, 0, 2)]))
    assert loaded.warnings == ("2 of 3 triangles have no area: left out",)
    assert len(loaded.mesh.faces) == 1


def test_unused_vertices_are_left_out_with_a_number(tmp_path):
    path = tmp_path / "part.ply"
    head = "ply\nformat ascii 1.0\nelement vertex 5\n" + "".join(f"property float {c}\n" for c in "xyz")
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_text(head + "0 0 0\n1 0 0\n0 1 0\n9 9 9\n8 8 8\n3 0 1 2\n")
    loaded = load(path)
    assert loaded.warnings == ("2 of 5 vertices belong to no triangle: left out",)
    assert loaded.mesh.bounds[1].tolist() == [1, 1, 0]


@pytest.mark.parametrize("normals", ["smooth", "facet"])
def test_mixed_winding_is_made_consistent(tmp_path, normals):
    ball = trimesh.creation.icosphere(subdivisions=2)
    faces = ball.faces.copy()
    turned = np.random.default_rng(1).choice(len(faces), 70, replace=False)
    faces[turned] = faces[turned][:, ::-1]
    path = export(tmp_path, trimesh.Trimesh(ball.vertices, faces, process=False), "stl")
    loaded = load(path, normals=normals)
    assert loaded.warnings == ("70 of 320 triangles wound against their neighbours: turned",)
    outward = (face_normals(loaded.mesh) * loaded.mesh.vertices[loaded.mesh.faces].mean(axis=1)).sum(axis=1)
    assert (outward > 0).all()
    assert (loaded.mesh.normals is None) == (normals == "facet")


def test_inside_out_solid_is_turned_but_a_cavity_is_not(tmp_path):
    outer, cavity = trimesh.creation.box((4, 4, 4)), trimesh.creation.icosphere(subdivisions=1)
    cavity.invert()
    other = trimesh.creation.box((1, 1, 1)).apply_translation((10, 0, 0))
    other.invert()
    # beside the large box, yet inside its bounding box there is nothing: a box of its own
    part = trimesh.util.concatenate([outer, cavity, other])
    loaded = load(export(tmp_path, part, "stl"))
    assert loaded.warnings == ("1 closed surface (12 triangles) inside out: turned",)
    assert surface_of(loaded.mesh).components == 3
    assert signed_volume(loaded.mesh) == pytest.approx(64 - cavity.volume * -1 + 1, rel=1e-6)


def test_cavity_test_looks_past_the_bounding_box(tmp_path):
    ring = trimesh.creation.torus(major_radius=5, minor_radius=1)
    plug = trimesh.creation.icosphere(subdivisions=1, radius=0.5)  # in the hole, not in the ring
    plug.invert()
    loaded = load(export(tmp_path, trimesh.util.concatenate([ring, plug]), "stl"))
    assert loaded.warnings == (f"1 closed surface ({len(plug.faces)} triangles) inside out: turned",)


def test_both_windings_wrong_at_once(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=1)
    faces = ball.faces[:, ::-1].copy()
    faces[5] = faces[5][::-1]
    loaded = load(export(tmp_path, trimesh.Trimesh(ball.vertices, faces, process=False), "stl"))
    assert [w.split(":")[0] for w in loaded.warnings] == [
        "1 of 80 triangles wound against their neighbours",
        "1 closed surface (80 triangles) inside out",
    ]
    assert signed_volume(loaded.mesh) > 0


def test_the_smaller_share_of_an_open_surface_is_turned(tmp_path):
    vertices = [(x, y, 0) for x in range(4) for y in range(4)]
    cells = [(4 * x + y, 4 * x + y + 4, 4 * x + y + 5, 4 * x + y + 1) for x in range(3) for y in range(3)]
    faces = [t for a, b, c, d in cells for t in ((a, b, c), (a, c, d))]
    faces[0] = faces[0][::-1]  # the very first: nothing but the majority says which way is right
    loaded = load(soup_stl(tmp_path, vertices, faces))
    assert loaded.warnings == ("1 of 18 triangles wound against their neighbours: turned",)
    assert (face_normals(loaded.mesh) == (0, 0, 1)).all()


def test_open_and_nonmanifold_meshes_are_fine(tmp_path):
    vertices = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1)]
    loaded = load(soup_stl(tmp_path, vertices, [(0, 1, 2), (1, 0, 3), (0, 1, 4)]))
    assert loaded.warnings == ()
    surface = surface_of(loaded.mesh)
    assert (surface.open_edges, surface.nonmanifold_edges) == (6, 1)


def test_moebius_strip_is_kept_with_a_warning(tmp_path):
    n = 24
    t = np.arange(n) * 2 * np.pi / n
    w = np.array([-0.3, 0.3])[:, None]
    x = (1 + w * np.cos(t / 2)) * np.cos(t)
    y = (1 + w * np.cos(t / 2)) * np.sin(t)
    vertices = np.stack([x, y, w * np.sin(t / 2)], axis=-1).reshape(-1, 3)
    faces = []
    for i in range(n):
        a, b, c, d = i, n + i, (i + 1) % n, n + (i + 1) % n
        if i == n - 1:
            c, d = d, c
        faces += [(a, c, b), (b, c, d)]
    loaded = load(soup_stl(tmp_path, vertices, faces))
    assert any("cannot be made to agree" in w for w in loaded.warnings)
    assert len(loaded.mesh.faces) == 2 * n


@pytest.mark.parametrize("mirror", [1, -1])
def test_closed_one_sided_surface_has_no_inside(tmp_path, mirror):
    # Klein bottle (figure 8): once around, the other angle runs backwards
    n, k = 24, 16
    u = (np.arange(n) * 2 * np.pi / n)[:, None]
    v = (np.arange(k) + 0.3) * 2 * np.pi / k
    r = 3 + np.cos(u / 2) * np.sin(v) - np.sin(u / 2) * np.sin(2 * v)
    z = np.sin(u / 2) * np.sin(v) + np.cos(u / 2) * np.sin(2 * v)
    grid = np.stack([mirror * r * np.cos(u), r * np.sin(u), z], axis=-1)
    number = np.arange(n * k).reshape(n, k)
    number = np.vstack([number, number[:1, ::-1]])
    faces = []
    for i in range(n):
        for j in range(k):
            a, b = number[i, j], number[i, (j + 1) % k]
            c, d = number[i + 1, (j + 1) % k], number[i + 1, j]
            faces += [(a, b, c), (a, c, d)]
    loaded = load(soup_stl(tmp_path, grid.reshape(-1, 3), faces))
    assert surface_of(loaded.mesh).watertight
    assert any("cannot be made to agree" in w for w in loaded.warnings)
    assert not any("inside out" in w for w in loaded.warnings)


def glb(tree: dict, blob: bytes) -> bytes:
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def nested_tree() -> tuple[dict, bytes]:
    """One triangle with normals under three nodes: a shift, a quarter turn about z with a scale, a matrix."""
    half = math.sqrt(0.5)
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
    normals = np.array([[0, 0, 1]] * 3, "<f4")
    blob = points.tobytes() + normals.tobytes() + np.array([0, 1, 2, 0], "<u2").tobytes()
    matrix = np.eye(4)
    matrix[:3, 3] = (0, 0, 7)
    tree = {
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"translation": [10, 0, 0], "children": [1]},
            {"rotation": [0, 0, half, half], "scale": [2, 2, 2], "children": [2]},
            {"matrix": matrix.T.reshape(-1).tolist(), "mesh": 0},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 0, "byteOffset": 36, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 72}, {"buffer": 0, "byteOffset": 72, "byteLength": 6}],
    }
    return tree, blob


def test_own_glb_parser_follows_nested_nodes():
    (part,) = parse_glb("x.glb", glb(*nested_tree()))
    assert part["vertices"] == pytest.approx(np.array([[10, 0, 14], [10, 2, 14], [8, 0, 14]]), abs=1e-12)
    assert part["vertex_normals"] / 4 == pytest.approx(np.array([[0, 0, 1]] * 3), abs=1e-12)
    assert part["faces"].tolist() == [[0, 1, 2]]


def test_own_glb_parser_refuses_what_it_cannot_read():
    for change in ({"sparse": {}}, {"count": 99}, {"componentType": 1}, {"bufferView": 5}):
        tree, blob = nested_tree()
        tree["accessors"][0].update(change)
        with pytest.raises(InputError, match="GLB data is damaged"):
            parse_glb("x.glb", glb(tree, blob))


def test_mesh_value_object_is_read_only_and_checked():
    vertices = np.eye(3)
    mesh = TriangleMesh(vertices, np.array([[0, 1, 2]]))
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0, 0] = 5
    with pytest.raises(dataclasses.FrozenInstanceError):
        mesh.faces = mesh.faces  # type: ignore[misc]
    vertices[0, 0] = 1.0  # the caller's own array stays writable
    bad = [
        (np.eye(3)[:, :2], [[0, 1, 2]], None, "shape"),
        (np.eye(3) * np.nan, [[0, 1, 2]], None, "not finite"),
        (np.eye(3), [[0, 1, 3]], None, "0 to 3 for 3 vertices"),
        (np.eye(3), [[0, 1, -1]], None, "-1 to 1"),
        (np.eye(3), [[0.0, 1.0, 2.0]], None, "integers"),
        (np.eye(3), [[0, 1, 2]], np.eye(3)[:2], "expected shape"),
        (np.eye(3), [[0, 1, 2]], 2 * np.eye(3), "unit length"),
    ]
    for v, f, n, message in bad:
        with pytest.raises(InputError, match=message):
            TriangleMesh(v, np.array(f), n)


def test_transformed_moves_vertices_and_turns_normals():
    mesh = TriangleMesh(np.eye(3), np.array([[0, 1, 2]]), np.eye(3))
    moved = transformed(mesh, rotation_x(math.pi / 2), (1, 2, 3))
    assert moved.vertices == pytest.approx(np.array([[2, 2, 3], [1, 2, 4], [1, 1, 3]]), abs=1e-15)
    assert moved.normals == pytest.approx(np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]), abs=1e-15)
    for matrix in (np.diag([1, 1, -1]), 2 * np.eye(3), np.eye(2)):
        with pytest.raises(InputError, match="rotation matrix"):
            transformed(mesh, matrix, (0, 0, 0))
    with pytest.raises(InputError, match="translation"):
        transformed(mesh, np.eye(3), (0, 0, np.nan))


@pytest.mark.parametrize("kind", ["stl", "ply"])
def test_a_binary_file_of_triangles_takes_no_trimesh(tmp_path, kind):
    """It takes longer to load than most commands have to compute."""
    path = export(tmp_path, trimesh.creation.icosphere(subdivisions=1), kind)
    program = (
        "import sys\n"
        "from pathlib import Path\n"
        "from lightopt.geometry import load_mesh\n"
        f"loaded = load_mesh(Path({str(path)!r}), unit_mm=1.0, normals='facet', crease_angle=0.5)\n"
        "print(len(loaded.mesh.faces), 'trimesh' in sys.modules)\n"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert said.split() == ["80", "False"]
