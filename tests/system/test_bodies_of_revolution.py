"""The turn of a body of revolution shows nowhere, however its mesh is made; a small feature shows it.

Expected: real parts have no facets. So those of a mesh never determine a turn, whether the images have others, the same
or none; a flat, a key, a pin or a dimple does.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from captured import PART, RIG, captured, observe

from lightopt import build_scene
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Placement, PoseFrame, place_part
from lightopt.estimate.registration._refinement import choose_pixels
from lightopt.estimate.registration._registration import refine_placement, unobservable_rotation
from lightopt.rendering import cast_rays_at

PROFILE = [[0, 0], [12, 0], [12, 4], [6, 8], [0, 9]]
TILTED = Posture(elevation_deg=-25.0, rotation_deg=40.0)


def revolved(sections, profile=PROFILE, steps=1):
    ends = np.asarray(profile, np.float64)
    along = np.arange(steps)[:, None] / steps
    pieces = [a + along * (b - a) for a, b in itertools.pairwise(ends)]
    return trimesh.creation.revolve(np.concatenate([*pieces, ends[-1:]]), sections=sections)


def with_flat(sections, x):
    mesh = revolved(sections, steps=12)
    mesh.vertices = np.minimum(mesh.vertices, [x, np.inf, np.inf])
    return mesh


def with_block(sections, size, at):
    block = trimesh.creation.box(extents=size)
    return trimesh.util.concatenate([revolved(sections), block.apply_translation(at)])


def with_dimple(sections, depth):
    # 1 mm wide, half way up the cone
    mesh, at = revolved(sections, steps=12), np.array([8.0, 0.0])
    for _ in range(4):
        near = np.linalg.norm(mesh.triangles_center[:, :2] - at, axis=1) < 1.5
        mesh = mesh.subdivide(face_index=np.flatnonzero(near))
    vertices = mesh.vertices.copy()
    far = np.linalg.norm(vertices[:, :2] - at, axis=1) / 0.5
    vertices[:, 2] -= np.where(vertices[:, 2] > 1.0, depth * np.exp(-far * far), 0.0)
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def torus_of_unequal_facets(seed=0):
    # as tessellators may leave it: corners anywhere near their places, always on the surface
    mesh, rng = (trimesh.creation.torus(9.0, 4.0, major_sections=120, minor_sections=60), np.random.default_rng(seed))
    x, y, z = mesh.vertices.T
    about, across = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y) - 9.0)
    about, across = (a + rng.uniform(-0.1, 0.1, len(a)) * 2.0 * math.pi / n for a, n in ((about, 120), (across, 60)))
    radius = 9.0 + 4.0 * np.cos(across)
    mesh.vertices = np.stack([radius * np.cos(about), radius * np.sin(about), 4.0 * np.sin(across)], axis=1)
    return mesh


def ring(sections):
    # with a bore: its floor is not there
    return revolved(sections, [[3, 0], [12, 0], [12, 4], [6, 8], [3, 8], [3, 0]])


@pytest.fixture(scope="module")
def scene_of(tmp_path_factory):
    folder = tmp_path_factory.mktemp("revolution")
    rig = RIG.replace("[160, 120]", "[130, 130]").replace("pixel_size_um: 44", "pixel_size_um: 26")
    (folder / "close.yaml").write_text(rig, encoding="utf-8")
    rig = RIG.replace("[160, 120]", "[200, 150]").replace("pixel_size_um: 44", "pixel_size_um: 22")
    (folder / "fine.yaml").write_text(rig, encoding="utf-8")
    (folder / "part.yaml").write_text(PART.replace("knob.stl", "part.stl"), encoding="utf-8")

    def build(mesh, *postures, rig="fine"):
        mesh.export(folder / "part.stl")
        return build_scene(folder / f"{rig}.yaml", folder / "part.yaml", postures=postures)

    return build


def turns_of(scene, pose=(0.0, 0.0, 0.0)):
    frame, pose = PoseFrame.of(scene), np.array(pose)
    light, posture = scene.lights[0].name, scene.postures[0]
    black = np.zeros((scene.camera.height, scene.camera.width))
    inner, _ = choose_pixels(
        scene,
        [observe(light, posture, 1.0, black, scene)],
        frame.placement(pose),
        outline=False,
        reduced=True,
        threads=2,
    )
    return unobservable_rotation(scene, frame, inner, pose, caster=cast_rays_at(scene))


@pytest.mark.parametrize("posture", [Posture(0.0, 0.0), TILTED])
@pytest.mark.parametrize(
    "mesh",
    [
        *(lambda n=n: revolved(n) for n in (24, 45, 64, 180, 720)),
        lambda: revolved(32, steps=12),
        lambda: ring(64),
        lambda: trimesh.creation.cylinder(12.0, 6.0, sections=48),
        lambda: trimesh.creation.uv_sphere(12.0, count=[48, 64]),
        lambda: trimesh.creation.icosphere(4, 12.0),
        torus_of_unequal_facets,
    ],
    ids=[
        "24",
        "45",
        "64",
        "180",
        "720",
        "fine 32",
        "ring",
        "cylinder",
        "sphere",
        "sphere of even triangles",
        "unequal facets",
    ],
)
def test_a_body_of_revolution_shows_no_turn(scene_of, mesh, posture):
    (turn,) = turns_of(scene_of(mesh(), posture), pose=(0.3, -0.2, math.radians(1.0)))
    assert turn == pytest.approx([0.0, 0.0, 1.0], abs=0.05)


def test_its_axis_need_not_be_that_of_the_stage(scene_of):
    """The direction is the turn about the part's own axis, which its pose has in the middle."""
    scene = place_part(scene_of(revolved(64), Posture(0.0, 0.0)), Placement(x=4.0, y=-3.0))
    (turn,) = turns_of(scene)
    assert turn == pytest.approx([0.0, 0.0, 1.0], abs=0.05)


@pytest.mark.parametrize("sections", [32, 64, 180])
@pytest.mark.parametrize(
    ("mesh", "posture"),
    [
        (lambda n: with_flat(n, 11.5), Posture(0.0, 0.0)),
        (lambda n: with_flat(n, 11.7), TILTED),
        (lambda n: with_block(n, (3.0, 2.0, 2.0), (11.3, 0.0, 4.0)), Posture(0.0, 0.0)),
        (lambda n: with_block(n, (0.8, 0.8, 9.0), (8.0, 0.0, 3.5)), TILTED),
        (lambda n: with_dimple(n, 0.2), Posture(0.0, 0.0)),
        (lambda n: with_dimple(n, 0.02), Posture(0.0, 0.0)),
    ],
    ids=["flat", "shallow flat", "key", "pin", "dimple", "shallow dimple"],
)
def test_a_small_feature_shows_the_turn(scene_of, sections, mesh, posture):
    assert len(turns_of(scene_of(mesh(sections), posture))) == 0


def test_no_body_of_revolution_shows_the_turn(scene_of):
    for mesh in (
        trimesh.creation.box(extents=(16.0, 16.0, 3.0)),
        trimesh.creation.cylinder(4.0, 16.0, sections=64, transform=np.eye(4)[[2, 0, 1, 3]]),
        revolved(64).apply_scale([1.01, 1.0, 1.0]),
        trimesh.creation.cylinder(12.0, 6.0, sections=6),
    ):
        assert len(turns_of(scene_of(mesh, Posture(0.0, 0.0)))) == 0


def test_facets_that_are_the_surface_show_the_turn(scene_of):
    scene = scene_of(revolved(24), TILTED)
    assert len(turns_of(replace(scene, mesh=replace(scene.mesh, normals=None)))) == 0


@pytest.mark.slow
@pytest.mark.parametrize("sections", [180, pytest.param(64, marks=pytest.mark.nightly)])
def test_other_facets_than_those_of_the_images_turn_no_part(scene_of, sections):
    """Images of 1,440 sections, a mesh of fewer."""
    true = scene_of(revolved(1440), Posture(0.0, 0.0), rig="close")
    away = Placement(x=0.5, y=-0.3, turn=math.radians(2.0))
    scene = scene_of(revolved(sections), Posture(0.0, 0.0), rig="close")
    images = captured(scene, mesh=place_part(true, away).mesh)
    found = refine_placement(scene, images, away, caster=cast_rays_at(scene))
    place = found.placement
    assert place.observable == (True, True, False)
    assert place.turn == 0.0
    assert place.errors[2] == pytest.approx(math.radians(6.0))
    assert (place.x, place.y) == pytest.approx((away.x, away.y), abs=0.05)
    (reported, *_) = found.warnings
    assert reported.startswith("the rotation about the rotary axis cannot be determined from these images")
