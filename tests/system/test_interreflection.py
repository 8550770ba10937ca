"""Light from the part to the part against closed forms, and against sums over the other surface's area."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import reference as ref
from worlds import levels, merged, scene_from_mesh, sphere

from lightopt import build_scene, render
from lightopt.config import PartConfig, load_rig
from lightopt.config._rig import VirtualBenchConfig
from lightopt.core.errors import InputError
from lightopt.geometry import RayCaster, StraightBrushing, TriangleMesh
from lightopt.geometry._blocker_maps import BlockerMaps
from lightopt.lights import panel_grid, place_light
from lightopt.optics import Reflectance, SpecularModel, white_level
from lightopt.optics._albedo import DEFAULT_ALBEDO
from lightopt.rendering import SurfacePoints, cast_rays_at, render_posture, shade_isolated
from lightopt.rendering._caustics import caustic_levels, footprints, landed_light
from lightopt.rendering._converged_panel import isolated_levels
from lightopt.rendering._interreflection import PartLight, _mirrored_light
from lightopt.rendering._surface import trace_samples
from lightopt.rig.capture._wiring import bench_truth
from lightopt.rig.simulated._bench_process import BenchTruth
from lightopt.rig.simulated._optics import BenchOptics
from lightopt.scene import Lens, view_from_part
from lightopt.scene._scene import PartRegion

CONFIGS = Path(__file__).parents[2] / "configs"
MATTE = {"R_d": 100.0, "R_s": 0.0, "sigma": 0.05}
SATIN = {"R_d": 45.0, "R_s": 12500.0, "sigma": 0.0475}
BRUSHED = {"R_d": 45.0, "R_s": 1000.0, "sigma": 0.04, "model": SpecularModel(across_ratio=5.0)}
CAMERA = ref.Camera(width=80, height=60, pixel_um=88)


def rectangle(corner, first, second):
    """Two triangles; the normal is along first × second."""
    corner, first, second = (np.array(a, float) for a in (corner, first, second))
    corners = np.array([corner, corner + first, corner + first + second, corner + second])
    return TriangleMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), None)


def floor_and_wall(height, half=40.0):
    """A floor at z = 0 for x > 0, and a wall at x = 0 that faces +X."""
    floor = rectangle((0, -half, 0), (half, 0, 0), (0, 2 * half, 0))
    wall = rectangle((0, -half, 0), (0, 2 * half, 0), (0, 0, height))
    return merged(floor, wall)


def floor_points(places, views):
    """Points of the floor, at x and y, and directions that they are seen from."""
    points = np.array([(x, y, 0.0) for x, y in places])
    up = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    views = np.array(views, float)
    return SurfacePoints(points, up, up, views / np.linalg.norm(views, axis=1)[:, None], np.ones(len(points), bool))


def part_light(scene):
    return PartLight.of_scene(scene, scene.lights, cast_rays_at(scene))


def test_diffuse_light_of_a_wall_is_that_of_its_form_factor():
    """The wall shows R_d all over, lit along its normal; a place on the floor sees it under F of the plates' corner."""
    height, far = 15.0, 4000.0
    lamp = ref.Light(distance=1e6, elevation=0.01, azimuth=0, k=1)
    scene = scene_from_mesh(CAMERA, [lamp], floor_and_wall(height, far), reflectance=MATTE)
    scene = replace(scene, bounces=1, reflectance=replace(scene.reflectance, white_level=160.0))
    x, y = np.array([1.0, 4.0, 15.0, 40.0]), np.random.default_rng(1).uniform(-3.0, 3.0, 300)
    surface = floor_points([(a, b) for a in x for b in y], [(0, 0, 1)] * (len(x) * len(y)))
    found = part_light(scene).diffuse(surface)
    added = (found[0, 0] + found[2, 0]).reshape(len(x), len(y))
    form_factor = 0.5 * (1.0 - x / np.hypot(x, height))
    expected = 100.0 / 160.0 * 100.0 * form_factor
    np.testing.assert_allclose(added.mean(axis=1), expected, rtol=0.015)
    assert np.all(added.std(axis=1) < 0.4 + 0.03 * expected)


def test_integrating_sphere_adds_the_albedo_with_each_bounce():
    """A lamp in the middle gives level R_d all over; each bounce adds albedo times what was there before."""
    inside = sphere(20.0, rows=64)
    inside = TriangleMesh(inside.vertices, inside.faces[:, ::-1].copy(), -inside.normals)
    lamp = ref.Light(distance=1e-3, elevation=60, azimuth=0, size=(1e-3, 1e-3), k=1)
    scene = scene_from_mesh(CAMERA, [lamp], inside, reflectance=MATTE)
    reflectance = replace(scene.reflectance, white_level=200.0)
    directions = np.array([(0.0, 0.0, -1.0), (0.6, 0.0, 0.8), (0.48, 0.64, -0.6)])
    ones = np.ones(len(directions), bool)
    surface = SurfacePoints(20.0 * 0.999 * directions, -directions, -directions, -directions, ones)
    for bounces, expected in ((1, 50.0), (2, 50.0 + 25.0), (3, 50.0 + 25.0 + 12.5)):
        found = part_light(replace(scene, bounces=bounces, reflectance=reflectance)).diffuse(surface)
        np.testing.assert_allclose(found[0, 0] + found[2, 0], expected, rtol=5e-3)


@pytest.mark.parametrize("reflectance", [MATTE, SATIN, BRUSHED], ids=["matte", "satin", "brushed"])
def test_a_convex_part_in_white_surroundings_shows_its_albedo(reflectance):
    lamp = ref.Light(distance=300, elevation=60, azimuth=0, k=1, gain=0.5)
    scene = scene_from_mesh(CAMERA, [lamp], sphere(15.0), reflectance=reflectance)
    scene = replace(scene, mesh=replace(scene.mesh, brushing=(StraightBrushing(np.array([1.0, 0.5, 0.0])),)))
    lit = replace(scene, environment=80.0)
    added = levels(lit) - levels(scene)
    assert added[25:35, 35:45].mean() == pytest.approx(
        DEFAULT_ALBEDO * 80.0 * 0.5, rel=0.01
    )  # proportional to the light's gain


def test_a_convex_part_in_a_dark_box_has_no_bounce():
    scene = scene_from_mesh(CAMERA, [ref.Light(distance=300, elevation=60, azimuth=0, k=2)], sphere(15.0))
    assert np.array_equal(levels(scene), levels(replace(scene, bounces=1)))


def test_a_narrow_lobe_mirrors_the_other_surface():
    lamp = ref.Light(distance=1e6, elevation=0.01, azimuth=0, k=1)
    reflectance = {"R_d": 20.0, "R_s": 2e6, "sigma": 0.003}
    scene = replace(scene_from_mesh(CAMERA, [lamp], floor_and_wall(30.0), reflectance=reflectance), bounces=1)
    # seen from +X: mirrored towards the wall, 10 mm high, in a view that its own lobe is far from
    surface = floor_points([(10.0, 3.0), (10.0, 0.0)], [(1, 0.4, 1), (1, 0.4, 0.1)])
    found = part_light(scene).specular(surface)[0, 0]
    sigma, white = 0.003, white_level(scene.reflectance)
    mirrored = 8.0 * sigma**2 * (1.0 - 4.0 / 3.0 * sigma**2) * 2e6 / white
    np.testing.assert_allclose(found, mirrored * 20.0, rtol=2e-3)


def area_sum(scene, surface, *, height, half, step, white=None):
    """One bounce as a sum over cells of the wall, in plain NumPy: diffuse and specular level of each floor point."""
    r = scene.reflectance
    white = white or white_level(r)
    y = np.arange(-half + step / 2, half, step)
    z = np.arange(step / 2, height, step)
    q = np.stack([np.zeros((len(z), len(y))), *np.broadcast_arrays(y[None], z[:, None])], axis=-1).reshape(-1, 3)
    (light,) = scene.lights
    lamps, normal, up = panel_grid(light, light.points), np.array([1.0, 0, 0]), np.array([0.0, 0, 1.0])

    def level(n, n_dot_l, to_light, view):
        return r.R_d * n_dot_l, r.R_s * ref.specular(n, view, to_light, r)

    found = []
    for point, view in zip(surface.points, surface.views, strict=True):
        way = q - point
        distance = np.linalg.norm(way, axis=1)
        way /= distance[:, None]
        seen = np.zeros(len(q))
        for lamp in lamps:
            to_lamp = lamp - q
            to_lamp /= np.linalg.norm(to_lamp, axis=1)[:, None]
            seen += sum(level(normal, np.maximum(to_lamp @ normal, 0.0), to_lamp, -way)) / len(lamps)
        solid_angle = step**2 * np.maximum(-way @ normal, 0.0) / distance**2
        parts = level(up, way @ up, way, np.broadcast_to(view, way.shape))
        found.append([np.sum(part * seen * solid_angle) / (math.pi * white) for part in parts])
    return np.array(found).T


def test_highlight_in_a_highlight_against_a_sum_over_the_other_surface():
    height, half = 20.0, 20.0
    lamp = ref.Light(distance=330, elevation=50, azimuth=5, size=(60, 60), k=3)
    scene = scene_from_mesh(CAMERA, [lamp], floor_and_wall(height, half), reflectance=SATIN)
    scene = replace(scene, bounces=1)
    # seen from where the floor mirrors the wall, and the wall mirrors the lamp, or nearly so
    (light,) = scene.lights
    direction = light.centre / np.linalg.norm(light.centre)
    views = [direction + np.array([0, 0, 0.1 * k]) for k in (-1, 0, 1, 2)]
    surface = floor_points([(6.0, 0.0), (8.0, 1.0), (10.0, -1.0), (7.0, 2.0)], views)
    diffuse, specular = area_sum(scene, surface, height=height, half=half, step=0.1)
    own = part_light(scene)
    assert specular.max() > 200.0
    found = own.specular(surface)[0, 0]
    np.testing.assert_allclose(found, specular, rtol=0.03, atol=0.5)
    # rays of diffuse points meet diffuse light; what the wall's lobe throws is `test_caustics_…`
    added, matte = own.diffuse(surface), replace(scene, reflectance=replace(scene.reflectance, R_s=0.0))
    even = area_sum(matte, surface, height=height, half=half, step=0.1, white=white_level(scene.reflectance))[0]
    np.testing.assert_allclose(added[0, 0] + added[2, 0], even, rtol=0.05, atol=0.15)
    assert np.all(diffuse > 10.0 * even)


def test_caustics_against_a_sum_over_the_surface_that_throws_them():
    """What the wall's lobe throws on squares of the floor, and how images show it."""
    height, half = 20.0, 20.0
    lamp = ref.Light(distance=330, elevation=50, azimuth=5, size=(60, 60), k=3)
    scene = scene_from_mesh(CAMERA, [lamp], floor_and_wall(height, half), reflectance=SATIN)
    scene = replace(scene, bounces=1)
    matte = replace(scene, reflectance=replace(scene.reflectance, R_s=0.0))
    (landed,) = landed_light(part_light(scene), scene.camera.position, 1 << 17)
    floor = landed.points[:, 2] < 1e-6
    for x0, y0 in ((2.0, -2.0), (6.0, 0.0), (10.0, 5.0)):
        side, cells = 4.0, (np.arange(4) + 0.5) / 4
        places = [(x0 + side * a, y0 + side * b) for a in cells for b in cells]
        surface = floor_points(places, [(0, 0, 1)] * len(places))
        sums = [
            area_sum(one, surface, height=height, half=half, step=0.2, white=white_level(scene.reflectance))[0].mean()
            for one in (scene, matte)
        ]
        x, y = landed.points[:, 0] - x0, landed.points[:, 1] - y0
        within = floor & (x > 0) & (x < side) & (y > 0) & (y < side)
        found = landed.light[within].sum() / side**2
        assert sums[0] - sums[1] > 2.0
        assert found == pytest.approx(sums[0] - sums[1], rel=0.02), (x0, y0)
    # images show all that lands in them
    camera = view_from_part(scene, scene.postures[0]).camera
    columns, rows = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
    grid = [a.ravel() for a in np.meshgrid(columns, rows)]
    hits, seen = trace_samples(cast_rays_at(scene), scene.mesh, camera, *grid)
    at = np.full((len(rows), len(columns)), -1, np.int32)
    at.ravel()[hits.ray] = np.arange(len(seen), dtype=np.int32)
    (levels_shown,) = caustic_levels([landed], camera, seen, at, (0.5, 0.5), 1.0)
    areas, _ = footprints(camera, seen, at, (0.5, 0.5), 1.0)
    assert areas[seen.points[:, 2] < 1e-6].sum() == pytest.approx(half * 2 * half, rel=0.05)
    assert np.sum(levels_shown * areas) == pytest.approx(landed.light[floor].sum(), rel=0.05)


def small_spout(**options):
    scene = build_scene(
        CONFIGS / "rigs" / "four-panel.yaml", CONFIGS / "parts" / "spout.yaml", lights=["light1"], **options
    )
    camera = replace(scene.camera, width=96, height=72, pixel_size=50 / 3 * scene.camera.pixel_size)
    return replace(scene, camera=camera, postures=scene.postures[:1])


@pytest.mark.parametrize("size", [60.0, 300.0])
@pytest.mark.parametrize("points", ["auto", 36])
@pytest.mark.parametrize(
    "own", [Reflectance(**MATTE), Reflectance(R_d=0.0, R_s=1000.0, sigma=0.1, model=SpecularModel(name="ggx"))]
)
def test_a_panel_across_the_horizon_of_met_points_lights_them_as_in_images(size, points, own):
    """Half of the panel is below the plane of the points, where it is left out once."""
    mesh = rectangle((0, -20, 0), (40, 0, 0), (0, 40, 0))
    caster = RayCaster(mesh.vertices, mesh.faces)
    rng = np.random.default_rng(0)
    places = np.column_stack([rng.uniform(5.0, 15.0, 4000), rng.uniform(-5.0, 5.0, 4000)])
    surface = floor_points(places, np.tile([-0.8, 0.0, 0.6], (4000, 1)))
    light = place_light(
        name="panel", distance=330.0, elevation=math.radians(3.0), azimuth=0.0, size=(size, size), points=points
    )
    expected = shade_isolated(surface, [light], reflectances=[own], caster=caster, shadows=True).mean()
    mirrored = [_mirrored_light(light, own.sigma, caster)]
    found = isolated_levels(surface, mirrored, [own], caster, penumbrae=False).mean()
    np.testing.assert_allclose(found, expected, rtol=0.01)


def test_images_are_the_same_with_any_number_of_threads_and_have_their_layers():
    scene = small_spout(bounces=1)
    images = [next(iter(render(scene, threads=threads, layers=True))).lights[0] for threads in (1, 3)]
    assert np.array_equal(images[0].level, images[1].level)
    np.testing.assert_allclose(images[0].diffuse + images[0].specular, images[0].level, rtol=1e-5, atol=1e-3)


def test_interpolation_between_pixels_keeps_the_bounce(monkeypatch):
    """Every pixel worked out, beside squares of them."""
    from lightopt.rendering import _bounced_images

    scene = small_spout()
    direct = levels(scene)
    bounce = levels(replace(scene, bounces=1)) - direct
    monkeypatch.setattr(_bounced_images, "SIDES", (16,))
    monkeypatch.setattr(_bounced_images, "_smooth_squares", lambda corners, *_: np.zeros(len(corners), bool))
    monkeypatch.setattr(_bounced_images, "_from_neighbours", lambda *_: None)
    each = levels(replace(scene, bounces=1)) - direct
    assert bounce.mean() == pytest.approx(each.mean(), rel=0.02)
    assert each.mean() > 0.5


@pytest.mark.parametrize("of_inspection", [False, True])
def test_a_part_that_reflects_more_than_it_gets_is_refused(of_inspection):
    part = PartConfig.model_validate(
        {
            "format": "lightopt-part/1",
            "name": "x",
            "mesh": {"file": str(CONFIGS / "parts" / "spout.stl"), "units": "mm"},
            "reflectance": {"R_d": 45, "R_s": 12500, "sigma_rad": 0.0475, "white_level": 100},
            "inspection": {"bounces": int(of_inspection)},
        }
    )
    with pytest.raises(InputError, match=r"white_level: expected at least 269.* found 100: .*more light than it gets"):
        build_scene(CONFIGS / "rigs" / "four-panel.yaml", part, bounces=int(not of_inspection))


@pytest.mark.parametrize("sigma", [0.003, 0.0475])
def test_albedo_of_a_narrow_lobe(sigma):
    reflectance = Reflectance(R_d=0.0, R_s=1000.0, sigma=sigma)
    expected = 8000.0 * sigma**2 * (1.0 - 4.0 / 3.0 * sigma**2) / DEFAULT_ALBEDO
    assert white_level(reflectance) == pytest.approx(expected, rel=1e-4)
    assert white_level(replace(reflectance, white_level=50.0)) == 50.0


def test_the_virtual_bench_has_the_bounces_of_its_file():
    rig = load_rig(CONFIGS / "rigs" / "four-panel.yaml")
    truth = bench_truth(rig.model_copy(update={"virtual_bench": VirtualBenchConfig(bounces=1)}))
    scene = small_spout()
    frames = [
        BenchOptics(scene, one).frame({"light1": 1.0}, scene.postures[0], exposure=1.0) for one in (BenchTruth(), truth)
    ]
    assert frames[1].mean() > frames[0].mean() + 1.0


@pytest.mark.nightly
@pytest.mark.parametrize("environment", [0.0, 5.0])
def test_a_small_lens_shows_the_light_that_a_pinhole_shows(environment):
    """What bounces add, and the surroundings, through a lens of a hundredth of a millimetre."""
    lamp = ref.Light(distance=330, elevation=40, azimuth=0, k=2)
    scene = scene_from_mesh(CAMERA, [lamp], floor_and_wall(15.0, 20.0), reflectance=SATIN)
    scene = replace(scene, bounces=1, environment=environment)
    caster = cast_rays_at(scene)
    lens = replace(scene, camera=replace(scene.camera, lens=Lens(aperture=0.01, focus=550.0)))
    (pinhole,), (through,) = (
        render_posture(one, one.postures[0], caster=caster, supersample=3).lights for one in (scene, lens)
    )
    bare = render_posture(replace(scene, bounces=0, environment=0.0), scene.postures[0], caster=caster).lights[0]
    added, seen = (image.level.sum() - bare.level.sum() for image in (pinhole, through))
    assert added > 0.01 * bare.level.sum()
    assert seen == pytest.approx(added, rel=0.1)


@pytest.mark.parametrize("bright", ["floor", "wall"])
def test_regions_of_a_part_light_each_other_by_their_own_reflectances(bright):
    """Of a matt floor and a matt wall, one reflects twice as much: the floor gets, or shows, twice the wall's light."""
    lamp = ref.Light(distance=330, elevation=50, azimuth=5, size=(60, 60), k=3)
    scene = scene_from_mesh(CAMERA, [lamp], floor_and_wall(20.0, 20.0), reflectance=SATIN)
    matt = replace(scene.reflectance, R_s=0.0, white_level=200.0)
    scene = replace(scene, bounces=1, reflectance=matt)
    on_floor = np.abs(scene.mesh.vertices[scene.mesh.faces][..., 2]).max(axis=1) < 1e-6
    mesh = replace(scene.mesh, material=(on_floor == (bright == "floor")).astype(np.uint8))
    region = PartRegion(name=bright, reflectance=replace(matt, R_d=2.0 * matt.R_d))
    mixed = replace(scene, mesh=mesh, regions=(region,))
    surface = floor_points([(2.0, 0.0), (5.0, 3.0), (9.0, -4.0)], [(0, 0, 1)] * 3)
    plain = part_light(scene).diffuse(surface)[0, 0]
    own = np.full(3, 1 if bright == "floor" else 0, np.uint8)
    found = part_light(mixed).diffuse(replace(surface, material=own))[0, 0]
    assert np.all(plain > 0.3)
    assert np.allclose(found, 2.0 * plain, rtol=0.03)


def test_caustics_are_of_the_region_that_throws_and_of_the_one_that_shows():
    """A mirroring wall over a matt floor throws what a wall and a floor of both do; the floor throws nothing."""
    lamp = ref.Light(distance=330, elevation=50, azimuth=5, size=(60, 60), k=3)
    scene = replace(scene_from_mesh(CAMERA, [lamp], floor_and_wall(20.0, 20.0), reflectance=SATIN), bounces=1)
    both = replace(scene.reflectance, white_level=400.0)
    scene = replace(scene, reflectance=both)
    on_floor = np.abs(scene.mesh.vertices[scene.mesh.faces][..., 2]).max(axis=1) < 1e-6
    region = PartRegion(name="floor", reflectance=replace(both, R_s=0.0))
    mixed = replace(
        scene,
        mesh=replace(scene.mesh, material=on_floor.astype(np.uint8)),
        reflectance=replace(both, R_d=0.0),
        regions=(region,),
    )
    sums = []
    for one in (scene, mixed):
        (landed,) = landed_light(part_light(one), scene.camera.position, 1 << 16)
        floor = landed.points[:, 2] < 1e-6
        sums.append((landed.light[floor].sum(), landed.light[~floor].sum()))
    assert sums[1][0] == pytest.approx(sums[0][0], rel=0.03)
    assert sums[0][1] > 0.0
    assert sums[1][1] == 0.0


@pytest.mark.nightly
def test_a_region_of_the_same_reflectance_shows_the_same_bounce():
    """Half of the spout as a region: interpolation ends at its border, and the light is the same."""
    scene = small_spout(bounces=1)
    direct = levels(replace(scene, bounces=0))
    middle = scene.mesh.vertices[scene.mesh.faces].mean(axis=1)[:, 1]
    mesh = replace(scene.mesh, material=(middle > 0.0).astype(np.uint8))
    halves = replace(scene, mesh=mesh, regions=(PartRegion(name="half", reflectance=scene.reflectance),))
    whole, parts = (levels(one) - direct for one in (scene, halves))
    assert whole.mean() > 0.1
    assert parts.mean() == pytest.approx(whole.mean(), rel=0.01)
    assert np.mean(np.abs(parts - whole)) < 0.1 * whole.mean()


def test_maps_of_blockers_change_no_bounce(monkeypatch):
    """Shadow rays of the points that rays meet are proven free as those of images are, with the same levels."""
    scene = build_scene(CONFIGS / "rigs" / "four-panel.yaml", CONFIGS / "parts" / "spout.yaml", points="auto")
    camera = replace(
        scene.camera, width=320, height=240, pixel_size=5.0 * scene.camera.pixel_size, principal_point=None
    )
    scene = replace(scene, camera=camera, bounces=1, lights=scene.lights[:1])
    shown, free = [], []
    for maps in (True, False):
        if not maps:
            monkeypatch.setattr(BlockerMaps, "make", lambda *_args, **_kwargs: None)
        caster = cast_rays_at(scene)
        shown.append(render_posture(scene, scene.postures[0], caster=caster).lights[0].level)
        free.append(caster.rays_free)
    np.testing.assert_array_equal(*shown)
    assert free[0] > 5 * shown[0].size > free[1] == 0
