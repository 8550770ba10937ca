"""Where a part really lies: the moved view against points moved by hand, and a place found from images."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from captured import captured, expose_all
from scipy.spatial.transform import Rotation

from lightopt import build_scene, render
from lightopt.config import PlacementConfig
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Placement, PoseFrame, part_file_placement, place_part, register
from lightopt.estimate.registration._placement import NAMES, PixelSet, light_at, shares_seen, view_of_placed
from lightopt.estimate.registration._refinement import RefinementProblem, choose_pixels, start_parameters
from lightopt.estimate.registration._registration import refine_placement
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.scene import Scene, Stage, project, view_from_part
from lightopt.scene._scene import PartRegion

PIVOT = np.array([2.0, -3.0, 5.0])
TRUTH = Placement(x=0.7, y=-0.5, turn=math.radians(0.6))
TILTED = Posture(elevation_deg=-10.0, rotation_deg=170.0)
LEANING = replace(
    TRUTH, z=0.2, tilt_x=math.radians(0.4), tilt_y=math.radians(-0.3), errors=(0.0,) * 6, observable=(True,) * 6
)


@pytest.fixture(scope="module")
def scene(shared_bench) -> Scene:
    return replace(build_scene(shared_bench.rig, shared_bench.part), stage=Stage(pivot=PIVOT))


def by_hand(point: np.ndarray, placement: Placement) -> np.ndarray:
    """A point of the part where it lies on the stage at posture (0, 0)."""
    c, s = math.cos(placement.turn), math.sin(placement.turn)
    x, y, z = point - PIVOT
    turned = np.array([c * x - s * y, s * x + c * y, z])
    tilted = Rotation.from_rotvec([placement.tilt_x, placement.tilt_y, 0.0]).apply(turned)
    return PIVOT + tilted + np.array([placement.x, placement.y, placement.z])


@pytest.mark.parametrize("truth", [TRUTH, LEANING])
def test_a_placed_part_is_turned_about_the_stage_axis_and_then_shifted(scene: Scene, truth: Placement) -> None:
    placed = place_part(scene, truth)
    for before, after in zip(scene.mesh.vertices[::97], placed.mesh.vertices[::97], strict=True):
        np.testing.assert_allclose(after, by_hand(before, truth), atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(placed.mesh.normals, axis=1), 1.0, atol=1e-5)


@pytest.mark.parametrize("truth", [TRUTH, LEANING])
@pytest.mark.parametrize("posture", [Posture(elevation_deg=0.0, rotation_deg=0.0), TILTED])
def test_moving_the_view_is_moving_the_part(scene: Scene, posture: Posture, truth: Placement) -> None:
    nominal = view_of_placed(scene, posture, truth)
    moved = view_from_part(place_part(scene, truth), posture)
    point = scene.mesh.vertices[123]
    # as far from camera and lights, whether these were moved or the part
    there = by_hand(point, truth)
    for a, b in (
        (nominal.camera.position, moved.camera.position),
        *((p.centre, q.centre) for p, q in zip(nominal.lights, moved.lights, strict=True)),
    ):
        assert np.linalg.norm(a - point) == pytest.approx(np.linalg.norm(b - there), abs=1e-9)


@pytest.mark.parametrize("posture", [Posture(elevation_deg=0.0, rotation_deg=0.0), TILTED])
def test_the_moved_view_sees_the_image_of_the_moved_part(scene: Scene, posture: Posture) -> None:
    placed = place_part(scene, TRUTH)
    image = render_posture(placed, posture, caster=cast_rays_at(placed))
    view = view_of_placed(scene, posture, TRUTH)
    hit = image.geometry.hit
    row, column = (a[::41] for a in np.nonzero(hit))
    world = image.geometry.points[row, column].astype(np.float64)
    # back from the world to the part's own frame, by hand: posture, then shift, then turn
    on_stage = (world - PIVOT) @ posture.matrix + PIVOT
    c, s = math.cos(-TRUTH.turn), math.sin(-TRUTH.turn)
    flat = on_stage - PIVOT - np.array([TRUTH.x, TRUTH.y, 0.0])
    own = PIVOT + np.stack([c * flat[:, 0] - s * flat[:, 1], s * flat[:, 0] + c * flat[:, 1], flat[:, 2]], 1)
    columns, rows, _ = project(view.camera, own)
    np.testing.assert_allclose(columns, column + 0.5, atol=0.01)
    np.testing.assert_allclose(rows, row + 0.5, atol=0.01)


def test_poses_are_placements(scene: Scene) -> None:
    """The pose's middle is where the placement has it, and the errors of one follow from those of the other."""
    frame = PoseFrame.of(replace(scene, freedoms=6))
    pose = frame.pose(LEANING)
    middle = 0.5 * (scene.mesh.vertices.min(axis=0) + scene.mesh.vertices.max(axis=0))
    np.testing.assert_allclose(middle + pose[[0, 1, 3]], by_hand(middle, LEANING), atol=1e-6)
    covariance = np.diag([0.01, 0.02, 0.001, 0.03, 0.002, 0.003]) ** 2
    found = frame.placement(pose, covariance)
    for name in NAMES:
        assert getattr(found, name) == pytest.approx(getattr(LEANING, name), abs=1e-9)
    draws = np.random.default_rng(1).multivariate_normal(pose, covariance, 4000)
    drawn = np.array([[getattr(place, name) for name in NAMES] for place in map(frame.placement, draws)])
    np.testing.assert_allclose(found.errors, drawn.std(axis=0), rtol=0.06)


def test_pixels_keep_what_they_see_of_the_lights_while_the_part_moves(tmp_path, shared_bench) -> None:
    """A pixel lost at a shadow's edge would be a jump of the cost, at which the search for its minimum ends."""
    step = [[0, 0], [20, 0], [20, 4], [9, 4], [9, 14], [0, 14]]  # a shaft that throws shadows on its flange
    trimesh.creation.revolve(step, sections=120).export(tmp_path / "shaft.stl")
    text = shared_bench.part.read_text(encoding="utf-8").replace("knob.stl", "shaft.stl")
    (tmp_path / "shaft.yaml").write_text(text, encoding="utf-8")
    scene = build_scene(shared_bench.rig, tmp_path / "shaft.yaml", postures=(Posture(0.0, 0.0),))
    caster, frame = cast_rays_at(scene), PoseFrame.of(scene)
    images = captured(scene, exposures=(1.0,))
    inner, _ = choose_pixels(scene, images, Placement(), outline=False)
    start = start_parameters(scene, frame, Placement())
    problem = RefinementProblem(scene, frame, inner, [], start, caster=caster)
    used = np.isfinite(problem.residuals(start))
    lost, changed = 0, 0
    for shift in ((0.9, 0.0), (-0.9, 0.0), (0.0, 0.9), (0.0, -0.9)):
        moved = start.copy()
        moved[:2] = np.array(shift) * frame.pixel
        np.testing.assert_array_equal(np.isfinite(problem.residuals(moved)), used)
        # what is seen of the lights is searched for, or known: the same light where neither sees less
        view = view_of_placed(scene, inner[0].posture, frame.placement(moved[:3]))
        there = view_of_placed(scene, inner[0].posture, Placement())
        nominal, _ = light_at(scene, inner[0], there, caster)
        searched, _ = light_at(scene, inner[0], view, caster)
        shares = shares_seen(scene, inner[0], there, caster, sigma=None)
        known, _ = light_at(scene, inner[0], view, caster, shares=shares)
        both = (searched > 0.0) & (nominal > 0.0)
        np.testing.assert_array_equal(known[both], searched[both])
        np.testing.assert_array_equal(np.isnan(known), np.isnan(nominal))
        lost += np.count_nonzero(np.isnan(searched.ravel()) & used)
        changed += np.count_nonzero(known[~np.isnan(known)] > 0.0)
    assert lost > 10
    assert changed > 1000


def test_shares_are_of_lights_and_not_of_levels(scene: Scene) -> None:
    """A region without diffuse light is lit where only its highlights show it."""
    dark = replace(scene.reflectance, R_d=0.0)
    regions = np.ones(len(scene.mesh.faces), np.uint8)
    whole = PartRegion(name="mirror", reflectance=dark)
    mirror = replace(scene, mesh=replace(scene.mesh, material=regions), regions=(whole,))
    caster, posture = cast_rays_at(mirror), mirror.postures[0]
    rows, columns = (a.ravel().astype(np.int32) for a in np.mgrid[20:100:3, 30:130:3])
    pixels = PixelSet.look_up(posture, rows, columns, [captured(scene, exposures=(1.0,))[0]], 0.0)
    view = view_of_placed(mirror, posture, Placement())
    diffuse, searched = light_at(mirror, pixels, view, caster, sigmas=[0.0475])
    shares = shares_seen(mirror, pixels, view, caster, sigma=0.0475)
    _, known = light_at(mirror, pixels, view, caster, sigmas=[0.0475], shares=shares)
    assert np.nanmax(diffuse) == 0.0
    assert np.nanmax(searched) > 0.1
    np.testing.assert_array_equal(known, searched)


@pytest.mark.slow
def test_height_and_tilt_are_found_where_they_are_searched(scene: Scene) -> None:
    images = captured(place_part(scene, LEANING), exposures=(1.0, 1 / 16))
    wrong = replace(scene.reflectance, R_d=40.0, R_s=9000.0, sigma=0.06)
    caster = cast_rays_at(scene)
    registration = register(replace(scene, reflectance=wrong, freedoms=6), images, caster=caster)
    assert registration.converged
    assert registration.warnings == ()
    found = registration.placement
    off = np.array([getattr(found, name) - getattr(LEANING, name) for name in NAMES])
    assert np.all(np.abs(off[[0, 1, 3]]) < 0.03)
    assert np.all(np.abs(off[[2, 4, 5]]) < math.radians(0.05))
    assert np.all(np.array(found.errors) > 0.0)
    assert np.all(np.abs(off) < 5.0 * np.array(found.errors))
    # in the plane alone a shift makes up for the tilt
    flat = register(replace(scene, reflectance=wrong), images, caster=caster)
    assert abs(flat.placement.x - LEANING.x) > 0.1
    assert flat.cost_after > 1.05 * registration.cost_after


@pytest.mark.parametrize("truth", [TRUTH, LEANING])
@pytest.mark.parametrize("anchor", ["as_modelled", "rest_on_table", "centred"])
def test_a_part_file_can_say_where_the_part_lies(scene: Scene, shared_bench, anchor: str, truth: Placement) -> None:
    text = shared_bench.part.read_text(encoding="utf-8")
    was = "placement: {anchor: rest_on_table, translate_mm: [0, 0, 0]}"
    assert was in text
    there = (3.0, -2.0, 1.0), (4.0, -7.0, 30.0)
    path = shared_bench.part.with_name(f"{anchor}.yaml")

    def built(rotate: tuple[float, ...], translate: tuple[float, ...]) -> Scene:
        placement = f"placement: {{anchor: {anchor}, rotate_deg: {[*rotate]}, translate_mm: {[*translate]}}}"
        path.write_text(text.replace(was, placement), encoding="utf-8")
        return replace(build_scene(shared_bench.rig, path), stage=Stage(pivot=PIVOT))

    nominal = built(there[1], there[0])
    file = PlacementConfig(anchor=anchor, rotate_deg=there[1], translate_mm=there[0])
    found = part_file_placement(nominal, truth, file)
    said = built(found.rotate_deg, found.translate_mm)
    path.unlink()
    np.testing.assert_allclose(said.mesh.vertices, place_part(nominal, truth).mesh.vertices, atol=1e-3, rtol=0.0)


@pytest.mark.slow
def test_a_part_off_by_a_millimetre_is_found_and_the_errors_are_errors(scene: Scene) -> None:
    images = captured(place_part(scene, TRUTH), exposures=(1.0, 1 / 16))
    caster = cast_rays_at(scene)
    wrong = replace(scene.reflectance, R_d=40.0, R_s=9000.0, sigma=0.06)
    registration = register(replace(scene, reflectance=wrong), images, caster=caster)
    assert registration.converged
    assert registration.warnings == ()
    assert registration.cost_after < registration.cost_before
    found = registration.placement
    assert found.x == pytest.approx(TRUTH.x, abs=0.02)
    assert found.y == pytest.approx(TRUTH.y, abs=0.02)
    assert found.turn == pytest.approx(TRUTH.turn, abs=math.radians(0.05))
    off = np.array([found.x - TRUTH.x, found.y - TRUTH.y, found.turn - TRUTH.turn])
    assert np.all(np.array(found.errors) > 0.0)
    assert np.all(np.abs(off) < 5.0 * np.array(found.errors))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("draws", "low", "high"), [(4, 0.2, 2.0), pytest.param(20, 0.65, 1.45, marks=pytest.mark.nightly)]
)
def test_errors_of_a_placement_are_those_of_its_scatter(scene: Scene, draws: int, low: float, high: float) -> None:
    """Two exposures, whose bright and dark pixels have very different noise: z of many draws scatters by about 1."""
    rendered = list(render(place_part(scene, TRUTH)))
    caster = cast_rays_at(scene)
    start = replace(TRUTH, x=TRUTH.x - 0.01, y=TRUTH.y + 0.01)
    z = []
    for seed in range(draws):
        images = expose_all(scene, rendered, seed=seed, exposures=(1.0, 1 / 16))
        found = refine_placement(scene, images, start, caster=caster).placement
        off = np.array([found.x - TRUTH.x, found.y - TRUTH.y, found.turn - TRUTH.turn])
        z.append(off / np.array(found.errors))
    print("z of x, y, turn:", np.mean(z, axis=0).round(2), "±", np.std(z, axis=0).round(2))
    assert np.all(np.std(z, axis=0) < high)
    assert np.all(np.std(z, axis=0) > low)
    assert np.all(np.abs(np.mean(z, axis=0)) < 1.0)


@pytest.mark.slow
def test_a_body_of_revolution_is_taken_to_lie_as_its_file_has_it(tmp_path, shared_bench) -> None:
    """Nothing shows its turn; shifted off the axis that it turns about, a wrong turn would be a wrong place.

    The images have the same facets as the mesh: they are of a turn, but no part has any.
    """
    bowl = trimesh.creation.revolve([[0, 0], [24, 0], [22, 6], [12, 12], [0, 14]], sections=180)
    bowl.export(tmp_path / "bowl.stl")
    text = shared_bench.part.read_text(encoding="utf-8").replace("knob.stl", "bowl.stl")
    (tmp_path / "bowl.yaml").write_text(text, encoding="utf-8")
    flat = build_scene(shared_bench.rig, tmp_path / "bowl.yaml", postures=(Posture(0.0, 0.0),))
    images = captured(place_part(flat, TRUTH), exposures=(1.0,))
    caster = cast_rays_at(flat)
    registration = register(flat, images, caster=caster)
    found = registration.placement
    assert found.x == pytest.approx(TRUTH.x, abs=0.03)
    assert found.y == pytest.approx(TRUTH.y, abs=0.03)
    assert found.turn == 0.0
    assert found.observable == (True, True, False)
    (reported,) = registration.warnings
    assert reported.startswith(
        "the rotation about the rotary axis cannot be determined from these images; assumed as in"
    )
