"""Patches: longest-edge bisection, what it promises, and the lookup of a surface point's patch."""

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings, strategies as st

from lightopt.core.errors import InputError
from lightopt.geometry import TriangleMesh, estimate_patch_count, face_areas, face_normals, refine


def edges(corners: np.ndarray) -> np.ndarray:
    return np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)


def random_mesh(seed: int, faces: int = 12) -> TriangleMesh:
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(3 * faces, 3)) * rng.choice([0.05, 1.0, 4.0], size=(3 * faces, 1))
    normals = rng.normal(size=(3 * faces, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return TriangleMesh(vertices, np.arange(3 * faces, dtype=np.int32).reshape(-1, 3), normals)


def surface_points(mesh: TriangleMesh, count: int, seed: int):
    rng = np.random.default_rng(seed)
    face = rng.integers(0, len(mesh.faces), count).astype(np.int32)
    u = rng.random(count)
    v = rng.random(count) * (1 - u)
    corners = mesh.vertices[mesh.faces[face]]
    points = (1 - u - v)[:, None] * corners[:, 0] + u[:, None] * corners[:, 1] + v[:, None] * corners[:, 2]
    return face, u, v, points


def reference_count(corners: np.ndarray, longest: float) -> int:
    """Number of pieces of one triangle by plain recursion."""
    length = edges(corners[None])[0]
    if length.max() <= longest:
        return 1
    k = int(np.argmax(length))
    middle = (corners[k] + corners[(k + 1) % 3]) / 2
    first, second = corners.copy(), corners.copy()
    first[(k + 1) % 3] = second[k] = middle
    return reference_count(first, longest) + reference_count(second, longest)


@given(seed=st.integers(0, 100_000), max_edge=st.floats(0.2, 20.0))
def test_patches_cover_the_faces_and_each_point_finds_its_own(seed, max_edge):
    mesh = random_mesh(seed)
    patches = refine(mesh, max_edge_mm=max_edge, max_patches=200_000)
    corners = patches.vertices[patches.triangles]
    assert edges(corners).max() <= max_edge * (1 + 1e-12)
    assert (np.diff(patches.face) >= 0).all()
    assert np.bincount(patches.face, weights=patches.areas) == pytest.approx(face_areas(mesh), rel=1e-12)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert 0.5 * np.linalg.norm(cross, axis=1) == pytest.approx(patches.areas, rel=1e-6)
    assert ((cross * face_normals(mesh)[patches.face]).sum(axis=1) > 0).all()  # the face's sense of rotation

    face, u, v, points = surface_points(mesh, 500, seed)
    found = patches.patch_at(face, u, v)
    assert (patches.face[found] == face).all()
    inside = corners[found] - points[:, None]
    parts = sum(np.linalg.norm(np.cross(inside[:, k], inside[:, (k + 1) % 3]), axis=1) for k in range(3))
    assert parts / 2 == pytest.approx(patches.areas[found], rel=1e-6)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 100_000), max_edge=st.floats(0.3, 5.0))
def test_count_matches_plain_recursion(seed, max_edge):
    mesh = random_mesh(seed, faces=3)
    expected = sum(reference_count(mesh.vertices[face], max_edge) for face in mesh.faces)
    assert estimate_patch_count(mesh, max_edge) == expected
    assert len(refine(mesh, max_edge_mm=max_edge, max_patches=expected)) == expected


def test_centroid_of_each_patch_finds_the_patch():
    mesh = random_mesh(5)
    patches = refine(mesh, max_edge_mm=0.4, max_patches=100_000)
    a, b, c = (mesh.vertices[mesh.faces[patches.face, k]] for k in range(3))
    system = np.stack([b - a, c - a], axis=2)
    uv = np.stack([np.linalg.lstsq(m, p, rcond=None)[0] for m, p in zip(system, patches.centroids - a, strict=True)])
    assert (patches.patch_at(patches.face, uv[:, 0], uv[:, 1]) == np.arange(len(patches))).all()


def test_normals_at_the_centroids():
    mesh = random_mesh(7)
    one = refine(mesh, max_edge_mm=100, max_patches=100)
    mean = mesh.normals[mesh.faces].mean(axis=1)
    assert one.normals == pytest.approx(mean / np.linalg.norm(mean, axis=1)[:, None])
    assert one.centroids == pytest.approx(mesh.vertices[mesh.faces].mean(axis=1))
    facets = TriangleMesh(mesh.vertices, mesh.faces)
    flat = refine(facets, max_edge_mm=0.5, max_patches=100_000)
    assert flat.normals == pytest.approx(face_normals(facets)[flat.face])


def test_normals_on_a_fine_ball_are_radial():
    ball = trimesh.creation.icosphere(subdivisions=3)
    mesh = TriangleMesh(ball.vertices, ball.faces, ball.vertices / np.linalg.norm(ball.vertices, axis=1)[:, None])
    patches = refine(mesh, max_edge_mm=0.05, max_patches=100_000)
    assert patches.areas.sum() == pytest.approx(ball.area, rel=1e-12)
    radial = patches.centroids / np.linalg.norm(patches.centroids, axis=1)[:, None]
    assert patches.normals == pytest.approx(radial, abs=1e-3)


def test_cancelling_normals_fall_back_to_the_facet():
    normals = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0]])
    mesh = TriangleMesh(np.eye(3), np.array([[0, 1, 2], [0, 1, 1]]), np.vstack([normals]))
    far = TriangleMesh(
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]),
        np.array([[0, 1, 2]]),
        np.array([[1, 0, 0], [-0.5, math.sqrt(0.75), 0], [-0.5, -math.sqrt(0.75), 0]]),
    )
    assert refine(far, max_edge_mm=9, max_patches=9).normals == pytest.approx(np.array([[0, 0, 1]]))
    # a face without area has patches too, and no direction is invented for it
    assert np.isfinite(refine(mesh, max_edge_mm=0.3, max_patches=999).normals).all()


def test_points_on_cuts_corners_and_misses_get_one_patch():
    mesh = TriangleMesh(np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0]]), np.array([[0, 1, 2]]))
    patches = refine(mesh, max_edge_mm=1.0, max_patches=1000)
    t = np.linspace(0, 1, 33)
    u, v = (grid.reshape(-1) for grid in np.meshgrid(t, t))
    keep = u + v <= 1
    face = np.zeros(keep.sum(), dtype=np.int64)
    found = patches.patch_at(face, u[keep], v[keep])
    assert found.min() >= 0
    assert set(found) == set(range(len(patches)))
    points = u[keep, None] * mesh.vertices[1] + v[keep, None] * mesh.vertices[2]
    distance = np.abs(points - patches.centroids[found]).max()
    assert distance <= 1.0
    assert patches.patch_at([-1, 0, -1], [0.1, 0.1, 7], [0.1, 0.1, 7]).tolist()[::2] == [-1, -1]
    # rays hit a hair outside the triangle: still one patch
    assert patches.patch_at([0, 0], [-1e-7, 1 + 1e-7], [0.5, 0.0]).min() >= 0
    assert patches.patch_at(np.empty(0, np.int32), [], []).shape == (0,)


def test_lookup_refuses_what_it_cannot_answer():
    patches = refine(random_mesh(1), max_edge_mm=9, max_patches=999)
    for face, u, v in (([0, 1], [0.1], [0.1]), ([0.0], [0.1], [0.1]), ([[0]], [[0.1]], [[0.1]])):
        with pytest.raises(InputError, match="one shape"):
            patches.patch_at(face, u, v)
    for face in (12, -2):
        with pytest.raises(InputError, match="expected −1 to 11"):
            patches.patch_at([face], [0.1], [0.1])


def test_only_selected_faces_are_refined():
    mesh = random_mesh(3)
    select = np.arange(12) % 3 == 0
    patches = refine(mesh, max_edge_mm=0.3, max_patches=100_000, select=select)
    counts = np.bincount(patches.face)
    assert (counts[~select] == 1).all()
    assert (counts[select] > 1).any()
    assert len(patches) == estimate_patch_count(mesh, 0.3, select=select)


def test_too_many_patches_and_bad_parameters():
    mesh = random_mesh(2)
    with pytest.raises(InputError, match=r"patches or more, at most 50 are accepted; take a longer edge"):
        refine(mesh, max_edge_mm=0.1, max_patches=50)
    for edge in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="edge length above 0"):
            refine(mesh, max_edge_mm=edge, max_patches=50)
    with pytest.raises(InputError, match="booleans of shape"):
        refine(mesh, max_edge_mm=1, max_patches=50, select=np.ones(3, dtype=bool))
    with pytest.raises(InputError, match="limit"):
        estimate_patch_count(mesh, 1.0, limit=0)


@pytest.mark.parametrize("edge", [1e-3, 1e-9, 1e-300])
def test_hopeless_edge_is_counted_in_no_time(edge):
    assert estimate_patch_count(random_mesh(2), edge, limit=100_000) >= 100_000


def test_needles_do_not_escape_the_limit():
    needle = TriangleMesh(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]]))
    assert estimate_patch_count(needle, 1e-12, limit=1000) >= 1000
    patches = refine(needle, max_edge_mm=0.5, max_patches=1000)
    assert len(patches) == reference_count(needle.vertices, 0.5)
    assert edges(patches.vertices[patches.triangles]).max() <= 0.5


def test_large_mesh_of_one_patch_each_is_lean():
    ball = trimesh.creation.icosphere(subdivisions=6)
    mesh = TriangleMesh(ball.vertices, ball.faces, ball.vertices / np.linalg.norm(ball.vertices, axis=1)[:, None])
    patches = refine(mesh, max_edge_mm=1.0, max_patches=len(ball.faces))
    assert (patches.face == np.arange(len(ball.faces))).all()
    assert len(patches.children) == 0
    arrays = [getattr(patches, name) for name in patches.__dataclass_fields__]
    assert sum(a.nbytes for a in arrays) / len(patches) < 100  # bytes for each patch
    assert not any(a.flags.writeable for a in arrays)


def test_same_mesh_same_bytes():
    a, b = (refine(random_mesh(9), max_edge_mm=0.2, max_patches=100_000) for _ in range(2))
    for name in a.__dataclass_fields__:
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
