"""Triangles between a point and places of a rectangle, by silhouettes: as many as a plain test of each one meets."""

from __future__ import annotations

import numpy as np
import pytest
import reference as ref
import trimesh
from test_geometry_blocker_maps import BALL, CLOSED, direction

from lightopt.geometry import RayCaster, triangles_before, triangles_in_row


def without_some(mesh, seed):
    """An open surface."""
    rng = np.random.default_rng(seed)
    return trimesh.Trimesh(mesh.vertices, mesh.faces[rng.random(len(mesh.faces)) > 0.1], process=False)


def with_some_turned(mesh, seed):
    """Faces that disagree in direction."""
    faces, rng = np.array(mesh.faces), np.random.default_rng(seed)
    some = rng.random(len(faces)) < 0.3
    faces[some] = faces[some, ::-1]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def soup(seed, count=150):
    """Triangles anywhere, some without area."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1.0, 1.0, (count, 1, 3)) + 0.2 * rng.standard_normal((count, 3, 3))
    corners[::17, 2] = corners[::17, 1]
    return trimesh.Trimesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), process=False)


def fan(blades=9):
    """Sheets that share one edge, and a face twice."""
    angle = 2 * np.pi * np.arange(blades) / blades
    rim = np.stack([np.cos(angle), np.sin(angle), 0.3 * np.sin(3 * angle)], axis=1)
    vertices = np.concatenate([[[0, 0, -0.5], [0, 0, 0.5]], rim])
    faces = np.stack([0 * np.arange(blades), 1 + 0 * np.arange(blades), 2 + np.arange(blades)], axis=1)
    return trimesh.Trimesh(vertices, np.concatenate([faces, faces[:1]]), process=False)


MESHES = {
    **CLOSED,
    "open": without_some(BALL, 1),
    "turned faces": with_some_turned(CLOSED["ring"], 2),
    "open, turned faces": with_some_turned(without_some(CLOSED["ring through a box"], 3), 4),
    "soup": soup(5),
    "fan": fan(),
    "one triangle": trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0.2]], [[0, 1, 2]], process=False),
}


def rectangle(rng, caster):
    """A corner and two perpendicular sides of a rectangle outside a mesh, tilted against its centre's direction."""
    towards = direction(rng)
    across = np.cross(towards + 0.4 * rng.standard_normal(3), rng.standard_normal(3))
    across /= np.linalg.norm(across)
    along = np.cross(towards + 0.4 * rng.standard_normal(3), across)
    along /= np.linalg.norm(along)
    sides = caster.radius * rng.uniform(0.2, 1.5, (2, 1)) * np.stack([across, along])
    return caster.centre + caster.radius * rng.uniform(2.5, 6.0) * towards - 0.5 * sides.sum(axis=0), sides


def points_of(rng, mesh, count):
    """Points just off faces, and anywhere between them; and unit normals for the small step off the surface."""
    triangles = np.asarray(mesh.triangles)[rng.integers(len(mesh.faces), size=count)]
    weights = rng.dirichlet([1.0, 1.0, 1.0], count)
    points = np.einsum("ij,ijk->ik", weights, triangles)
    points[::2] = rng.uniform(-1.0, 1.0, (len(points[::2]), 3))
    return points, np.stack([direction(rng) for _ in range(count)])


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("seed", range(3))
def test_as_many_triangles_as_a_plain_test_meets(name, seed):
    mesh, rng = MESHES[name], np.random.default_rng(seed)
    caster = RayCaster(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32))
    points, normals = points_of(rng, mesh, 40)
    corner, sides = rectangle(rng, caster)
    silhouettes = caster.silhouettes(points, normals, corner, sides)
    # as Embree has the mesh, and where rays start
    triangles = ((np.asarray(mesh.triangles) - caster.centre) / caster.radius).astype(np.float32).astype(float)
    starts = (points - caster.centre) / caster.radius + 1e-5 * normals
    places = np.concatenate([[[0, 0], [1, 0], [0, 1], [1, 1]], rng.random((20, 2))])
    targets = (corner + places @ sides - caster.centre) / caster.radius
    assert silhouettes.found.all()
    differing = 0
    for i, start in enumerate(starts):
        expected = ref.crossed_between(start, targets, triangles)
        found = np.array([triangles_before(silhouettes, i, s, t) for s, t in places])
        differing += np.count_nonzero(found != expected - expected[0])
    assert differing == 0


@pytest.mark.parametrize("name", ["ring", "soup"])
def test_the_places_of_a_row_are_what_each_is(name):
    mesh, rng = MESHES[name], np.random.default_rng(7)
    caster = RayCaster(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32))
    silhouettes = caster.silhouettes(*points_of(rng, mesh, 100), *rectangle(rng, caster))
    counts, some = np.empty(9, np.int64), 0
    for i in range(100):
        for s, step, t in ((0.0, 0.125, 0.25), (0.03, 0.1, 0.77), (0.0, 0.125, 1.0)):
            triangles_in_row(silhouettes, i, s, step, t, counts)
            assert counts.tolist() == [triangles_before(silhouettes, i, s + step * k, t) for k in range(9)]
            some += np.any(counts != counts[0])
    assert some > 20


@pytest.mark.parametrize("name", MESHES)
def test_points_near_each_other_see_what_each_sees_alone(name):
    mesh, rng = MESHES[name], np.random.default_rng(11)
    caster = RayCaster(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32))
    corner, sides = rectangle(rng, caster)
    points, normals = points_of(rng, mesh, 6)
    # groups of 60, of which some are wider than a box may be
    points = np.repeat(points, 60, axis=0) + caster.radius * rng.uniform(-0.02, 0.02, (360, 3))
    order, normals = rng.permutation(360), np.repeat(normals, 60, axis=0)
    together = caster.silhouettes(points[order], normals[order], corner, sides)
    assert together.found.all()
    places = rng.random((12, 2))
    for i, number in enumerate(order):
        alone = caster.silhouettes(points[[number]], normals[[number]], corner, sides)
        assert alone.first[0, -1] == together.first[i, -1] - together.first[i, 0]
        found = [triangles_before(together, i, s, t) for s, t in places]
        assert found == [triangles_before(alone, 0, s, t) for s, t in places]


def test_a_point_behind_the_rectangle_and_one_with_too_many_edges_are_left_to_rays():
    caster = RayCaster(np.asarray(BALL.vertices, float), np.asarray(BALL.faces, np.int32))
    corner, sides = np.array([-0.5, -0.5, 2.0]), np.eye(3)[:2]
    points = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 3.0]])
    found = caster.silhouettes(points, np.tile([0.0, 0.0, 1.0], (2, 1)), corner, sides).found
    assert found.tolist() == [True, False]
    rough = soup(1, count=8000)
    caster = RayCaster(np.asarray(rough.vertices, float), np.asarray(rough.faces, np.int32))
    found = caster.silhouettes(
        np.array([[0.0, 0.0, -1.0]]), np.eye(3)[2:], 12 * corner - [0, 0, 18.0], 12 * sides
    ).found
    assert found.tolist() == [False]
