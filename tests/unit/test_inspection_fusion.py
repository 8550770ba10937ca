"""Highlights go and marks of the surface stay, as each rule says; the uncertainty is that of the noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from lightopt.inspection import FUSIONS, fuse_images, trust_weights

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
    weights = trust_weights(level >= TOP, predicted, specular, deviations, np.full_like(level, TOP))
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
    told = fused(level, specular, fusion, deviation=1.0, probes=8).deviation
    spread = np.std(runs, axis=0, ddof=1)
    assert told[MASK].mean() == pytest.approx(spread[MASK].mean(), rel=0.25)


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
    weights = trust_weights(saturated, predicted, flat, deviations, np.full_like(predicted, TOP))[0]
    assert (weights[:, 0] == 0).all()
    assert (weights[2:7, 3:8] == 0).all()
    assert (weights == 1).sum() == 81 - 9 - 25


def test_one_image_alone_is_given_back():
    level = shading(0.3)[None]
    ones = np.ones_like(level)
    for fusion in FUSIONS:
        found = fuse_images(level, 0.1 * ones, ones, MASK, fusion=fusion, probes=0)
        assert np.allclose(found.level[MASK], level[0][MASK], atol=1e-3)
