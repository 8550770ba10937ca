"""Evidence of defects on patches: kernels against plain NumPy, and limits of the units."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lightopt.defects import (
    BUILT_IN_CATALOGUE,
    CATALOGUE_SHARE,
    FORESHORTENINGS,
    chance_score,
    clipped_variance,
    expected_change,
    least_z,
    plane_to_image,
)
from lightopt.design import DetectionModel, planned_catalogue
from lightopt.design.responses import _evidence as evidence
from lightopt.design.responses._evidence_sums import (
    ImagePatches,
    PlannedTurns,
    Stencils,
    evidence_flags,
    greatest_within,
)
from lightopt.design.responses._pairs import narrow_words, pack_flags, widen_octets
from lightopt.inspection.detection._registry import DETECTORS
from lightopt.inspection.detection._residual_score import threshold
from lightopt.optics import Sensor

SENSOR = Sensor(bit_depth=8, read_noise_levels=0.8, electrons_per_level=60)


def model(**options):
    return DetectionModel(catalogue=planned_catalogue(BUILT_IN_CATALOGUE), sensor=SENSOR, full_scale=255.0, **options)


def test_an_image_counts_for_three_units_at_most_and_no_image_alone_for_enough():
    for k, needed in ((1, 3), (2, 4), (3, 8)):
        assert evidence.units_needed(k) == needed
        limits = model(min_images=k).limits(1e6, 0.05)
        assert limits.shape == (len(BUILT_IN_CATALOGUE), 3)
        assert (np.diff(limits, axis=1) > 0.0).all()
        # of 1e6 pixels and thousands of tests noise alone exceeds this in one posture of twenty
        z2 = model().limits(1e6, 0.05)[:, 2]
        assert ((z2 > 4.5**2) & (z2 < 7.5**2)).all()
        if k > 1:
            # of three units k − 1 images have three quarters of what is needed, and each as much as confirms
            np.testing.assert_allclose(limits[:, 2] * (k - 1), np.maximum(0.75 * z2, 9.0 * (k - 1)))
            assert evidence.UNITS_OF_IMAGE * (k - 1) < needed


def test_fewer_false_alarms_need_more_evidence():
    assert least_z(1e5, 7, 0.05) == pytest.approx(5.51, abs=0.01)
    assert least_z(1e5, 7, 0.001) > least_z(1e5, 7, 0.05) > least_z(1e3, 7, 0.05)


def test_a_calibrated_threshold_of_noise_alone_is_that_of_noise_alone():
    pixels = 300_000
    plain = model(min_images=2, false_alarms=0.05).limits(pixels, 0.05)
    same = model(min_images=2, threshold=threshold(0.05, pixels, 1)).limits(pixels, 0.05)
    np.testing.assert_allclose(same, plain, rtol=1e-9)
    assert (model(min_images=2, threshold=threshold(0.05, pixels, 1) + 2.0).limits(pixels, 0.05) > plain).all()


@pytest.mark.parametrize("tests", [1.0, 250.0, 4e5])
def test_the_threshold_is_that_of_the_detector(tests):
    """A Z that planning needs has the score that an inspection needs: the detector's own sum of logarithms."""
    pixels, entries, false_alarms = 123_456, 7, 0.03
    handicap = math.log10(tests * entries / (CATALOGUE_SHARE * pixels))
    needed = threshold(false_alarms, pixels, DETECTORS["catalogue"].tests)
    z = least_z(tests, entries, false_alarms)
    assert float(chance_score(np.array(z))) - handicap == pytest.approx(needed, abs=1e-9)


def image(rng, patches):
    """Patches in an image of 12 x 9 cells of 2.5 px, one or none in each; their cells' middles."""
    owner = np.full((9, 12), -1, np.int32)
    at = np.sort(rng.choice(owner.size, patches, replace=False))
    owner.ravel()[at] = np.arange(patches)
    row, column = np.divmod(at, 12)
    cell = 2.5
    return owner, cell, ((column + 0.5) * cell).astype(np.float32), ((row + 0.5) * cell).astype(np.float32)


def owner_at(owner, cell, column, row):
    x, y = math.floor(column / cell), math.floor(row / cell)
    inside = 0 <= y < owner.shape[0] and 0 <= x < owner.shape[1]
    return owner[y, x] if inside else -1


def placed(owner, cell, column, row, classes=None, angle=None):
    none = np.zeros(len(column), np.int32)
    places = column / np.float32(cell), row / np.float32(cell)
    return ImagePatches(
        *places, owner, cell, none if classes is None else classes, none * 0.0 if angle is None else angle
    )


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("correlated", [(), (3.0,), (3.0, 40.0)], ids=["smooth", "wavy", "wavy, by entry"])
def test_changes_are_those_of_the_statistic_with_noise_and_registration(seed, correlated):
    rng = np.random.default_rng(seed)
    patches = 70
    owner, cell, column, row = image(rng, patches)
    good = rng.choice([0.0, 1.0, 40.0, 200.0, 400.0], patches) * rng.random(patches)
    varied = (good[:, None] * rng.uniform(0.7, 1.4, (patches, 6)) + rng.normal(0.0, 4.0, (patches, 6))).astype(
        np.float32
    )
    scale, limit = 0.7, 251.0
    leant = (good + rng.normal(0.0, 2.0, (2 if correlated else 0, patches))).astype(np.float32)
    error = rng.uniform(0.0, 5.0, patches if seed % 2 else 0)
    # with bounds for each entry, the last four variants are the second one's
    first = np.array([0, 2, 6] if len(correlated) > 1 else [0, 6], np.int32)
    codes, all_bounds = evidence._changes(
        good, varied.T.copy(), leant, error, np.array(correlated or (0.0,)), first, placed(owner, cell, column, row),
        (scale, limit, 0.8, 60.0, 0.01),
    )  # fmt: skip
    bounds = all_bounds[-1]
    level = np.minimum(scale * good, limit)
    for p in range(patches):
        square = 0.0
        for dx, dy in ((cell, 0.0), (0.0, cell)):
            near = [owner_at(owner, cell, column[p] + s * dx, row[p] + s * dy) for s in (-1, 1)]
            low, high = (level[p] if q < 0 else level[q] for q in near)
            square += ((high - low) / (max(1, sum(q >= 0 for q in near)) * cell)) ** 2
        variance = 0.8**2 + level[p] / 60.0 + (0.01 * level[p]) ** 2 + 1.0 / 12.0 + 0.1**2 * square
        if len(error):
            ends = np.minimum(scale * (good[p] + error[p] * np.array([-1.0, 1.0])), limit)
            variance += (0.5 * np.ptp(ends)) ** 2
        if correlated:
            spread = scale * math.hypot(*(leant[:, p] - good[p]))
            variance += correlated[-1] * clipped_variance(scale * good[p], spread, limit)
        deviation = math.sqrt(variance)
        linear = (scale * varied[p].astype(float) - level[p]) / deviation
        own = slice(first[-2], 6)
        close = np.clip(linear, -2000.0, 2000.0)[own]
        np.testing.assert_allclose(codes[own, p] / 16.0, close, atol=1.0 / 32.0 + 1e-6)
        # of a pixel that one variant fills it is the statistic's
        clipped = np.clip(linear, bounds[p, 0], bounds[p, 1])
        expected = expected_change(
            np.full(6, scale * good[p]), scale * varied[p].astype(float), deviation=np.full(6, deviation), limit=limit
        )
        np.testing.assert_allclose(np.where(np.abs(clipped) <= bounds[p, 2], 0.0, clipped), expected, atol=1e-5)
    assert np.count_nonzero(codes) > 100
    assert np.count_nonzero(bounds[:, 2]) > 10


@pytest.mark.parametrize("seed", range(12))
def test_evidence_is_the_sum_of_squares_over_the_pixels_of_a_defect(seed):
    """Each piece looked up plainly, with two entries: a round one, and one in four orientations."""
    rng = np.random.default_rng(seed)
    patches, variants = 70, 5
    owner, cell, column, row = image(rng, patches)
    # a patch beyond the image's border sees none, and many change little
    column[3] = -4.0
    change = rng.integers(-200, 200, (patches, variants)) * (rng.random((patches, 1)) < 0.3)
    codes = np.r_[change, np.zeros((1, variants))].astype(np.int16).T.copy()
    bounds = np.c_[rng.uniform(-8.0, 0.0, patches), rng.uniform(0.0, 8.0, patches), rng.choice([0.0, 3.0], patches)]
    bounds = np.r_[bounds, np.zeros((1, 3))].astype(np.float32)
    by_entry = np.stack([bounds, 0.5 * bounds]) if seed % 2 else bounds[None]
    classes = np.sort(rng.integers(0, 20, patches)).astype(np.int32)
    angle = rng.uniform(-math.pi, math.pi, patches)
    entry, turns = np.array([0, 1, 1, 1, 1]), np.array([1, 4])
    groups = len(entry) * FORESHORTENINGS
    pieces = [
        sorted(set(map(tuple, np.c_[rng.integers(-3, 4, (4, 2)), rng.integers(0, variants, 4)].tolist())))
        for _ in range(groups)
    ]
    first = np.cumsum([0, *map(len, pieces)])
    right, down, variant = (np.array([piece[i] for own in pieces for piece in own]) for i in range(3))
    right = 2.0 * right
    # the second entry's variants are the last three
    variant = np.where(np.arange(len(variant)) < first[FORESHORTENINGS], variant % 2, 2 + variant % 3)
    share = 0.25 * rng.random(len(variant)).astype(np.float32)
    ratio = rng.uniform(1.0, 3.0, groups).astype(np.float32)
    along = rng.uniform(-9.0, 9.0, (groups, 2)).astype(np.float32) * (rng.random((groups, 1)) < 0.5)
    limits = np.sort(rng.uniform(0.0, 300.0, (2, 3)), axis=1)
    new = np.r_[True, (np.diff(right) != 0) | (np.diff(down) != 0)]
    new[first[:-1]] = True
    starts = np.flatnonzero(new)
    in_pixels = np.add.reduceat(share, starts)
    pixels = np.searchsorted(starts, first)
    stencils = Stencils(
        first=pixels.astype(np.int32), along=along.astype(np.float32), right=right[starts].astype(np.float32),
        down=down[starts].astype(np.float32), piece=np.r_[starts, len(share)].astype(np.int32),
        variant=variant.astype(np.int32), share=share, ratio=ratio,
        square=np.add.reduceat(in_pixels.astype(float) ** 2, pixels[:-1]),
    )  # fmt: skip
    words = evidence_flags(
        codes, by_entry, placed(owner, cell, column, row, classes, angle),
        PlannedTurns(entry.astype(np.int32), turns.astype(np.int32), np.array([0, 2, variants], np.int32)),
        stencils.in_cells(cell), limits,
    )  # fmt: skip

    def energy_at(p, h):
        group = h * FORESHORTENINGS + classes[p]
        pixels = {}
        for n in range(first[group], first[group + 1]):
            near = max(abs(right[n]), abs(down[n])) < 0.5 * cell
            q = p if near else owner_at(owner, cell, column[p] + right[n], row[p] + down[n])
            own = pixels.setdefault((right[n], down[n]), [q, 0.0])
            own[1] += 0.0 if q < 0 else share[n] * codes[variant[n], q] / 16.0
        own_bounds = by_entry[min(entry[h], len(by_entry) - 1)]
        changes = [(np.clip(m, *own_bounds[q, :2]), own_bounds[q, 2]) for q, m in pixels.values() if q >= 0]
        return float(ratio[group]) ** 2 * sum(m**2 for m, none in changes if abs(m) > none)

    for p in range(patches):
        for h in range(5):
            turn = 0 if h == 0 else 1 + (h - 1 + round(angle[p] / math.pi * 4)) % 4
            dx, dy = along[turn * FORESHORTENINGS + classes[p]]
            near = [p]
            if dx or dy:
                near += [owner_at(owner, cell, column[p] + side * dx, row[p] + side * dy) for side in (-2, -1, 1, 2)]
            energy = max(energy_at(q, turn) for q in near if q >= 0)
            if np.abs(limits[entry[h]] - energy).min() < 1e-3:
                continue
            bits = [int(words[j, p, 0] >> np.uint64(h) & np.uint64(1)) for j in range(3)]
            assert bits == [int(energy >= limit) for limit in limits[entry[h]]]


@pytest.mark.parametrize("radius", [0, 1, 2, 5, 30])
def test_the_greatest_of_the_cells_around_each(radius):
    cells = np.random.default_rng(radius).integers(0, 255, (17, 11)).astype(np.uint8)
    found = greatest_within(cells, radius)
    for y in range(17):
        for x in range(11):
            near = cells[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1]
            assert found[y, x] == near.max()


@pytest.mark.parametrize("hypotheses", [0, 1, 8, 9, 64, 65, 100])
def test_words_are_kept_in_as_many_octets_as_they_need(hypotheses):
    words = pack_flags(np.random.default_rng(hypotheses).random((6, hypotheses)) < 0.7)
    whole = np.zeros((2, 3, 2), np.uint64)
    whole[..., : words.shape[1]] = words.reshape(2, 3, -1)
    octets = narrow_words(whole)
    assert octets.shape == (2, 3, -(-hypotheses // 8))
    assert (widen_octets(octets, 2) == whole).all()


@pytest.mark.parametrize("footprint", [0.33, 0.12])
def test_a_piece_of_a_scratch_has_the_evidence_of_its_segments_wherever_they_lie(footprint):
    """In each turn, over directions of light and places within a pixel, where a level is linear in the slope."""
    catalogue = planned_catalogue([one for one in BUILT_IN_CATALOGUE if one.name == "scratch"])
    (own,) = catalogue.entries
    stencils = evidence._make_stencils(catalogue, footprint, 0.0)
    steps = max(1.0, own.shapes[1].width / (2.2 * footprint))
    lean = own.slope * np.stack([np.cos(own.direction), np.sin(own.direction)])
    quarters = (-0.375, -0.125, 0.125, 0.375)
    for seen_from in (0, 12):
        to_image = plane_to_image(seen_from, steps * footprint)
        for turn in range(len(own.turns)):
            group = turn * FORESHORTENINGS + seen_from
            planned = 0.0
            for pixel in range(stencils.first[group], stencils.first[group + 1]):
                pieces = slice(stencils.piece[pixel], stencils.piece[pixel + 1])
                planned += np.sum((lean[:, stencils.variant[pieces]] @ stencils.share[pieces]) ** 2)
            planned *= float(stencils.ratio[group]) ** 2
            everywhere = []
            for off in ((x, y) for x in quarters for y in quarters):
                seen = own.seen_by_pixels(1, turn, to_image, off_px=off)
                pixels = {}
                for row, column, variant, weight in zip(seen.row, seen.column, seen.variant, seen.weight, strict=True):
                    pixels.setdefault((row, column), np.zeros(2))
                    pixels[row, column] += weight * lean[:, variant]
                everywhere.append(steps**2 * sum(np.sum(change**2) for change in pixels.values()))
            # the best along the scratch is a little more than the mean
            assert 0.7 < planned / np.mean(everywhere) < 1.5
