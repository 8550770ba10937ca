"""Patches of a scene: budget, visibility against brute force, and the maps between patches and pixels."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from lightopt import build_scene
from lightopt.geometry import face_areas, face_normals
from lightopt.rendering import PatchTable, build_patches, cast_rays_at, patch_pixels, patch_positions, render_posture
from lightopt.scene import project, view_from_part

SPOUT = "spout.stl"


@pytest.fixture(scope="module")
def scene(shared_bench):
    return build_scene(shared_bench.rig, shared_bench.part)


@pytest.fixture(scope="module")
def spout(tmp_path_factory, shared_bench):
    """The part that hides some of itself, seen aslant."""
    from pathlib import Path

    folder = tmp_path_factory.mktemp("spout")
    mesh = Path(__file__).resolve().parents[2] / "configs" / "parts" / SPOUT
    text = shared_bench.part.read_text(encoding="utf-8").replace("knob.stl", mesh.as_posix())
    (folder / "part.yaml").write_text(text.replace("elevation_deg: -10", "elevation_deg: -30"), encoding="utf-8")
    return build_scene(shared_bench.rig, folder / "part.yaml")


def test_the_budget_is_kept(scene, spout):
    for s in (scene, spout):
        caster = cast_rays_at(s)
        for budget in (3_000, 8_000, 30_000):
            table = build_patches(s, caster=caster, budget=budget)
            visible = int(table.visible.any(axis=0).sum())
            assert 0.5 * budget < visible <= 1.1 * budget
            assert table.max_edge > table.footprint


def test_with_budget_enough_patches_reach_the_pixels_footprint(scene):
    table = build_patches(scene, caster=cast_rays_at(scene))
    assert table.max_edge == table.footprint
    # the part's top, 18.5 mm above the table and tilted a little, is nearest to the camera
    assert table.footprint == pytest.approx(0.044 / 55 * (550 - 18.5), rel=0.01)
    assert "the pixel's footprint" in table.message
    corners = table.patches.vertices[table.patches.triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    visible = table.visible.any(axis=0)
    # a face that shows neither at a pixel's centre nor at its own centroid is left whole; a corner of it may show
    assert edges[visible].max() <= table.footprint * (1 + 1e-9)
    caster = cast_rays_at(scene)
    for posture in scene.postures:
        channel = render_posture(scene, posture, caster=caster, patches=table.patches).geometry.patch
        assert edges[channel[channel >= 0]].max() <= table.footprint * (1 + 1e-9)


def test_a_mesh_finer_than_the_budget_is_not_coarsened(scene):
    table = build_patches(scene, caster=cast_rays_at(scene), budget=10)
    assert len(table.patches) == len(scene.mesh.faces)
    assert np.array_equal(table.patches.face, np.arange(len(scene.mesh.faces)))


def test_large_flat_faces_are_cut_however_fine_the_rest_is(shared_bench, tmp_path):
    # a plate of a few triangles, of whose top a fine ball hides the middle
    plate, ball = trimesh.creation.box((40.0, 30.0, 4.0)), trimesh.creation.icosphere(4, 6.0)
    ball.apply_translation((0.0, 0.0, 9.0))
    trimesh.util.concatenate([plate, ball]).export(tmp_path / "knob.stl")
    (tmp_path / "part.yaml").write_bytes(shared_bench.part.read_bytes())
    scene = build_scene(shared_bench.rig, tmp_path / "part.yaml")
    caster = cast_rays_at(scene)
    tables = {budget: build_patches(scene, caster=caster, budget=budget) for budget in (400, 30_000)}
    coarse = tables[400]
    assert coarse.seen_faces > 1_000
    assert f"{coarse.seen_faces:,} of the mesh's own triangles may show" in coarse.message
    cut = len(coarse.patches) - len(scene.mesh.faces)
    assert 100 < cut <= 200
    corners = coarse.patches.vertices[coarse.patches.triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    assert edges[coarse.visible.any(axis=0)].max() <= coarse.max_edge < 10.0
    seen = [t.patches.areas[t.visible.any(axis=0)].sum() / t.patches.areas.sum() for t in tables.values()]
    assert seen[0] == pytest.approx(seen[1], abs=2.0 * coarse.grain)
    assert tables[30_000].grain < 0.2 * coarse.grain < 0.01
    # as many where the fine ones are nearly the budget, which is exceeded then, and said to be
    near = build_patches(scene, caster=caster, budget=coarse.seen_faces + 10)
    visible = int(near.visible.any(axis=0).sum())
    assert near.exceeded == coarse.seen_faces + 10 < visible <= 1.5 * near.exceeded
    assert f"more than the patch budget of {near.exceeded:,}: half of it is for cutting" in near.message
    assert (coarse.exceeded, tables[30_000].exceeded, near.seen_faces) == (0, 0, 0)


def test_the_grain_is_the_scatter_of_shares_by_chance(scene):
    table = build_patches(scene, caster=cast_rays_at(scene), budget=3_000)
    areas = table.patches.areas[table.inspectable_anywhere]
    shares = np.random.default_rng(1).integers(0, 2, (4_000, len(areas))) @ areas / areas.sum()
    assert table.grain == pytest.approx(float(shares.std()), rel=0.05)


def test_the_message_says_what_was_reached(scene):
    table = build_patches(scene, caster=cast_rays_at(scene), budget=4_000)
    visible = int(table.visible.any(axis=0).sum())
    assert table.message == (
        f"{visible:,} visible patches of {len(table.patches):,}; edges up to {table.max_edge:.3g} mm "
        f"({table.max_edge / table.footprint:.3g} times the pixel's footprint of {table.footprint:.3g} mm)"
    )


def test_areas_sum_up_to_the_meshs(scene):
    table = build_patches(scene, caster=cast_rays_at(scene), budget=8_000)
    assert table.patches.areas.sum() == pytest.approx(face_areas(scene.mesh).sum(), rel=1e-9)
    normals = np.linalg.norm(table.patches.normals, axis=1)
    assert np.allclose(normals, 1.0, atol=1e-9)


def test_arrays_and_back(scene):
    table = build_patches(scene, caster=cast_rays_at(scene), budget=4_000)
    arrays = table.arrays()
    again = PatchTable.from_arrays(arrays)
    assert again.postures == table.postures
    assert (again.max_edge, again.footprint) == (table.max_edge, table.footprint)
    for name, values in again.arrays().items():
        assert values.dtype == arrays[name].dtype, name
        assert np.array_equal(values, arrays[name]), name


def test_the_file_is_the_table(cli, scene, shared_bench, tmp_path):
    ran = cli("render", shared_bench.rig, shared_bench.part, "-o", tmp_path, "-q", "--patches", "4000")
    assert ran.status == 0
    table = build_patches(scene, caster=cast_rays_at(scene), budget=4_000)
    with np.load(tmp_path / "patches.npz", allow_pickle=False) as file:
        read = PatchTable.from_arrays({name: file[name] for name in file.files})
    for name, values in table.arrays().items():
        assert np.array_equal(values, read.arrays()[name]), name


# --- visibility


def brute_force_visible(scene, posture, centroids, facets):
    """As the paper has it, in the world: before the camera, in the image, from the front, and nothing in between."""
    view = view_from_part(scene, posture)
    world = centroids @ view.rotation.T + view.translation
    outward = facets @ view.rotation.T
    columns, rows, depth = project(scene.camera, world)
    in_image = (depth > 0) & (columns >= 0) & (columns < 160) & (rows >= 0) & (rows < 120)
    front = np.einsum("ij,ij->i", outward, scene.camera.position - world) > 0
    triangles = scene.mesh.vertices[scene.mesh.faces] @ view.rotation.T + view.translation
    blocked = blocked_by(triangles, scene.camera.position, world)
    return in_image & front & ~blocked


def blocked_by(triangles, eye, points):
    """Möller–Trumbore from the eye to each point, a hair short of it, against all triangles."""
    v0, e1, e2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    result = np.zeros(len(points), bool)
    s = eye - v0
    q = np.cross(s, e1)
    for i, point in enumerate(points):
        d = point - eye
        p = np.cross(d, e2)
        det = np.einsum("ij,ij->i", e1, p)
        det = np.where(np.abs(det) < 1e-12, np.nan, det)
        u = np.einsum("ij,ij->i", s, p) / det
        v = (q @ d) / det
        t = np.einsum("ij,ij->i", e2, q) / det
        result[i] = ((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1 - 1e-6)).any()
    return result


def test_visible_patches_are_those_that_rays_find(scene, spout):
    for s, share_hidden in ((scene, 0.0), (spout, 0.02)):
        table = build_patches(s, caster=cast_rays_at(s), budget=3_000)
        chosen = np.random.default_rng(1).choice(len(table.patches), 800, replace=False)
        facets = face_normals(s.mesh)[table.patches.face]
        for row, posture in enumerate(s.postures):
            expected = brute_force_visible(s, posture, table.patches.centroids[chosen], facets[chosen])
            found = table.visible[row, chosen]
            # a ray that grazes an edge may be either
            assert (found != expected).mean() <= 0.003
            assert found.any()
        hidden = ~table.visible.any(axis=0)
        towards_camera = facets[:, 2] > 0.3
        assert (hidden & towards_camera).mean() >= share_hidden


def test_a_block_hides_what_is_below_it(bench):
    """A roof over a floor: the floor's middle is hidden from a camera straight above, its rim is not."""
    floor = trimesh.creation.box((40.0, 40.0, 2.0), trimesh.transformations.translation_matrix((0, 0, 1)))
    roof = trimesh.creation.box((20.0, 20.0, 2.0), trimesh.transformations.translation_matrix((0, 0, 21)))
    bench.mesh.write_bytes(bytes(trimesh.util.concatenate([floor, roof]).export(file_type="stl")))
    bench.edit("part.yaml", ", {elevation_deg: -10, rotation_deg: 170}", "")
    s = build_scene(bench.rig, bench.part)
    table = build_patches(s, caster=cast_rays_at(s), budget=20_000)
    x, y, z = table.patches.centroids.T
    up = table.patches.normals[:, 2] > 0.99
    reach = np.maximum(np.abs(x), np.abs(y))
    edge = 10.0 * 548.0 / 528.0  # of the roof's shadow: projected from 550 mm over its top at 22 to the floor at 2
    visible = table.visible[0]
    assert visible[up & (z > 20)].all()
    assert not visible[up & (z < 3) & (reach < edge - 0.2)].any()
    assert visible[up & (z < 3) & (reach > edge + 0.2)].all()
    assert not visible[table.patches.normals[:, 2] < 0].any()


# --- patches and pixels


def test_patch_to_pixel_and_back(scene):
    table = build_patches(scene, caster=cast_rays_at(scene), budget=3_000)
    images = render_posture(scene, scene.postures[1], caster=cast_rays_at(scene), patches=table.patches)
    channel = images.geometry.patch
    lists = patch_pixels(channel, len(table.patches))
    assert len(lists.start) == len(table.patches) + 1
    # every pixel that hit is listed once, at the patch it shows
    assert np.array_equal(np.sort(lists.pixels), np.flatnonzero(channel.ravel() >= 0))
    assert np.array_equal(channel >= 0, images.geometry.hit)
    for patch in np.unique(channel[channel >= 0]):
        pixels = lists.of(int(patch))
        assert np.array_equal(pixels, np.flatnonzero(channel.ravel() == patch))
    unseen = np.setdiff1d(np.arange(len(table.patches)), channel)
    assert len(unseen)
    assert all(len(lists.of(int(patch))) == 0 for patch in unseen)
    # what a pixel's centre sees is visible, but for patches that are cut off by an edge of the part
    shown = np.unique(channel[channel >= 0])
    assert table.visible[1, shown].mean() > 0.98


def test_patch_pixels_of_nothing():
    lists = patch_pixels(np.full((3, 4), -1, np.int32), 5)
    assert len(lists.pixels) == 0
    assert np.array_equal(lists.start, np.zeros(6))


def test_patch_positions_are_where_the_pixels_show_them(scene):
    table = build_patches(scene, caster=cast_rays_at(scene), budget=30_000)
    posture = scene.postures[1]
    images = render_posture(scene, posture, caster=cast_rays_at(scene), patches=table.patches)
    columns, rows = patch_positions(table, scene, posture)
    assert columns.shape == rows.shape == (len(table.patches),)
    channel = images.geometry.patch
    seen_rows, seen_columns = np.nonzero(channel >= 0)
    patch = channel[seen_rows, seen_columns]
    # a patch of about a pixel's size lies within its longest edge of the pixel that shows it
    distance = np.hypot(columns[patch] - (seen_columns + 0.5), rows[patch] - (seen_rows + 0.5))
    assert distance.max() <= table.max_edge / table.footprint * math.sqrt(4 / 3)
    # by hand: posture, then camera
    world = scene.pivot + (table.patches.centroids - scene.pivot) @ posture.matrix.T
    assert np.allclose(np.stack(project(scene.camera, world)[:2]), [columns, rows], atol=1e-9)
