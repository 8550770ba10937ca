"""Work in blocks of rows and tiles gives what the whole image gives, whatever the number of threads."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage, special

from lightopt import build_scene, load_part, load_rig
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import read_observations
from lightopt.images import read_image_set
from lightopt.inspection import predict
from lightopt.inspection._image_blocks import filter_tile, gaussian_taps
from lightopt.inspection.detection._coverage import REFERENCE_DISC_PX, SurfaceState, measure_coverage
from lightopt.inspection.detection._deviation import deviations
from lightopt.inspection.detection._residual_score import disc_gain, score_deviations
from lightopt.inspection.prediction._posture_view import posture_view
from lightopt.rendering import RenderOptions, cast_rays_at, render_image_set

FLAT = Posture(0.0, 0.0)
LIGHTS = ("light1", "light3")


@pytest.fixture(scope="module")
def shown(shared_bench, tmp_path_factory):
    """Scene, images and prediction of a good part, and the rig and part."""
    rig, part = load_rig(shared_bench.rig), load_part(shared_bench.part)
    folder = tmp_path_factory.mktemp("blocks") / "set"
    options = RenderOptions(noise=1, patch_budget=500, postures=(FLAT,), lights=LIGHTS)
    render_image_set(rig, part, folder, options=options)
    scene = build_scene(rig, part, postures=(FLAT,), lights=LIGHTS, defects=False)
    images = read_observations(read_image_set(folder), rig, part)
    return scene, images, predict(scene, FLAT, cast_rays_at(scene), lights=LIGHTS)


def seen(shown, threads):
    scene, images, prediction = shown
    view = posture_view(scene, images, prediction, where="test", threads=threads)
    found = deviations(view, threads=threads)
    return view, found, score_deviations(found, min_images=2, threads=threads)


def test_the_number_of_threads_changes_nothing(shown):
    (view, found, score), (view_3, found_3, score_3) = seen(shown, 1), seen(shown, 3)
    assert view.level.max() > 100
    for name in ("level", "predicted", "specular", "deviation", "slack", "limit", "saturated"):
        assert np.array_equal(getattr(view, name), getattr(view_3, name)), name
    for name in ("z", "scale", "usable", "lit"):
        assert np.array_equal(getattr(found, name), getattr(found_3, name)), name
    assert np.array_equal(score, score_3)
    assert score.max() > 1


def plain_coverage(view, found, min_images, high):
    """State and least contrast of each pixel, in plain NumPy."""
    part = view.part & (view.prediction.area > 0)
    lit, usable = found.lit.sum(axis=0), found.usable.sum(axis=0)
    full = (view.saturated & (view.predicted >= view.limit)).any(axis=0)
    state = np.zeros(part.shape, np.uint8)
    for where, name in (
        (part, SurfaceState.EDGE),
        (part & view.prediction.grazing, SurfaceState.GRAZING),
        (part & view.clean, SurfaceState.SHADOW),
        (part & view.clean & full, SurfaceState.SATURATED),
        (part & (usable > 0), SurfaceState.GLINTS),
        (part & (lit > 0), SurfaceState.FEWER),
        (part & (lit >= min_images), SurfaceState.INSPECTED),
    ):
        state[where] = name
    k = np.clip(lit, 1, min_images)
    each = (10.0**-high / special.binom(np.maximum(usable, k), k)) ** (1.0 / k)
    needed = special.ndtri(0.5 ** (1.0 / k)) - special.ndtri(0.5 * each)
    share = np.where(found.lit, found.scale / np.maximum(view.predicted, 1e-6), np.inf)
    weakest = np.take_along_axis(np.sort(share, axis=0), k[None] - 1, axis=0)[0]
    least = needed / disc_gain(REFERENCE_DISC_PX) * weakest
    return state, np.where(state >= SurfaceState.FEWER, least, np.inf)


@pytest.mark.parametrize("min_images", [1, 2])
@pytest.mark.parametrize("threads", [1, 3])
def test_coverage_is_that_of_plain_numpy(shown, threads, min_images):
    view, found, _ = seen(shown, 2)
    state, least = plain_coverage(view, found, min_images, 6.0)
    blocks = measure_coverage(view, found, min_images=min_images, high=6.0, threads=threads)
    assert np.array_equal(blocks.state, state)
    assert np.allclose(blocks.least_contrast, least, rtol=1e-6)
    assert blocks.inspected > 0.1 * blocks.seen > 0.0
    for contrast, area in blocks.sensitivity.items():
        assert area == pytest.approx(view.prediction.area[least <= contrast].sum(dtype=float), rel=1e-9)
    assert blocks.seen == pytest.approx(view.prediction.area[state > SurfaceState.GRAZING].sum(dtype=float), rel=1e-9)


@pytest.mark.parametrize("kind", [np.float32, np.bool_])
@pytest.mark.parametrize("box", [(0, 0, 64, 50), (10, 7, 5, 40), (50, 30, 14, 20)])
@pytest.mark.parametrize("most", [np.inf, 1.0])
def test_a_tile_is_that_part_of_the_filtered_image(kind, box, most):
    top, left, rows, columns = box
    image = (np.random.default_rng(3).random((64, 50)) * 4 - 1).astype(kind)
    taps = gaussian_taps(2.0)
    result = np.full((rows, columns), np.nan, np.float32)
    filter_tile(image, taps, top, left, most, result)
    expected = np.clip(image.astype(np.float64), -most, most)
    for axis in (0, 1):
        expected = ndimage.correlate1d(expected, taps.astype(np.float64), axis=axis, mode="constant")
    assert np.abs(result - expected[top : top + rows, left : left + columns]).max() < 1e-5
