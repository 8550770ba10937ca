"""The surface over all postures: each place counts once, by the posture that shows it best."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lightopt import build_scene
from lightopt.core.transforms import Posture
from lightopt.geometry import face_areas
from lightopt.inspection import PostureCoverage
from lightopt.inspection.detection._coverage import SurfaceState, surface_coverage
from lightopt.inspection.prediction._predict import map_surface
from lightopt.rendering import cast_rays_at, trace_pixels
from lightopt.rendering._surface import GRAZING_COSINE

FLAT, TURN, TILTED = Posture(0.0, 0.0), Posture(0.0, 360.0), Posture(-40.0, 170.0)
CONTRASTS = (0.05, 0.1, 0.2, 0.4)


@pytest.fixture(scope="module")
def scene(shared_bench):
    return build_scene(shared_bench.rig, shared_bench.part, postures=(FLAT, TURN, TILTED), defects=False)


def coverage(scene, state, least):
    """Of a posture, its pixels in arrays; areas are not looked at where there are several."""
    none = dict.fromkeys(CONTRASTS, 0.0)
    return PostureCoverage(
        seen=1.0, inspected=1.0, saturated=0.0, shadow=0.0, edge=0.0, sensitivity=none,
        state=np.full((scene.camera.height, scene.camera.width), state, np.uint8),
        least_contrast=np.full((scene.camera.height, scene.camera.width), least, np.float32),
    )  # fmt: skip


def over(scene, *postures):
    """Of postures, each with how far it got and what contrast it finds."""
    here = replace(scene, postures=tuple(posture for posture, _, _ in postures))
    surface = map_surface(here, cast_rays_at(here))
    return surface_coverage(
        here, [(posture, coverage(here, state, least)) for posture, state, least in postures], surface
    )


def test_the_same_view_twice_counts_once(scene):
    once = over(scene, (FLAT, SurfaceState.INSPECTED, 0.1), (TURN, SurfaceState.INSPECTED, 0.1))
    assert once.area == pytest.approx(float(face_areas(scene.mesh).sum()))
    # walls are seen at a grazing angle: in no share, and said beside them
    assert once.inspected == pytest.approx(once.seen)
    assert once.edge == 0.0
    assert 0.02 * once.seen < once.grazing < 0.5 * once.seen
    assert once.as_dict()["left_out"] == pytest.approx(once.grazing / (once.seen + once.grazing), abs=1e-5)
    assert once.share == pytest.approx(once.inspected / once.seen)


def test_a_patch_has_what_the_pixel_has_that_sees_it(scene):
    pixels = trace_pixels(scene, FLAT, cast_rays_at(scene))
    depth = (pixels.surface.points - pixels.view.camera.position) @ pixels.view.camera.forward
    side = depth * scene.camera.pixel_size / scene.camera.image_distance
    cosine = np.einsum("ij,ij->i", pixels.surface.facets, pixels.surface.views)
    steep = cosine > GRAZING_COSINE
    here = replace(scene, postures=(FLAT, TURN))
    own = coverage(scene, SurfaceState.EDGE, np.inf)
    own.state[pixels.row[steep], pixels.column[steep]] = SurfaceState.INSPECTED
    surface = map_surface(here, cast_rays_at(here))
    found = surface_coverage(here, [(FLAT, own), (TURN, own)], surface)
    assert found.inspected == pytest.approx(np.sum(side[steep] ** 2 / cosine[steep]), rel=0.05)
    assert found.edge == pytest.approx(found.seen - found.inspected)


def test_several_postures_show_more_and_no_place_twice(scene):
    flat = over(scene, (FLAT, SurfaceState.INSPECTED, 0.1), (TURN, SurfaceState.INSPECTED, 0.1))
    tilted = over(scene, (TILTED, SurfaceState.INSPECTED, 0.1), (TILTED, SurfaceState.INSPECTED, 0.1))
    both = over(scene, (FLAT, SurfaceState.INSPECTED, 0.1), (TILTED, SurfaceState.INSPECTED, 0.1))
    for name in ("seen", "inspected"):
        one, other, union = (getattr(found, name) for found in (flat, tilted, both))
        assert max(one, other) + 1.0 < union < one + other - 1.0
    assert both.seen < both.area


def test_the_furthest_counts_and_the_rest_has_its_reason(scene):
    flat = over(scene, (FLAT, SurfaceState.INSPECTED, 0.1), (TURN, SurfaceState.INSPECTED, 0.1)).inspected
    found = over(scene, (FLAT, SurfaceState.INSPECTED, 0.3), (TILTED, SurfaceState.SATURATED, np.inf))
    # each map has patches of its own
    assert found.inspected == pytest.approx(flat, rel=5e-3)
    assert found.saturated > 1.0
    assert found.saturated + found.edge == pytest.approx(found.seen - found.inspected)
    assert found.shadow == 0.0
    assert found.sensitivity == pytest.approx({0.05: 0.0, 0.1: 0.0, 0.2: 0.0, 0.4: found.inspected})
    better = over(scene, (FLAT, SurfaceState.INSPECTED, 0.3), (TURN, SurfaceState.INSPECTED, 0.07))
    assert better.sensitivity == pytest.approx({0.05: 0.0, 0.1: flat, 0.2: flat, 0.4: flat})
    # a patch that the camera sees beside the last pixel of the part is at its edge
    beside = over(scene, (FLAT, SurfaceState.NO_PART, np.inf), (TILTED, SurfaceState.SHADOW, np.inf))
    assert beside.edge + beside.shadow == pytest.approx(beside.seen)
    assert min(beside.edge, beside.shadow) > 1.0
    reported = beside.as_dict()
    assert reported["edge"] + reported["shadow"] == pytest.approx(1.0, abs=1e-4)


def test_what_a_posture_without_images_shows_is_missing(scene):
    here = replace(scene, postures=(FLAT, TILTED))
    surface = map_surface(here, cast_rays_at(here))

    def one(state):
        return surface_coverage(here, [(FLAT, coverage(scene, state, 0.1))], surface)

    judged, edges, full = one(SurfaceState.INSPECTED), one(SurfaceState.EDGE), one(SurfaceState.SATURATED)
    both = over(scene, (FLAT, SurfaceState.INSPECTED, 0.1), (TILTED, SurfaceState.INSPECTED, 0.1))
    for found in (judged, edges, full):
        assert found.seen == pytest.approx(both.seen)
        rest = found.inspected + found.saturated + found.shadow + found.edge + found.missing
        assert rest == pytest.approx(found.seen)
    assert judged.inspected < both.inspected - 1.0
    assert judged.missing == pytest.approx(both.inspected - judged.inspected)
    assert judged.as_dict()["missing"] == pytest.approx(judged.missing / both.seen, abs=1e-4)
    # images that show a place at an edge at most leave it to those that there are none of; saturated ones do not
    assert edges.missing > judged.missing + 1.0
    assert full.missing == pytest.approx(judged.missing)
    assert full.saturated == pytest.approx(judged.inspected)


def test_a_single_posture_tells_by_its_own_pixels(scene):
    own = replace(
        coverage(scene, SurfaceState.EDGE, np.inf), seen=8.0, inspected=5.0, saturated=1.0, shadow=1.5, edge=0.5
    )
    found = surface_coverage(scene, [(FLAT, own)], None)
    assert (found.seen, found.inspected, found.saturated, found.shadow, found.edge) == (8.0, 5.0, 1.0, 1.5, 0.5)
