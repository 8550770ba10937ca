"""Patches at silhouettes and creases are left out where defects are planned for, as an inspection leaves them out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from lightopt.config import load_part, load_rig
from lightopt.core.transforms import Posture
from lightopt.geometry import face_normals
from lightopt.rendering import build_patches, cast_rays_at
from lightopt.scene import build_scene, project, view_from_part

SIDE, STEP = 20.0, 2.0
POSTURES = (Posture(0.0, 0.0), Posture(0.0, 30.0))


def step():
    """A block of two heights: from above a square whose border is a silhouette, with the edge of a step at x = 0."""
    blocks = [trimesh.creation.box((0.5 * SIDE, SIDE, height)) for height in (6.0, 6.0 + STEP)]
    for block, side in zip(blocks, (-1.0, 1.0), strict=True):
        block.apply_translation((0.25 * side * SIDE, 0.0, 0.5 * block.extents[2]))
    return trimesh.util.concatenate(blocks)


@pytest.fixture(scope="module")
def cut(shared_bench, tmp_path_factory):
    """The block in two postures from above, its patches, and those without edges."""
    bench = type(shared_bench).make(tmp_path_factory.mktemp("edges") / "bench")
    step().export(bench.mesh)
    scene = replace(build_scene(load_rig(bench.rig), load_part(bench.part)), postures=POSTURES)
    caster = cast_rays_at(scene)
    table = build_patches(scene, caster=caster, budget=3000)
    return scene, caster, table, build_patches(scene, caster=caster, budget=3000, edges=False)


def image_of(scene, posture, points):
    camera = view_from_part(scene, posture).camera
    return np.stack(project(camera, np.atleast_2d(points))[:2], axis=-1)


@pytest.mark.parametrize("posture", POSTURES)
def test_what_is_left_out_lies_next_to_an_edge_and_nothing_next_to_one_is_kept(cut, posture):
    scene, _, table, without = cut
    top = np.zeros(len(table.patches), bool)
    top[table.inspectable(posture)] = True
    top &= face_normals(scene.mesh)[table.patches.face][:, 2] > 0.99
    # the square's border and the step, as densely dotted lines in the image
    half, high = 0.5 * SIDE, float(scene.mesh.vertices[:, 2].max())
    along = np.linspace(-half, half, 800)
    across = ((-half, high - STEP), (0.0, high), (half, high))
    lines = [np.c_[np.full(800, x), along, np.full(800, z)] for x, z in across]
    lines += [np.c_[along, np.full(800, y), np.where(along < 0.0, high - STEP, high)] for y in (-half, half)]
    edges = image_of(scene, posture, np.concatenate(lines))
    places = image_of(scene, posture, table.patches.centroids[top])
    distance = np.array([np.linalg.norm(edges - place, axis=1).min() for place in places])
    row = POSTURES.index(posture)
    left_out = without.grazing[row, top]
    assert left_out[distance < 2.5].all()
    assert not left_out[distance > 4.5].any()
    assert 50 < left_out.sum() < (~left_out).sum()


def test_nothing_else_of_the_table_changes(cut):
    _, _, table, without = cut
    assert np.array_equal(without.patches.centroids, table.patches.centroids)
    assert np.array_equal(without.visible, table.visible)
    # what is at a grazing angle stays so, and of unseen patches nothing is said
    assert (without.grazing >= table.grazing).all()
    assert np.array_equal(without.grazing[~table.visible], table.grazing[~table.visible])
