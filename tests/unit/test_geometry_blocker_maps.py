"""Shadow rays that a map proves free: never one that anything blocks."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings, strategies as st

from lightopt.geometry import RayCaster, _blocker_maps as maps, resolve_hits


def star(points: int) -> trimesh.Trimesh:
    """A prism over a star: folds far below 90° between its arms."""
    angle = np.pi * np.arange(2 * points) / points
    radius = np.where(np.arange(2 * points) % 2 == 0, 1.0, 0.25)
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    n = len(rim)
    vertices = np.concatenate([np.c_[rim, np.full(n, -0.3)], np.c_[rim, np.full(n, 0.3)], [[0, 0, -0.3], [0, 0, 0.3]]])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    sides = np.concatenate([np.stack([i, j, n + j], axis=1), np.stack([i, n + j, n + i], axis=1)])
    ends = np.concatenate(
        [np.stack([j, i, 0 * i + 2 * n], axis=1), np.stack([n + i, n + j, 0 * i + 2 * n + 1], axis=1)]
    )
    return trimesh.Trimesh(vertices, np.concatenate([sides, ends]), process=False)


def turned(mesh: trimesh.Trimesh, by: np.ndarray) -> trimesh.Trimesh:
    moved = mesh.copy()
    moved.apply_transform(by)
    return moved


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(meshes))


BALL = trimesh.creation.icosphere(subdivisions=3)
RING = trimesh.creation.torus(1.0, 0.35, major_sections=48, minor_sections=20)
BOX = trimesh.creation.box((2.0, 1.2, 0.5))
SMALL = turned(BALL, np.diag([0.5, 0.5, 0.5, 1.0]))
LOW = trimesh.transformations.translation_matrix([0.3, 0.1, 0.7])

CLOSED = {
    "ball": BALL,
    "ring": RING,
    "plate": BOX,
    "star": star(7),
    "hollow": joined(BALL, SMALL.copy()),
    "ball in a box": joined(BOX, turned(SMALL, LOW)),
    "ring through a box": joined(BOX, turned(RING, trimesh.transformations.rotation_matrix(1.2, [1, 0.3, 0]))),
    "ball touching a box": joined(BOX, turned(SMALL, trimesh.transformations.translation_matrix([0, 0, 0.75]))),
}
CLOSED["hollow"].faces[len(BALL.faces) :] = CLOSED["hollow"].faces[len(BALL.faces) :, ::-1]


def bumpy_ball() -> trimesh.Trimesh:
    """Hills and valleys of triangles about as small as a texel."""
    mesh = trimesh.creation.icosphere(subdivisions=5)
    x = np.asarray(mesh.vertices)
    mesh.vertices = x * (1.0 + 0.08 * np.prod(np.sin(9.0 * x + 0.5), axis=1, keepdims=True))
    return mesh


BUMPY = bumpy_ball()


def shadow_rays(mesh, seed, *, rays=3000, near=2.0, far=8.0):
    """A caster, and points of its mesh that a camera sees with targets that they face."""
    rng = np.random.default_rng(seed)
    vertices = np.asarray(mesh.vertices) @ trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3].T
    faces = np.asarray(mesh.faces, np.int32)
    caster = RayCaster(vertices, faces)
    eye = caster.centre + 6.0 * caster.radius * direction(rng)
    # half of the rays anywhere, half at vertices and edges, where folds are
    aim = np.concatenate(
        [
            caster.centre + caster.radius * rng.uniform(-1.0, 1.0, (rays, 3)),
            vertices[rng.integers(len(vertices), size=rays)] + 1e-5 * caster.radius * rng.standard_normal((rays, 3)),
        ]
    )
    way = aim - eye
    hits = resolve_hits(caster.first_hit(eye, way), eye, way, vertices, faces)
    a, b, c = (vertices[faces[hits.face, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    normals /= np.where(length > 0.0, length, 1.0)[:, None]
    front = np.einsum("ij,ij->i", normals, eye - hits.points) > 0.0
    points, normals = hits.points[front], normals[front]
    targets = np.stack([caster.centre + caster.radius * rng.uniform(near, far) * direction(rng) for _ in range(4)])
    facing = np.einsum("ij,itj->it", normals, targets[None] - points[:, None]) > 0.0
    return caster, (points, normals, targets), facing.T.copy()


def direction(rng):
    way = rng.standard_normal(3)
    return way / np.linalg.norm(way)


def cast_with_and_without(caster, arrays, facing, *, map_at=None):
    """What is blocked, by every ray and by maps, and the rays that were cast each time.

    map_at: targets to make the maps of, which these targets are near
    """
    before = caster.rays_cast
    target, point = (index.astype(np.int32) for index in np.nonzero(facing))
    plain = caster.occluded(*arrays, point_index=point, target_index=target)
    between = caster.rays_cast
    caster.map_blockers(arrays[2] if map_at is None else map_at, rays=10**9, moving=map_at is not None, threads=2)
    mapped = ~caster.visible(*arrays, candidates=facing, outside=True)
    assert mapped[~facing].all()
    after = caster.rays_cast
    each = np.arange(facing.shape[1])
    chosen = np.where(facing[each % len(facing), each], each % len(facing), -1).astype(np.int32)
    one = caster.sees_one(*arrays, chosen=chosen, outside=True)
    np.testing.assert_array_equal(one, ~mapped[each % len(facing), each])
    return plain, mapped[facing], between - before, after - between


@pytest.mark.parametrize("name", CLOSED)
def test_no_blocked_ray_is_taken_for_free(name):
    saved = 0
    for seed in range(4):
        plain, mapped, every, cast = cast_with_and_without(*shadow_rays(CLOSED[name], seed))
        np.testing.assert_array_equal(mapped, plain)
        saved += every - cast
    # folds and other bodies nearby keep their rays
    assert saved > 0 or name in ("star", "ball in a box", "ring through a box")


@pytest.mark.parametrize("reach", [maps.REACH, 0.3])
@pytest.mark.parametrize("near", [1.8, 6.0])
@pytest.mark.parametrize("name", [*CLOSED, pytest.param("bumpy ball", marks=pytest.mark.nightly)])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (1, 2))])
def test_the_map_of_a_moving_target_takes_no_blocked_ray_to_one_nearby_for_free(name, near, reach, seed, monkeypatch):
    monkeypatch.setattr(maps, "REACH", reach)
    mesh = BUMPY if name == "bumpy ball" else CLOSED[name]
    caster, arrays, facing = shadow_rays(mesh, seed, near=near, far=near + 0.5)
    rng = np.random.default_rng(seed)
    off = np.stack([direction(rng) * reach * share for share in (0.999, 0.99, 0.5, 0.0)]) * caster.radius
    plain, mapped, every, cast = cast_with_and_without(caster, arrays, facing, map_at=arrays[2] + off)
    np.testing.assert_array_equal(mapped, plain)
    assert cast < every or reach > 0.1 or name in ("star", "ball in a box", "ring through a box")


def test_a_map_is_made_once_enough_rays_went_to_targets_that_move():
    caster, (points, normals, targets), facing = shadow_rays(BALL, 0)
    few = int(maps.WORTHWHILE_SHARE * len(BALL.faces) / 3) + 1
    step = 0.2 * maps.REACH * caster.radius * direction(np.random.default_rng(1))
    free = []
    for number in range(5):
        here = targets + number * step
        caster.map_blockers(here, rays=few, moving=True)
        caster.visible(points, normals, here, candidates=facing, outside=True)
        free.append(caster.rays_free)
    assert free[1] == 0 < free[2] < free[3] < free[4]
    # beyond the reach of its map a target has none
    caster.visible(points, normals, targets + 20.0 * step, candidates=facing, outside=True)
    assert caster.rays_free == free[4]


@pytest.mark.hypothesis
@settings(deadline=None)
@given(st.sampled_from(list(CLOSED)), st.integers(0, 2**31), st.floats(0.0, 0.3))
def test_no_blocked_ray_of_a_bent_part_is_taken_for_free(name, seed, bend):
    mesh = CLOSED[name].copy()
    x = np.asarray(mesh.vertices)
    mesh.vertices = x + bend * np.sin(3.0 * x[:, [1, 2, 0]] + seed % 7)
    plain, mapped, _, _ = cast_with_and_without(*shadow_rays(mesh, seed, rays=600))
    np.testing.assert_array_equal(mapped, plain)


def test_most_rays_of_a_smooth_part_are_proven_free():
    caster, arrays, facing = shadow_rays(trimesh.creation.icosphere(subdivisions=5), 0, rays=8000)
    plain, mapped, every, cast = cast_with_and_without(caster, arrays, facing)
    assert not plain.any()
    assert not mapped.any()
    assert cast < 0.15 * every


@pytest.mark.parametrize("damage", ["open", "flipped"])
def test_a_mesh_that_bounds_no_solid_keeps_all_rays(damage):
    mesh = BALL.copy()
    if damage == "open":
        mesh.update_faces(np.arange(len(mesh.faces)) != 5)
    else:
        mesh.faces[5] = mesh.faces[5, ::-1]
    caster, arrays, facing = shadow_rays(mesh, 1)
    plain, mapped, every, cast = cast_with_and_without(caster, arrays, facing)
    np.testing.assert_array_equal(mapped, plain)
    assert cast == every
    assert not caster._maps.check()


def test_targets_that_are_too_near_keep_all_rays():
    plain, mapped, every, cast = cast_with_and_without(*shadow_rays(RING, 2, near=1.05, far=1.4))
    np.testing.assert_array_equal(mapped, plain)
    assert cast == every


def test_few_rays_make_no_map():
    caster, arrays, facing = shadow_rays(BALL, 3, rays=30)
    assert caster._maps.check()
    before = caster.rays_cast
    caster.visible(*arrays, candidates=facing, outside=True)
    assert caster.rays_cast - before == np.count_nonzero(facing)


def test_vertices_that_are_split_at_creases_count_as_one():
    split = trimesh.Trimesh(np.asarray(BOX.triangles).reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    assert RayCaster(np.asarray(split.vertices), np.asarray(split.faces, np.int32))._maps.check()


def test_more_maps_than_fit_take_the_place_of_the_first(monkeypatch):
    monkeypatch.setattr(maps, "MOST_MAPS", 6)
    caster, arrays, facing = shadow_rays(RING, 4)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        targets = np.stack([caster.centre + 4.0 * caster.radius * direction(rng) for _ in range(4)])
        plain, mapped, _, _ = cast_with_and_without(caster, (*arrays[:2], targets), facing)
        np.testing.assert_array_equal(mapped, plain)
