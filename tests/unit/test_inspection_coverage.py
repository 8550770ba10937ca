"""What a place can show: the contrast that is told is found there, and each pixel is in one class."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from lightopt.inspection import CONTRASTS, SurfaceCoverage
from lightopt.inspection.detection._coverage import SurfaceState, measure_coverage
from lightopt.inspection.detection._deviation import DARK, Deviations
from lightopt.inspection.detection._residual_score import score_deviations

SIDE, STEP = 360, 24
LEVEL, SCALE, HIGH = 100.0, 2.0, 6.5


def discs(rng):
    """A disc of 5 px in each square of the image, its middle anywhere within a pixel."""
    places = SIDE // STEP
    y, x = np.mgrid[:STEP, :STEP] + 0.5 - STEP / 2
    shifts = rng.uniform(-0.5, 0.5, (places, places, 2))
    return np.block([[np.hypot(y - a, x - b) < 2.5 for a, b in row] for row in shifts])


def share_found(z, usable, lit, min_images):
    score = score_deviations(Deviations(z, np.full_like(z, SCALE), usable, lit), min_images=min_images)
    peaks = score.reshape(SIDE // STEP, STEP, SIDE // STEP, STEP).max(axis=(1, 3))
    return float(np.mean(peaks >= HIGH))


def seen(noise, lit):
    """What counts of deviations where only the first images are lit."""
    return np.where(lit | (np.abs(noise) > DARK), noise, np.float32(0.0))


def view_of(predicted, saturated, part, clean, area, grazing):
    """What coverage is measured by of a posture's view; all of it is below saturation but where it is said."""
    return SimpleNamespace(
        part=part, clean=clean, predicted=predicted, saturated=saturated, limit=np.full_like(predicted, 1e3),
        prediction=SimpleNamespace(area=area, grazing=grazing),
    )  # fmt: skip


def least_contrast(found, predicted, min_images):
    """Of a part that fills the image."""
    whole, none = np.ones((SIDE, SIDE), bool), np.zeros((SIDE, SIDE), bool)
    view = view_of(predicted, np.zeros_like(found.lit), whole, whole, whole.astype(np.float32), none)
    return measure_coverage(view, found, min_images=min_images, high=HIGH).least_contrast


@pytest.mark.parametrize(("min_images", "lights"), [(1, 4), (2, 4), (2, 1), (3, 2)])
def test_a_disc_of_the_reported_contrast_is_found_half_of_the_time(min_images, lights):
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((4, SIDE, SIDE), dtype=np.float32)
    usable, lit = np.ones_like(noise, bool), np.zeros_like(noise, bool)
    lit[:lights] = True
    predicted = np.where(lit, np.float32(LEVEL), np.float32(0.5))
    even = Deviations(seen(noise, lit), np.full_like(noise, SCALE), usable, lit)
    reported = least_contrast(even, predicted, min_images)
    assert np.ptp(reported) == 0.0
    inside = discs(rng)
    found = {}
    for share in (0.6, 1.0, 1.5):
        z = noise.copy()
        z[: min(min_images, lights)] -= inside * np.float32(share * reported[0, 0] * LEVEL / SCALE)
        found[share] = share_found(seen(z, lit), usable, lit, min_images)
    assert 0.35 < found[1.0] < 0.75
    assert found[0.6] < 0.15
    assert found[1.5] > 0.95


@pytest.mark.parametrize("min_images", [1, 2])
def test_a_dark_place_tells_no_contrast_and_shows_glints_of_three_deviations(min_images):
    rng = np.random.default_rng(6)
    noise = rng.standard_normal((4, SIDE, SIDE), dtype=np.float32)
    usable, lit = np.ones_like(noise, bool), np.zeros_like(noise, bool)
    dark = Deviations(seen(noise, lit), np.full_like(noise, SCALE), usable, lit)
    assert np.all(np.isinf(least_contrast(dark, np.full_like(noise, 0.5), min_images)))
    inside = discs(rng)
    found = {}
    for glint in (1.0, DARK):
        z = noise.copy()
        z[0] += inside * np.float32(glint)
        found[glint] = share_found(seen(z, lit), usable, lit, min_images)
    assert found[1.0] < 0.1
    assert found[DARK] > 0.9


def test_each_pixel_is_in_the_class_of_what_it_can_show():
    # columns: off the part, an edge, shadow, saturated, dark, lit by one, lit by two, lit brightly by two, grazing
    expected = [
        *(SurfaceState.NO_PART, SurfaceState.EDGE, SurfaceState.SHADOW, SurfaceState.SATURATED),
        *(SurfaceState.GLINTS, SurfaceState.FEWER, SurfaceState.INSPECTED, SurfaceState.INSPECTED),
        SurfaceState.GRAZING,
    ]
    predicted = np.array([[0, 9, 0, 3000, 0.1, 40, 2, 400, 9], [0, 9, 0, 0, 0.1, 0.1, 2, 400, 9]], np.float32)
    saturated = np.array([[0, 0, 0, 1, 0, 0, 0, 0, 0]] * 2, bool)
    clean = np.array([0, 0, 1, 1, 1, 1, 1, 1, 0], bool)
    grazing = np.array([0, 0, 0, 0, 0, 0, 0, 0, 1], bool)
    lit = np.array([[0, 0, 0, 0, 0, 1, 1, 1, 0], [0, 0, 0, 0, 0, 0, 1, 1, 0]], bool)
    usable = np.array([[0, 0, 0, 0, 1, 1, 1, 1, 0], [0, 0, 0, 0, 1, 1, 1, 1, 0]], bool)
    area = np.array([0, 1, 2, 4, 8, 16, 32, 64, 128], np.float32)
    predicted, saturated, lit, usable = (a[:, None, :] for a in (predicted, saturated, lit, usable))
    view = view_of(predicted, saturated, (area > 0)[None], clean[None], area[None], grazing[None])
    ones = np.ones_like(predicted)
    found = measure_coverage(view, Deviations(0.0 * ones, ones, usable, lit), min_images=2, high=HIGH)
    assert found.state[0].tolist() == expected
    # what is seen at a grazing angle is in no share
    assert (found.seen, found.inspected, found.grazing) == (127.0, 120.0, 128.0)
    assert found.as_dict()["left_out"] == pytest.approx(128 / 255, abs=1e-5)
    assert (found.edge, found.shadow, found.saturated, found.glints, found.fewer) == (1, 2, 4, 8, 16)
    assert np.isinf(found.least_contrast[0, :5]).all()
    assert found.classes == (80.0, 0.0, 0.0, 0.0, 32.0, 8.0)
    assert sum(found.classes) == found.inspected
    assert found.share == pytest.approx(120 / 127)
    reported = found.as_dict()
    assert reported["only_glints"] == pytest.approx(8 / 127, abs=1e-5)
    assert reported["only_stronger"] == pytest.approx(32 / 127, abs=1e-5)
    assert reported["finds_contrast"] == {f"{c:g}": pytest.approx(80 / 127, abs=1e-5) for c in CONTRASTS}


def test_nothing_seen_has_no_share():
    none = SurfaceCoverage(area=1.0, seen=0.0, inspected=0.0, saturated=0.0, shadow=0.0, edge=0.0, sensitivity={})
    assert (none.share, none.finds, sum(none.classes)) == (0.0, 0.0, 0.0)
