"""Registration where images say little, nothing, or something that the model does not describe.

Expected: what they do not determine stays as in the part file, with a warning in words; images that show nothing are an
input error; a plate that lies inside the view is found by its outline; a reflectance that is not the model's is not
blamed on the place.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from captured import PART, RIG, captured
from photographed_sphere import photograph_sphere

from lightopt import build_scene
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.estimate.reflectance._fit_samples import fit_reflectance
from lightopt.estimate.reflectance._mismatch_causes import refuse_unexplained_images
from lightopt.estimate.reflectance._quality import assess_quality
from lightopt.estimate.reflectance._samples import collect_samples
from lightopt.estimate.reflectance._setup import FitSetup
from lightopt.estimate.registration import Placement, place_part, register
from lightopt.rendering import cast_rays_at

AWAY = Placement(x=1.0, y=-0.6, turn=math.radians(1.0))
FLAT = (Posture(0.0, 0.0),)
MESHES = {
    "plate": lambda: trimesh.creation.box(extents=(40, 25, 3)),
    "wall": lambda: trimesh.creation.box(extents=(140, 110, 3)),
    "rail": lambda: trimesh.creation.box(extents=(140, 25, 3)),
    "ball": lambda: trimesh.creation.icosphere(4, 15.0),
    "towers": lambda: towers(),
}


def towers():
    """Leaning towers of plane faces on a plate: most of it lies beside a shadow."""
    parts = [trimesh.creation.box(extents=(44, 30, 3))]
    for number, (x, y, height) in enumerate([(-14, -7, 12), (-2, 8, 9), (9, -6, 14), (15, 8, 7), (-13, 8, 6)]):
        tower = trimesh.creation.cylinder(radius=5, height=2 * height, sections=5 + number)
        tower.apply_transform(trimesh.transformations.rotation_matrix(0.15 * number - 0.3, (1, 1, 0)))
        parts.append(tower.apply_translation((x, y, 0)))
    return trimesh.util.concatenate(parts)


TURN = "the rotation about the rotary axis cannot be determined from these images; assumed as in the part file"


@pytest.fixture(scope="module")
def scene_of(tmp_path_factory):
    folder = tmp_path_factory.mktemp("limits")
    rig = RIG.replace("[160, 120]", "[320, 240]").replace("pixel_size_um: 44", "pixel_size_um: 22")
    rig = rig.replace("[-45, 45]", "[-90, 90]")
    (folder / "rig.yaml").write_text(rig, encoding="utf-8")

    def build(name, postures=FLAT):
        MESHES[name]().export(folder / f"{name}.stl")
        text = PART.replace("knob.stl", f"{name}.stl")
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
        return build_scene(folder / "rig.yaml", folder / f"{name}.yaml", postures=postures)

    return build


@pytest.fixture(scope="module")
def plate(scene_of):
    scene = scene_of("plate")
    return scene, captured(scene)


def registered(scene, images):
    return register(scene, images, caster=cast_rays_at(scene))


def with_levels(images, levels):
    return tuple(replace(o, levels=q, saturated=q >= 255.0) for o, q in zip(images, levels, strict=True))


def grey(images, seed=0):
    rng = np.random.default_rng(seed)
    return [np.round(90.0 + 1.2 * rng.normal(size=o.levels.shape)).astype(np.float32) for o in images]


@pytest.mark.slow
def test_a_plate_is_found_by_its_outline(plate):
    """Its inner pixels are alike, wherever it lies; a pixel is 0.22 mm."""
    scene, _ = plate
    found = registered(scene, captured(place_part(scene, AWAY)))
    place = found.placement
    assert found.outline
    assert found.warnings == ()
    off = np.array([place.x - AWAY.x, place.y - AWAY.y, place.turn - AWAY.turn])
    assert np.all(np.abs(off) < 3.0 * np.array(place.errors))
    assert max(abs(off[:2])) < 0.1
    assert 0.05 < max(place.errors[:2]) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    "place", [pytest.param(Placement(), marks=pytest.mark.nightly), Placement(x=0.9, y=-0.7, turn=math.radians(0.8))]
)
def test_a_part_of_plane_faces_beside_shadows_is_found(scene_of, place):
    """Pixels beside shadows have a prediction at one place and none at the next: the search must not stop there."""
    scene = scene_of("towers")
    found = registered(scene, captured(place_part(scene, place)))
    assert found.converged
    assert found.warnings == ()
    off = np.array([getattr(found.placement, axis) - getattr(place, axis) for axis in ("x", "y", "turn")])
    assert np.all(np.abs(off) < 3.5 * np.array(found.placement.errors))
    assert np.all(np.array(found.placement.errors) < (0.2, 0.2, 0.01))


@pytest.mark.slow
def test_of_even_grey_images_nothing_is_concluded(plate):
    scene, images = plate
    matte = replace(scene, reflectance=replace(scene.reflectance, R_s=1e-3))
    found = registered(matte, with_levels(images, grey(images)))
    place = found.placement
    assert (place.x, place.y, place.turn) == (0.0, 0.0, 0.0)
    assert place.observable == (False, False, False)
    (reported,) = found.warnings
    assert reported.startswith(
        "the placement of the part cannot be determined from these images; assumed as in the part"
    )


@pytest.mark.parametrize(
    ("level", "reported"), [(255.0, "every pixel of the part is saturated"), (0.0, "black where the part is expected")]
)
def test_images_that_show_nothing_are_refused(plate, level, reported):
    scene, images = plate
    with pytest.raises(InputError, match=reported):
        registered(scene, with_levels(images, [np.full_like(o.levels, level) for o in images]))


def test_a_part_outside_the_view_is_refused(plate):
    scene, images = plate
    away = place_part(scene, Placement(x=300.0))
    with pytest.raises(InputError, match="shows the part lit"):
        registered(away, images)


@pytest.mark.slow
def test_one_light_that_failed_does_not_move_the_part(plate):
    scene, _ = plate
    images = captured(place_part(scene, AWAY))
    dark = [np.zeros_like(o.levels) if o.light == "light1" else o.levels for o in images]
    place = registered(scene, with_levels(images, dark)).placement
    assert (place.x, place.y) == pytest.approx((AWAY.x, AWAY.y), abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "observable"),
    [("wall", (False, False, False)), pytest.param("rail", (False, True, True), marks=pytest.mark.nightly)],
)
def test_what_a_plate_larger_than_the_view_hides_stays_nominal(scene_of, name, observable):
    scene = scene_of(name)
    found = registered(scene, captured(place_part(scene, AWAY)))
    place = found.placement
    assert place.observable == observable
    assert len(found.warnings) == 1
    assert abs(place.x) < 0.1
    if observable[1]:
        assert place.y == pytest.approx(AWAY.y, abs=0.1)
        assert found.warnings[0].startswith("the shift along ")
        assert place.turn == pytest.approx(AWAY.turn, abs=math.radians(0.5))


@pytest.mark.slow
def test_a_plate_seen_edge_on_does_no_harm(scene_of):
    scene = scene_of("plate", (Posture(90.0, 0.0),))
    found = registered(scene, captured(scene))
    assert np.isfinite([found.placement.x, found.placement.y, found.placement.turn]).all()
    assert max(abs(found.placement.x), abs(found.placement.y)) < 1.0
    assert not all(found.placement.observable)
    assert found.warnings


# --- another surface than the model's


@pytest.fixture(scope="module")
def ball(scene_of):
    scene = scene_of("ball")
    centre = 0.5 * (scene.mesh.vertices.min(axis=0) + scene.mesh.vertices.max(axis=0))
    return scene, centre


@pytest.mark.nightly
@pytest.mark.parametrize("R_d", [31.0, 45.0])
def test_another_reflectance_is_not_blamed_on_the_place(ball, R_d):
    """An exact sphere whose highlights have two lobes with tails: the residual is no displacement."""
    scene, centre = ball
    images = photograph_sphere(scene, centre, 15.0, R_d=R_d, wide=(3500.0, 0.12))
    world = FitSetup(scene, cast_rays_at(scene), images)
    samples = collect_samples(scene, images, caster=world.caster, budget=500)
    found = fit_reflectance(samples)
    quality = assess_quality(samples, found)
    refuse_unexplained_images(world, samples, found, quality)
    place = registered(scene, images).placement
    assert max(abs(place.x), abs(place.y)) < 0.11  # half a pixel


@pytest.mark.slow
def test_a_displaced_part_with_another_reflectance_is_found(ball):
    scene, centre = ball
    place = registered(scene, photograph_sphere(scene, centre + np.array([1.0, -0.6, 0.0]), 15.0)).placement
    assert (place.x, place.y) == pytest.approx((1.0, -0.6), abs=0.11)
