"""`points: auto` against brute force: the lobe and the shadows integrated over the panel with 64 × 64 nodes or more.

Expected: within 0.1 level or 0.1 % on 99.9 % of the pixels (saturated in both counts as agreeing), within 0.2 level +
0.1 % on every unsaturated pixel, and the saturated area within 1 %.

The nodes are those of a Gauss–Legendre product rule. An equally spaced 64 × 64 grid is no measure of this: at σ = 0.003
on the cap below it is itself off by up to 0.96 level, and by more than 0.1 level on 1.3 % of the unsaturated pixels,
where the Gauss–Legendre rules of 64 and of 96 nodes a side agree to 1e-11.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import reference as ref
import trimesh
from worlds import (
    BOX_CORNERS,
    PARTS,
    box,
    cap,
    corners,
    levels,
    merged,
    plane,
    scene_from_files,
    scene_from_mesh,
    sphere,
)

import lightopt.rendering._images as blocks
from lightopt.geometry import TriangleMesh
from lightopt.optics import Reflectance, SpecularModel

UNIT = {"R_d": 1.0, "R_s": 1.0}
SIGMAS = [0.003, 0.0475, 0.15]
# by σ: an R_s whose highlight is at most about saturated, and one whose highlight is overexposed
DIM = {0.003: 2.5e4, 0.0475: 250.0, 0.15: 150.0}
BRIGHT = {0.003: 1e5, 0.0475: 12500.0, 0.15: 800.0}


def agree(image, expected):
    """Check an image's lit pixels (N,) and print how far off they are."""
    unsaturated = expected < 255
    error = np.where(unsaturated, np.abs(image - expected), 0)
    saturated, found = np.count_nonzero(~unsaturated), np.count_nonzero(image >= 255)
    far = np.mean(error > np.maximum(0.1, 0.001 * expected))
    print(f"max {error.max():.4f}  over 0.1 level {far:.2%}  saturated {found} of {saturated}")
    assert np.ptp(expected) > 5, "a picture of nothing would agree as well"
    assert far <= 0.001
    assert np.max(error - 0.001 * expected) <= 0.2
    assert abs(found - saturated) <= 0.01 * saturated


def sample(pixels, most):
    """So many of the pixels, drawn at random but the same in every run; None: all."""
    if most is None or most >= len(pixels):
        return pixels
    return np.sort(np.random.default_rng(5).choice(pixels, most, replace=False))


def sampled(most):
    """Parametrize a test with a sample of pixels, and with all pixels in the nightly tier."""
    return pytest.mark.parametrize(
        "most", [pytest.param(most, id="sample"), pytest.param(None, id="all", marks=pytest.mark.nightly)]
    )


@pytest.mark.parametrize(
    ("sigma", "real"),
    [
        pytest.param(sigma, real, marks=() if real == (sigma == 0.003) else pytest.mark.nightly)
        for sigma in SIGMAS
        for real in (False, True)
    ],
)
@sampled(1200)
def test_convex_part(sigma, real, most):
    camera = ref.Camera(width=60, height=45, pixel_um=85)
    light = ref.Light(
        elevation=75,
        azimuth=60,
        size=(60, 45),
        gain=1.5,
        falloff="inverse_square" if real else "none",
        emission=1.3 if real else 0.0,
    )
    mesh = cap()
    hits = ref.trace(camera, *corners(mesh))
    lit = sample(np.flatnonzero(hits.front), most)
    unit = ref.panel_radiance(hits[lit], light, **UNIT, sigma=sigma)
    for R_s in (DIM[sigma], BRIGHT[sigma]):  # images are linear in R_s: one integral serves both
        shine = {"R_d": 45.0, "R_s": R_s, "sigma": sigma}
        image = levels(scene_from_mesh(camera, [light], mesh, points="auto", reflectance=shine)).ravel()[lit]
        expected = 45.0 * unit[0] + R_s * unit[1]
        agree(image, expected)
    assert np.count_nonzero(expected >= 255) > (70 if most is None else 30)


@pytest.mark.parametrize("model", ["torrance-sparrow", "ggx"])
def test_terminator_of_a_faceted_ball(model):
    """Faces hide what is below their planes, the interpolated normals what is below theirs; nothing else is in the way.

    Expected: within 0.002 level wherever either plane crosses the panel.
    """
    camera = ref.Camera(width=120, height=90, pixel_um=43)
    light = ref.Light(elevation=20, azimuth=50, size=(90, 60))
    mesh = sphere(18.0, rows=24, centre=(0.31, 0.17, 0.0))  # no pixel exactly on an edge
    own = Reflectance(R_d=45.0, R_s=3000.0, sigma=0.05, model=SpecularModel(name=model))
    hits = ref.trace(camera, *corners(mesh))
    u, v = np.array([-0.5, -0.5, 0.5, 0.5]), np.array([-0.5, 0.5, -0.5, 0.5])
    places = light.at(u, v)
    crossed = np.zeros(len(hits.front), np.bool_)
    for normals in (hits.normal, hits.geometric):
        above = np.stack([np.sum((place - hits.point) * normals, axis=1) > 0.0 for place in places])
        crossed |= above.any(axis=0) & ~above.all(axis=0)
    at = sample(np.flatnonzero(hits.front & crossed), 150)
    unit = {**UNIT, "lobe": partial(ref.specular, reflectance=own)}
    diffuse, specular = ref.panel_radiance(hits[at], light, **unit, rule=ref.product_rule(6, cells=60))
    expected = 45.0 * diffuse + 3000.0 * specular
    scene = replace(scene_from_mesh(camera, [light], mesh, points="auto"), reflectance=own)
    error = np.abs(levels(scene).ravel()[at] - expected)
    print(f"{len(at)} pixels up to {expected.max():.1f} level, off by {error.max():.4f} at most")
    assert len(at) > 100
    assert np.ptp(expected) > 2.0
    assert error.max() <= 0.002


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "distance", "real", "shine"),
    [
        ((400, 30), 80, True, {"R_d": 45.0, "R_s": 0.0, "sigma": 0.05}),
        ((200, 200), 150, False, {"R_d": 200.0, "R_s": 0.0, "sigma": 0.05}),
        ((300, 300), 100, True, {"R_d": 45.0, "R_s": 60.0, "sigma": 0.4}),
        ((300, 300), 100, True, {"R_d": 45.0, "R_s": 100.0, "sigma": 0.15}),
    ],
)
@sampled(80)
def test_large_panels_near_the_part(size, distance, real, shine, most):
    """Panels that dip below the horizon of much of a steep cap, and whose fall-off varies more than the lobe does."""
    camera = ref.Camera(width=48, height=36, pixel_um=100)
    light = ref.Light(
        distance=distance,
        elevation=50,
        azimuth=30,
        size=size,
        falloff="inverse_square" if real else "none",
        emission=1.0 if real else 0.0,
    )
    mesh = cap(30.0, half=15.0, cells=60)
    hits = ref.trace(camera, *corners(mesh))
    lit = sample(np.flatnonzero(hits.front), most)
    parts = ref.panel_radiance(hits[lit], light, **shine, rule=ref.product_rule(6, 24))
    image = levels(scene_from_mesh(camera, [light], mesh, points="auto", reflectance=shine)).ravel()[lit]
    agree(image, parts[0] + parts[1])


LOW, HIGH = np.array([-7.0, -4.0, 9.0]), np.array([6.0, 8.0, 14.0])
VIEWS = {
    # where the box's shadow falls beside the highlight of the panel
    "plan": (ref.Camera(width=80, height=60, pixel_um=66), ref.Light(elevation=75, azimuth=60)),
    # light and box are in line: the shadow's edges are along the panel's sides
    "aligned": (ref.Camera(width=80, height=60, pixel_um=66), ref.Light(elevation=60, azimuth=0)),
    # the camera sees the panel mirrored in the plane, and the box's shadow across it
    "mirror": (ref.Camera(width=80, height=60, pixel_um=66, elevation=62), ref.Light(elevation=62, azimuth=90)),
}


# the last one fails unless penumbrae grow beyond the pixels whose coarse rays disagree
BOXES = [("aligned", 0.003), ("mirror", 0.003), ("mirror", 0.0475), ("plan", 0.15)]
"""In every run; all of them in the nightly tier."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("view", "sigma"),
    [
        pytest.param(view, sigma, marks=() if (view, sigma) in BOXES else pytest.mark.nightly)
        for view in VIEWS
        for sigma in SIGMAS
    ],
)
@sampled(1000)
def test_box_over_a_plane(view, sigma, most):
    """The hidden part of the panel is a polygon here, integrated as such: the expected levels are exact."""
    camera, light = VIEWS[view]
    mesh = merged(plane(40), box(LOW, HIGH))
    hits = ref.trace(camera, *corners(mesh))
    lit = sample(np.flatnonzero(hits.front & (hits.face < 2)), most)
    unit = ref.panel_radiance(hits[lit], light, **UNIT, sigma=sigma)
    body = LOW + BOX_CORNERS * (HIGH - LOW)
    nodes = 64 if sigma < 0.01 else 24
    *unit, penumbra = ref.subtract_convex(hits[lit], light, *unit, body, **UNIT, sigma=sigma, n=nodes)
    assert np.count_nonzero(penumbra) > (100 if most is None else 25)
    for R_s in (DIM[sigma], BRIGHT[sigma]):
        shine = {"R_d": 45.0, "R_s": R_s, "sigma": sigma}
        image = levels(scene_from_mesh(camera, [light], mesh, points="auto", reflectance=shine)).ravel()[lit]
        expected = 45.0 * unit[0] + R_s * unit[1]
        agree(image, expected)


BALL, CENTRE = 7.0, np.array([0.0, 2.0, 15.0])


def ball():
    """A finely faceted ball whose outline has the radius of the round one, on average."""
    sphere = trimesh.creation.icosphere(subdivisions=6, radius=BALL)
    edge = np.linalg.norm(np.diff(sphere.vertices[sphere.edges_unique], axis=1), axis=-1).mean()
    return TriangleMesh(sphere.vertices * (1 + edge**2 / (12 * BALL**2)) + CENTRE, sphere.faces, None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("view", "pixels"),
    [("plan", 3), *(pytest.param(view, 30, marks=pytest.mark.nightly) for view in ("plan", "mirror"))],
)
def test_ball_over_a_plane(view, pixels):
    """A curved edge: at some pixels of the penumbra, summed over 640,000 points of the panel behind a round ball."""
    sigma = 0.0475
    camera, light = VIEWS[view]
    mesh = merged(plane(40), ball())
    hits = ref.trace(camera, *corners(merged(plane(40), box(CENTRE - BALL, CENTRE + BALL))))
    on_plane = np.flatnonzero(hits.front & (hits.face < 2))
    rule = ref.equally_spaced(800)
    sources = light.at(*rule[:2])
    rng = np.random.default_rng(2)
    chosen, expected = [], []
    for pixel in rng.permutation(on_plane):
        one = hits[[pixel]]
        towards = sources - one.point
        along = np.clip(((CENTRE - one.point) * towards).sum(1) / (towards**2).sum(1), 0, 1)
        hidden = ((one.point + along[:, None] * towards - CENTRE) ** 2).sum(1) < BALL**2
        if not hidden.any() or hidden.all():
            continue
        terms = ref.point_terms(one, light, sources, **UNIT, sigma=sigma)
        expected.append([light.gain * np.mean(np.where(hidden, 0, term[0])) for term in terms])
        chosen.append(pixel)
        if len(chosen) == pixels:
            break
    unit = np.array(expected).T
    for R_s in (DIM[sigma], BRIGHT[sigma]):
        shine = {"R_d": 45.0, "R_s": R_s, "sigma": sigma}
        image = levels(scene_from_mesh(camera, [light], mesh, points="auto", reflectance=shine)).ravel()[chosen]
        summed = 45.0 * unit[0] + R_s * unit[1]
        off = np.abs(image - summed) / (0.1 + 0.001 * summed)
        print(f"at most {off.max():.2f} of 0.1 level + 0.1 %")
        assert off.max() <= (1.0 if R_s == DIM[sigma] else 1.5)  # the sum's own steps are some 0.3 there


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sigma", "pixels"), [(0.0475, 12), *(pytest.param(sigma, 300, marks=pytest.mark.nightly) for sigma in SIGMAS)]
)
def test_spout(tmp_path, sigma, pixels):
    """A part that shades itself, at some of its pixels; 128 × 128 nodes, each with a shadow ray."""
    coarser = 1 if pixels > 12 else 2
    camera = ref.Camera(width=160 // coarser, height=120 // coarser, pixel_um=40 * coarser)
    light = ref.Light(elevation=45, azimuth=80)
    hits = lit = unit = None
    for R_s in (DIM[sigma], BRIGHT[sigma]):
        shine = {"R_d": 45.0, "R_s": R_s, "sigma": sigma}
        scene = scene_from_files(tmp_path, camera, [light], PARTS / "spout.stl", points="auto", reflectance=shine)
        if unit is None:
            triangles, normals = corners(scene.mesh)
            hits = ref.trace(camera, triangles, normals)
            # half of them where some, but not all, of nine points of the panel are hidden
            nine = ref.render(
                camera, ref.Light(elevation=45, azimuth=80, k=3), triangles, normals, hits=hits, **UNIT, sigma=sigma
            ).shadow.reshape(-1, 9)
            partly = np.flatnonzero(hits.front & nine.any(axis=1) & ~nine.all(axis=1))
            rng = np.random.default_rng(1)
            lit = np.union1d(rng.choice(np.flatnonzero(hits.front), pixels // 2), rng.choice(partly, pixels // 2))
            unit = ref.panel_radiance(
                hits[lit], light, **UNIT, sigma=sigma, triangles=triangles, rule=ref.product_rule(16, 8)
            )
        expected = 45.0 * unit[0] + R_s * unit[1]
        image = levels(scene).ravel()[lit]
        agree(image, expected)


@pytest.mark.parametrize(("points", "most"), [(4, 0.0), ("auto", 0.02)])
def test_blocks_hardly_matter(tmp_path, monkeypatch, points, most):
    """Images may be cut into any blocks of rows: the same with points a panel.

    A penumbra of the converged panel grows within a block only, which leaves less than 0.02 level at its border.
    """
    camera = ref.Camera(width=120, height=90, pixel_um=50)
    scene = scene_from_files(
        tmp_path, camera, [ref.Light(elevation=40, azimuth=80)], PARTS / "spout.stl", points=points
    )
    whole = levels(scene)
    worst = 0.0
    for size in (1, 1000, 7777):
        monkeypatch.setattr(blocks, "BLOCK_SAMPLES", size)
        worst = max(worst, np.max(np.abs(levels(scene) - whole)))
    print(f"largest difference between blocks {worst:.1e} level")
    assert worst <= most


def test_many_points_converge_to_the_panel():
    """On a wide lobe, m points a panel approach `auto` as m grows, with shadows."""
    camera = ref.Camera(width=60, height=45, pixel_um=85)
    mesh = merged(plane(40), box(LOW, HIGH))
    shine = {"R_d": 45.0, "R_s": 150.0, "sigma": 0.15}
    panel = levels(scene_from_mesh(camera, [ref.Light()], mesh, points="auto", reflectance=shine))
    error = [
        np.abs(levels(scene_from_mesh(camera, [ref.Light(k=k)], mesh, reflectance=shine)) - panel).mean()
        for k in (1, 4, 16)
    ]
    assert error[0] > 4 * error[1] > 8 * error[2]
    assert error[2] < 0.05


def test_normalisation_does_not_depend_on_how_the_panel_is_sampled():
    """A matte plane under a distant panel: cosθ_i·R_d for one point, nine points and the converged panel alike."""
    camera = ref.Camera(width=8, height=6, pixel_um=100)
    matte = {"R_d": 80.0, "R_s": 0.0, "sigma": 0.05}
    for k, points in ((1, None), (3, None), (1, "auto")):
        light = ref.Light(distance=1e5, elevation=50, azimuth=10, k=k)
        image = levels(scene_from_mesh(camera, [light], plane(60), points=points, reflectance=matte))
        np.testing.assert_allclose(image, 80 * np.sin(np.deg2rad(50)), rtol=1e-3)
