"""Smooth normals within the crease angle, and normals that a file carries."""

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st

from lightopt.geometry import face_normals, load_mesh
from lightopt.geometry._load_mesh import LoadedMesh, smooth_normals
from lightopt.geometry._topology import edge_pairs, merge_rows


def load(path: Path, crease_deg: float = 30.0, normals: str = "smooth") -> LoadedMesh:
    return load_mesh(path, unit_mm=1.0, normals=normals, crease_angle=math.radians(crease_deg))


def stl(tmp_path: Path, mesh: trimesh.Trimesh) -> Path:
    path = tmp_path / "part.stl"
    mesh.export(path)
    return path


def reference_normals(vertices, faces, crease):
    """Corner normals by definition: walk the fan around each vertex through its smooth edges."""
    corners = vertices[faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1)[:, None]
    users: dict[tuple[int, int], list[int]] = {}
    for f, face in enumerate(faces):
        for k in range(3):
            users.setdefault(tuple(sorted((face[k], face[(k + 1) % 3]))), []).append(f)
    result = np.zeros((len(faces), 3, 3))
    for f, face in enumerate(faces):
        for k, vertex in enumerate(face):
            fan, todo = {f}, [f]
            while todo:
                g = todo.pop()
                for other in faces[g]:
                    edge = users.get(tuple(sorted((vertex, other))), ())
                    if other == vertex or len(edge) != 2:
                        continue
                    h = edge[0] if edge[1] == g else edge[1]
                    if h not in fan and np.arccos(np.clip(flat[g] @ flat[h], -1, 1)) <= crease + 1e-6:
                        fan.add(h)
                        todo.append(h)
            for g in fan:
                j = list(faces[g]).index(vertex)
                u = corners[g, (j + 1) % 3] - corners[g, j]
                v = corners[g, (j + 2) % 3] - corners[g, j]
                cosine = u @ v / np.linalg.norm(u) / np.linalg.norm(v)
                result[f, k] += np.arccos(np.clip(cosine, -1, 1)) * flat[g]
    return result / np.linalg.norm(result, axis=2)[..., None]


def test_cube_stays_sharp_and_is_round_only_when_requested(tmp_path):
    path = stl(tmp_path, trimesh.creation.box())
    sharp = load(path).mesh
    assert len(sharp.vertices) == 24
    assert sharp.normals[sharp.faces] == pytest.approx(np.repeat(face_normals(sharp)[:, None], 3, axis=1))
    for crease, count in ((89.9, 24), (90.0, 8)):
        assert len(load(path, crease).mesh.vertices) == count
    round_cube = load(path, 90.0).mesh
    # weighted by angle, the normal of a cube's corner does not depend on how its sides are cut into triangles
    assert round_cube.normals == pytest.approx(round_cube.vertices / math.sqrt(0.75))


def test_icosphere_normals_are_radial(tmp_path):
    mesh = load(stl(tmp_path, trimesh.creation.icosphere(subdivisions=4, radius=20.0))).mesh
    assert len(mesh.vertices) == 2562
    radial = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None]
    assert np.linalg.norm(np.cross(mesh.normals, radial), axis=1).max() < 0.003
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0, abs=1e-12)


def test_cylinder_is_smooth_round_and_sharp_at_the_rim(tmp_path):
    mesh = load(stl(tmp_path, trimesh.creation.cylinder(radius=5, height=10, sections=48))).mesh
    is_cap = np.abs(mesh.normals[:, 2]) > 0.5
    assert np.abs(mesh.normals[is_cap, 2]) == pytest.approx(1.0, abs=1e-9)
    side = mesh.vertices[~is_cap] * (1, 1, 0) / 5
    assert mesh.normals[~is_cap] == pytest.approx(side, abs=1e-6)
    assert np.count_nonzero(~is_cap) == 2 * 48


def test_two_faces_at_a_smooth_edge_share_both_ends(tmp_path):
    mesh = load(stl(tmp_path, trimesh.creation.torus(5, 1))).mesh
    assert not edge_pairs(mesh.faces).rim.any()  # not even a vertex is split
    assert merge_rows(mesh.vertices)[0].shape == (len(mesh.vertices),)


def test_facet_has_no_normals(tmp_path):
    path = stl(tmp_path, trimesh.creation.icosphere(subdivisions=1))
    loaded = load(path, normals="facet")
    assert loaded.mesh.normals is None
    assert len(loaded.mesh.vertices) == 42


@pytest.mark.slow
@given(seed=st.integers(0, 10_000), crease=st.floats(0.05, 2.0))
def test_smoothing_matches_the_plain_reference(seed, crease):
    rng = np.random.default_rng(seed)
    ball = trimesh.creation.icosphere(subdivisions=1)
    vertices = ball.vertices * (1 + 0.3 * rng.random((len(ball.vertices), 1)))
    faces = ball.faces[rng.random(len(ball.faces)) < 0.9].astype(np.int32)  # holes: fans that do not close
    pairs = edge_pairs(faces)
    mesh, cancelled = smooth_normals(vertices, faces, pairs, crease_angle=crease)
    assert cancelled == 0
    assert (mesh.vertices[mesh.faces] == vertices[faces]).all()
    expected = reference_normals(vertices, faces, crease)
    assert mesh.normals[mesh.faces] == pytest.approx(expected, abs=1e-7)


def test_normals_that_cancel_out_become_a_faces(tmp_path):
    # two sides of one triangle, all edges smooth at π: their sum has no direction
    vertices, faces = np.eye(3), np.array([[0, 1, 2], [0, 2, 1]], dtype=np.int32)
    mesh, cancelled = smooth_normals(vertices, faces, edge_pairs(faces), crease_angle=math.pi)
    assert cancelled == 3
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0)


def ply(tmp_path: Path, mesh: trimesh.Trimesh, normals: np.ndarray) -> Path:
    rows = np.hstack([mesh.vertices, normals])
    head = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n"
    head += "".join(f"property double {c}\n" for c in ("x", "y", "z", "nx", "ny", "nz"))
    head += f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    lines = [" ".join(map(repr, row)) for row in rows.tolist()]
    lines += ["3 " + " ".join(map(str, face)) for face in mesh.faces.tolist()]
    path = tmp_path / "part.ply"
    path.write_text(head + "\n".join(lines) + "\n")
    return path


def test_normals_of_the_file_are_kept(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=1)  # edges of 36°: beyond the crease angle
    tilted = ball.vertices + np.array([0.2, 0, 0])
    tilted /= np.linalg.norm(tilted, axis=1)[:, None]
    loaded = load(ply(tmp_path, ball, 3.0 * tilted), crease_deg=60)
    assert loaded.warnings == ()
    assert loaded.mesh.normals == pytest.approx(tilted)
    assert load(ply(tmp_path, ball, tilted), normals="facet").mesh.normals is None


def test_normals_of_an_obj_file_are_kept_and_split_the_vertices(tmp_path):
    path = tmp_path / "part.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvn 0 0 1\nvn 0 0.6 0.8\nf 1//1 2//1 3//1\nf 2//2 4//2 3//2\n")
    mesh = load(path).mesh
    assert len(mesh.vertices) == 6
    assert {tuple(n) for n in mesh.normals.round(6).tolist()} == {(0, 0, 1), (0, 0.6, 0.8)}
    for face in mesh.normals[mesh.faces]:
        assert (face == face[0]).all()


def test_normals_averaged_over_creases_are_reported(tmp_path):
    box = trimesh.creation.box()
    loaded = load(ply(tmp_path, box, box.vertices))
    assert len(loaded.warnings) == 1
    assert "smooth across 12 of 12 edges bent by more than the crease angle (30°): kept" in loaded.warnings[0]


def test_missing_and_inward_normals_are_repaired_with_numbers(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2)
    normals = ball.vertices.copy()
    normals[[3, 50]] = 0.0
    normals[7] = np.nan
    normals[[20, 21, 22, 23]] *= -1.0
    loaded = load(ply(tmp_path, ball, normals))
    assert loaded.warnings == (
        "3 of 162 vertex normals were zero or not finite: taken from the faces",
        "4 of 162 vertex normals pointed into the part: turned",
    )
    assert loaded.mesh.normals == pytest.approx(loaded.mesh.vertices, abs=0.03)


def test_normals_turn_with_an_inside_out_surface(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.invert()
    loaded = load(ply(tmp_path, ball, -ball.vertices))
    assert [w.split(":")[1].strip() for w in loaded.warnings] == ["turned", "turned"]
    assert loaded.mesh.normals == pytest.approx(loaded.mesh.vertices, abs=1e-9)
