"""Highlights go and marks of the surface stay, as each rule says; the uncertainty is that of the noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from lightopt.inspection.fusion._gradient_fusion import FUSIONS, pixel_weights
from lightopt.inspection.fusion._synthetic_image import fuse_images

ROWS, COLUMNS = 70, 90
Y, X = np.mgrid[:ROWS, :COLUMNS].astype(np.float32)
MASK = np.hypot(X - 45, Y - 35) < 33
TOP = np.float32(254.5)


def shading(direction):
    return 40.0 + 0.25 * (X - 45) * np.cos(direction) + 0.25 * (Y - 35) * np.sin(direction)


def scene(*, noise=0.0, stain=0.0, seed=0, same_place=False):
    """Four images with a highlight each, their noise-free diffuse light, and the specular share of them."""
    rng = np.random.default_rng(seed)
    diffuse, specular = [], []
    for i in range(4):
        direction = np.pi * (0.25 + 0.5 * i)
        place = (45, 35) if same_place else (45 + 14 * np.cos(direction), 35 + 14 * np.sin(direction))
        d = shading(direction) * np.where(np.hypot(X - 45, Y - 50) < 5, 1.0 - stain, 1.0)
        diffuse.append(d)
        specular.append(900 * np.exp(-((X - place[0]) ** 2 + (Y - place[1]) ** 2) / 40))
    diffuse, specular = np.array(diffuse, np.float32), np.array(specular, np.float32)
    level = diffuse + specular + noise * rng.normal(size=diffuse.shape).astype(np.float32)
    return np.minimum(level, 255.0).astype(np.float32), diffuse, specular


def fused(level, specular, fusion, *, deviation=0.5, probes=0):
    deviations = np.full_like(level, deviation)
    predicted = np.array([shading(np.pi * (0.25 + 0.5 * i)) for i in range(4)], np.float32) + specular
    weights = pixel_weights(level >= TOP, predicted, specular, deviations, np.full_like(level, TOP))
    return fuse_images(level, deviations, weights, MASK, fusion=fusion, probes=probes)


@pytest.mark.parametrize("fusion", FUSIONS)
def test_highlights_go(fusion):
    level, _, specular = scene()
    image = fused(level, specular, fusion).level
    assert not fused(level, specular, fusion).filled.any()
    assert np.ptp(image[MASK]) < 25  # the images reach 255 over 40
    inside, around = MASK & (level >= TOP).any(axis=0), MASK & ~(specular > 30).any(axis=0)
    assert abs(image[inside].mean() - image[around].mean()) < 4


@pytest.mark.parametrize("fusion", FUSIONS)
def test_stains_stay_in_sign_and_about_in_size(fusion):
    level, _, specular = scene(stain=0.4)
    image = fused(level, specular, fusion).level
    inside, around = np.hypot(X - 45, Y - 50) < 4, abs(np.hypot(X - 45, Y - 50) - 8) < 1
    contrast = image[inside].mean() - image[around].mean()
    assert -0.5 * 40 < contrast < -0.3 * 40


@pytest.mark.parametrize("fusion", ["paper", "median"])
def test_the_uncertainty_is_how_far_images_of_the_same_scene_scatter(fusion):
    runs = []
    for seed in range(12):
        level, _, specular = scene(noise=1.0, seed=seed)
        runs.append(fused(level, specular, fusion, deviation=1.0).level)
    reported = fused(level, specular, fusion, deviation=1.0, probes=8).deviation
    spread = np.std(runs, axis=0, ddof=1)
    assert reported[MASK].mean() == pytest.approx(spread[MASK].mean(), rel=0.25)


def test_what_no_image_tells_is_filled_in_smoothly_and_said_to_be():
    level, _, specular = scene(same_place=True)
    image = fused(level, specular, "median", probes=8)
    assert image.filled.sum() > 50
    assert not image.filled[~(level >= TOP).all(axis=0) & (np.hypot(X - 45, Y - 35) > 25)].any()
    around = ndimage.binary_dilation(image.filled, iterations=2) & ~image.filled
    assert image.level[image.filled].max() < image.level[around].max() + 20  # and not up to 255
    assert image.level[image.filled].min() > image.level[around].min() - 1
    assert image.deviation[image.filled].mean() > 2 * image.deviation[MASK & (specular[0] < 1)].mean()


def test_shadow_and_neighbours_of_saturation_are_not_trusted():
    deviations = np.ones((1, 9, 9), np.float32)
    predicted = np.full((1, 9, 9), 50, np.float32)
    predicted[0, :, 0] = 1.0
    saturated = np.zeros((1, 9, 9), bool)
    saturated[0, 4, 5] = True
    flat = np.zeros_like(predicted)
    weights = pixel_weights(saturated, predicted, flat, deviations, np.full_like(predicted, TOP))[0]
    assert (weights[:, 0] == 0).all()
    assert (weights[2:7, 3:8] == 0).all()
    assert (weights == 1).sum() == 81 - 9 - 25


def test_one_image_alone_is_given_back():
    level = shading(0.3)[None]
    ones = np.ones_like(level)
    for fusion in FUSIONS:
        found = fuse_images(level, 0.1 * ones, ones, MASK, fusion=fusion, probes=0)
        assert np.allclose(found.level[MASK], level[0][MASK], atol=1e-3)


def plain_paper(levels, deviations, weights, axis):
    """The paper's rule as it reads, pixel by pixel: kept where another image has a gradient of half the size nearby."""
    from lightopt.inspection.fusion._gradient_fusion import Edges

    edges = Edges.of(weights, deviations, axis)
    noise = edges.noise.astype(np.float64)
    gradient = np.where(edges.usable, np.diff(levels, axis=2 if axis == 1 else 1), 0.0).astype(np.float64)
    result = np.zeros(gradient.shape[1:])
    for y, x in np.ndindex(*result.shape):
        voices = np.flatnonzero(edges.usable[:, y, x])
        kept = []
        for i in voices:
            near = (slice(max(y - 1, 0), y + 2), slice(max(x - 1, 0), x + 2))
            others = [np.abs(gradient[(k, *near)]).max() for k in voices if k != i]
            size = abs(gradient[i, y, x])
            if not others or max(others) >= 0.5 * size - 2.0 * noise[i, y, x]:
                kept.append(gradient[i, y, x])
        result[y, x] = np.mean(kept) if kept else 0.0
    return result, edges


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("images", [1, 2, 4])
def test_the_papers_rule_is_what_it_reads(axis, images):
    from lightopt.inspection.fusion._gradient_fusion import fuse_gradients

    rng = np.random.default_rng(images)
    shape = (images, 70, 23)
    levels = rng.normal(50, 6, shape).astype(np.float32)
    levels[rng.random(shape) < 0.1] += 60
    weights = np.where(rng.random(shape) < 0.3, 0, rng.random(shape)).astype(np.float32)
    deviations = rng.uniform(0.5, 2, shape).astype(np.float32)
    expected, edges = plain_paper(levels, deviations, weights, axis)
    for threads in (1, 3):
        found = fuse_gradients(levels, edges, fusion="paper", threads=threads)
        assert np.allclose(found, expected, rtol=1e-12, atol=1e-12)
    assert np.all(found[edges.unknown] == 0)


def plain_choice(levels, deviations, weights, axis, fusion):
    """The other rules as they read, pixel by pixel."""
    from lightopt.inspection.fusion._gradient_fusion import Edges

    edges = Edges.of(weights, deviations, axis)
    gradient = np.diff(levels, axis=2 if axis == 1 else 1).astype(np.float64)
    result = np.zeros(gradient.shape[1:])
    for place in np.ndindex(*result.shape):
        own = gradient[(slice(None), *place)][edges.usable[(slice(None), *place)]]
        if not len(own):
            continue
        by_size = own[np.argsort(np.abs(own))]
        result[place] = {
            "median": np.median(own),
            "minimum": by_size[0],
            "second-largest": by_size[max(len(own) - 2, 0)],
        }[fusion]
    return result, edges


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("fusion", ["median", "minimum", "second-largest"])
def test_rules_that_choose_are_what_they_read(axis, fusion):
    from lightopt.inspection.fusion._gradient_fusion import fuse_gradients

    rng = np.random.default_rng(8)
    shape = (4, 70, 23)
    levels = rng.normal(50, 6, shape).astype(np.float32)
    weights = np.where(rng.random(shape) < 0.4, 0, 1).astype(np.float32)
    expected, edges = plain_choice(levels, np.ones(shape, np.float32), weights, axis, fusion)
    for threads in (1, 3):
        found = fuse_gradients(levels, edges, fusion=fusion, threads=threads)
        assert np.allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("fusion", ["paper", "second-largest"])
def test_the_number_of_threads_changes_neither_image_nor_uncertainty(fusion):
    level, _, specular = scene(noise=1.0)
    predicted = np.array([shading(np.pi * (0.25 + 0.5 * i)) for i in range(4)], np.float32) + specular
    deviations = np.ones_like(level)
    limit = np.full_like(level, TOP)

    def made(threads):
        weights = pixel_weights(level >= TOP, predicted, specular, deviations, limit, threads=threads)
        good = {"predicted": predicted, "specular": specular}
        return fuse_images(level, deviations, weights, MASK, fusion=fusion, threads=threads, **good)

    one, three = made(1), made(3)
    assert np.array_equal(one.level, three.level)
    assert np.array_equal(one.deviation, three.deviation)
    assert one.deviation[MASK].min() > 0


@pytest.mark.parametrize("fusion", ["median", "minimum", "second-largest"])
def test_what_noise_makes_of_a_rule_that_chooses_is_taken_off(fusion, monkeypatch):
    predicted = np.array([shading(np.pi * (0.25 + 0.5 * i)) for i in range(4)], np.float32)
    none = np.zeros_like(predicted)
    deviations, limit = np.full_like(predicted, 2.0), np.full_like(predicted, 1e9)
    weights = pixel_weights(none > 0, predicted, none, deviations, limit)
    # half of one image has no say, as in a former highlight
    weights[0, :, :45] = 0
    plain = fuse_images(predicted, deviations, np.ones_like(weights), MASK, fusion=fusion, probes=0).level

    def off(draws):
        monkeypatch.setattr("lightopt.inspection.fusion._synthetic_image.PROBES", draws)
        images = []
        for seed in range(6):
            noise = np.random.default_rng(seed).standard_normal(predicted.shape, dtype=np.float32)
            noisy = predicted + deviations * noise
            good = {"predicted": predicted, "specular": none}
            images.append(
                fuse_images(noisy, deviations, weights, MASK, fusion=fusion, seed=seed, probes=0, **good).level
            )
        return float(np.std((np.mean(images, axis=0) - plain)[MASK]))

    left, before = off(4), off(0)
    assert left < 0.7 * before


def test_the_largest_gradient_nearby_is_that_of_scipys_filter():
    from lightopt.inspection.fusion._gradient_fusion import REACH_PX, _largest_nearby

    size = np.random.default_rng(2).random((3, 17, 23)).astype(np.float32)
    side = 2 * REACH_PX + 1
    assert np.array_equal(_largest_nearby(size), ndimage.maximum_filter(size, (1, side, side)))


@pytest.mark.parametrize("threads", [1, 3])
def test_weights_are_what_they_read_pixel_by_pixel(threads):
    rng = np.random.default_rng(4)
    shape = (2, 70, 23)
    saturated = rng.random(shape) < 0.02
    predicted, deviations = (rng.uniform(a, b, shape).astype(np.float32) for a, b in ((0, 260), (0.5, 20)))
    specular = (predicted * rng.random(shape)).astype(np.float32)
    limit = np.full(shape, 255, np.float32)
    found = pixel_weights(saturated, predicted, specular, deviations, limit, threads=threads)
    full = saturated | (predicted >= limit)
    for i, y, x in np.ndindex(shape):
        near = (i, slice(max(y - 2, 0), y + 3), slice(max(x - 2, 0), x + 3))
        noise = deviations[i, y, x]
        if full[near].any() or predicted[i, y, x] < 3.0 * float(noise):
            assert found[i, y, x] == 0.0
            continue
        above, below, before, after = max(y - 1, 0), min(y + 1, 69), max(x - 1, 0), min(x + 1, 22)
        down = float(specular[i, below, x] - specular[i, above, x]) / (below - above)
        right = float(specular[i, y, after] - specular[i, y, before]) / (after - before)
        steep = (down * down + right * right) / float(noise * noise)
        assert found[i, y, x] == np.float32(1.0 / (1.0 + steep))
