"""The area under the ROC is that of pairs; the curve of detection is the one that hits and misses were drawn from."""

from __future__ import annotations

import numpy as np
import pytest

from lightopt.inspection.evaluation._evaluation import area_under_roc, fit_detection_curve, region_hits


def test_the_area_counts_pairs_and_ties_by_half():
    rng = np.random.default_rng(0)
    score = rng.integers(0, 6, 60).astype(float)
    positive = rng.random(60) < 0.4
    pairs = [(p > n) + 0.5 * (p == n) for p in score[positive] for n in score[~positive]]
    assert area_under_roc(score, positive) == pytest.approx(np.mean(pairs))


def test_a_region_finds_what_it_touches_unless_it_is_far_larger():
    truth = np.full((80, 100), -1, np.int32)
    truth[10:14, 10:14] = 0  # 16 px
    truth[30:33, 60:63] = 1
    truth[30:33, 66:69] = 2
    labels = np.zeros((80, 100), np.int32)
    labels[10:14, 15:19] = 1  # two pixels off the first
    labels[29:34, 59:70] = 2  # over both others
    labels[60:64, 20:24] = 3  # nothing there
    labels[0:3, 0:100] = 4  # touches nothing, and is large
    assert [hit.tolist() for hit in region_hits(labels, truth)] == [[0], [1, 2], [], []]
    labels[10:14, 15:19] = 0
    labels[10:31, 14:24] = 1  # 210 px: as many as 10 × 16 + 50
    assert region_hits(labels, truth)[0].tolist() == [0]
    labels[31, 14] = 1
    assert region_hits(labels, truth)[0].tolist() == []
    everywhere = np.ones_like(labels)
    assert [hit.tolist() for hit in region_hits(everywhere, truth)] == [[]]


def draw(n, seed, *, a50=0.5, steepness=5.0):
    rng = np.random.default_rng(seed)
    sizes = rng.uniform(0.1, 2.0, n)
    chance = 1.0 / (1.0 + np.exp(-steepness * np.log(sizes / a50)))
    return sizes.tolist(), (rng.random(n) < chance).tolist()


def test_the_curve_comes_back_from_many_defects():
    curve = fit_detection_curve(*draw(4000, 1))
    truth = 0.5 * np.exp(np.log(9) / 5.0)
    assert curve.steepness == pytest.approx(5.0, rel=0.15)
    assert curve.a90 == pytest.approx(truth, rel=0.06)
    assert curve.a90 < curve.a90_95 < 1.15 * truth


@pytest.mark.slow
def test_the_bound_holds_about_19_times_in_20():
    truth = 0.5 * np.exp(np.log(9) / 5.0)
    curves = [fit_detection_curve(*draw(60, seed)) for seed in range(30)]
    bounds = [c.a90_95 for c in curves]
    held = sum(b is None or b >= truth for b in bounds)
    assert held >= 25
    assert sum(b is None for b in bounds) < 4
    assert np.mean([c.a90 < truth for c in curves if c.a90 is not None]) == pytest.approx(0.5, abs=0.25)


def test_the_likelihood_is_greatest_there():
    sizes, found = draw(80, 3)
    curve = fit_detection_curve(sizes, found)
    x = np.log(sizes)

    def value(b0, b1):
        p = 1.0 / (1.0 + np.exp(-(b0 + b1 * x)))
        return np.sum(np.log(np.where(found, p, 1 - p)))

    best = value(curve.intercept, curve.steepness)
    for d0 in (-0.05, 0.0, 0.05):
        for d1 in (-0.05, 0.0, 0.05):
            assert value(curve.intercept + d0, curve.steepness + d1) <= best + 1e-6


@pytest.mark.parametrize(
    ("sizes", "found"),
    [
        ([1.0] * 3, [True, False, True]),
        (list(range(1, 12)), [True] * 11),
        (list(range(1, 12)), [False] * 11),
        ([1.0] * 12, [True, False] * 6),
        (list(range(1, 13)), [True] * 6 + [False] * 6),  # the small ones found: no size is found 90 % of the time
    ],
)
def test_what_cannot_be_measured_is_not_reported(sizes, found):
    curve = fit_detection_curve(sizes, found)
    assert (curve.a90, curve.a90_95) == (None, None)
    assert (curve.defects, curve.found) == (len(sizes), sum(found))


def test_all_found_from_some_size_on_has_a_bound_all_the_same():
    sizes = np.linspace(0.1, 2.0, 30)
    curve = fit_detection_curve(sizes.tolist(), (sizes > 0.8).tolist())
    assert curve.a90 == pytest.approx(0.8, abs=0.08)
    assert 0.8 < curve.a90_95 < 1.5
