"""Rays in packets: the answers are those of embreex, ray by ray; without the library embreex answers."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from lightopt.geometry import RayCaster, _caster, _ray_packets

MESHES = {
    "sphere": trimesh.creation.icosphere(3, 10.0),
    "torus": trimesh.creation.torus(12, 4, major_sections=40, minor_sections=20),
    "nested shells": trimesh.util.concatenate([trimesh.creation.box((20, 20, 20)), trimesh.creation.box((8, 8, 8))]),
    "open": trimesh.Trimesh([[0, 0, 0], [9, 0, 0], [0, 9, 0], [9, 9, 3]], [[0, 1, 2], [2, 1, 3]], process=False),
}


def both(mesh, monkeypatch, **options):
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32)
    packets = RayCaster(vertices, faces, **options)
    assert packets._packets is not None
    monkeypatch.setattr(_caster, "packet_scene", lambda *_, **__: None)
    single = RayCaster(vertices, faces)
    assert single._packets is None
    return packets, single


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES.keys())
@pytest.mark.parametrize(("count", "rays"), [(1, 1.0), (15, np.inf), (16, 1.0), (17, np.inf), (3001, 1.0)])
def test_packets_answer_as_single_rays(monkeypatch, mesh, count, rays):
    packets, single = both(mesh, monkeypatch, rays=rays)
    rng = np.random.default_rng(count)
    eye = np.array([3.0, -4.0, 60.0])
    directions = mesh.bounds[0] + rng.random((count, 3)) * np.ptp(mesh.bounds, axis=0) - eye
    first = packets.first_hit(eye, directions)
    assert first.dtype == np.int32
    np.testing.assert_array_equal(first, single.first_hit(eye, directions))
    assert packets._maps.check() == mesh.is_watertight  # from then on, first hits are found in packets, too
    np.testing.assert_array_equal(first, packets.first_hit(eye, directions, neighbours=True))
    points = mesh.triangles_center[rng.integers(0, len(mesh.faces), count)]
    normals = rng.normal(size=(count, 3))
    targets = rng.normal(size=(5, 3)) * 40.0
    pairs = {
        "point_index": np.arange(count, dtype=np.int32),
        "target_index": rng.integers(0, 5, count).astype(np.int32),
    }
    blocked = packets.occluded(points, normals, targets, **pairs)
    np.testing.assert_array_equal(blocked, single.occluded(points, normals, targets, **pairs))
    if count > 1000:
        assert np.mean(first >= 0) > 0.02
        assert 0.02 < np.mean(blocked) < 0.98
    assert packets.rays_cast == 3 * count
    met = packets.next_hit(points, normals, targets[pairs["target_index"]] - points)
    np.testing.assert_array_equal(met, single.next_hit(points, normals, targets[pairs["target_index"]] - points))
    chosen = rng.integers(-1, 5, count).astype(np.int32)
    seen = packets.sees_one(points, normals, targets, chosen=chosen)
    of_all = packets.visible(points, normals, targets, candidates=np.ones((5, count), np.bool_))
    np.testing.assert_array_equal(seen, (chosen >= 0) & of_all[chosen, np.arange(count)])
    np.testing.assert_array_equal(seen, single.sees_one(points, normals, targets, chosen=chosen))
    assert packets.rays_cast == 9 * count + np.count_nonzero(chosen >= 0)


@pytest.mark.parametrize("height", [0.0, 0.5])
def test_answers_do_not_depend_on_the_other_rays(monkeypatch, height):
    """Rays exactly through vertices, through edges that triangles share, and along the border of an open mesh."""
    n = 40
    rng = np.random.default_rng(1)
    grid = np.stack(np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0), indexing="ij"), -1).reshape(-1, 2)
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    below, above = corner + n + 1, corner + 1
    faces = np.vstack([np.stack([corner, below, above], axis=1), np.stack([above, below, below + 1], axis=1)])
    vertices = np.column_stack([grid, height * rng.random(len(grid))])
    packets, single = both(trimesh.Trimesh(vertices, faces, process=False), monkeypatch)
    edges = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.vstack([vertices, vertices[edges].mean(axis=1)])
    eye = np.array([0.5 * n, 0.5 * n, 60.0])
    beyond = ends + 0.3 * (ends - eye)

    def answers(caster, some):
        none = np.zeros(len(some), np.int32)
        blocked = caster.occluded(
            beyond, np.zeros_like(beyond), eye[None], point_index=some.astype(np.int32), target_index=none
        )
        return np.stack([caster.first_hit(eye, (ends - eye)[some]), blocked])

    whole = answers(packets, np.arange(len(ends)))
    assert np.mean(whole[1]) > 0.9
    np.testing.assert_array_equal(whole, answers(single, np.arange(len(ends))))
    for _ in range(3):
        order = rng.permutation(len(ends))
        np.testing.assert_array_equal(whole[:, order], answers(packets, order))
    pieces = [np.arange(k, min(k + 7, len(ends))) for k in range(0, len(ends), 7)]
    np.testing.assert_array_equal(whole, np.hstack([answers(packets, piece) for piece in pieces]))


TIES = {
    "edges": trimesh.creation.box((20, 20, 20)).subdivide().subdivide(),
    # upper faces in one plane: bodies that overlap, and one body twice
    "coplanar": trimesh.util.concatenate(
        [
            trimesh.creation.box(bounds=[[-10, -10, -10], [10, 10, 10]]).subdivide(),
            trimesh.creation.box(bounds=[[-4, -6, -2], [7, 5, 10]]),
        ]
    ),
    "twice": trimesh.util.concatenate([trimesh.creation.icosphere(2, 10.0)] * 2),
}


@pytest.mark.parametrize("mesh", TIES.values(), ids=TIES.keys())
def test_of_triangles_at_the_same_distance_it_is_the_one_that_a_ray_alone_meets(monkeypatch, mesh):
    packets, single = both(mesh, monkeypatch)
    assert packets._maps.check()
    rng = np.random.default_rng(3)
    ends = np.vstack([mesh.vertices, mesh.vertices[mesh.edges].mean(axis=1), mesh.triangles_center])
    across = np.array([[x, y, 10.0] for x in np.arange(-10.0, 10.5, 0.5) for y in np.arange(-10.0, 10.5, 0.5)])
    eye = np.array([0.0, 0.0, 50.0])
    directions = np.vstack([ends, across]) - eye
    alone = single.first_hit(eye, directions)
    assert np.mean(alone >= 0) > 0.5
    for _ in range(5):
        order = rng.permutation(len(directions))
        np.testing.assert_array_equal(alone[order], packets.first_hit(eye, directions[order], neighbours=True))


def test_no_rays_are_no_answers(monkeypatch):
    packets, single = both(MESHES["sphere"], monkeypatch)
    none = np.zeros((0, 3))
    assert packets.first_hit(np.zeros(3), none).shape == single.first_hit(np.zeros(3), none).shape == (0,)


@pytest.mark.parametrize("reason", ["no library", "another version", "no packets"])
def test_without_what_packets_need_embreex_answers(monkeypatch, tmp_path, reason):
    _ray_packets._embree.cache_clear()
    _ray_packets._works.cache_clear()
    if reason == "no library":
        monkeypatch.setattr(_ray_packets.embreex, "__file__", str(tmp_path / "embreex" / "__init__.py"))
    elif reason == "another version":
        monkeypatch.setattr(_ray_packets, "_MAJOR", 5)
    else:
        monkeypatch.setattr(_ray_packets, "_NATIVE_WIDTHS", ())
    try:
        mesh = MESHES["sphere"]
        caster = RayCaster(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32))
        assert caster._packets is None
        assert caster.first_hit(np.array([0.0, 0.0, 60.0]), np.array([[0.0, 0.0, -1.0]]))[0] >= 0
    finally:
        _ray_packets._embree.cache_clear()
        _ray_packets._works.cache_clear()
