"""All places of the lights at once, over several postures: against adding up one combination after the other."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from lightopt.core.errors import InputError
from lightopt.design.objectives import _scores_by_units as unit_sums
from lightopt.design.objectives._scores_by_units import combination_sums
from lightopt.design.postures._light_positions import place_lights
from lightopt.design.responses._pairs import PairWeights
from lightopt.design.search._exact_search import CombinationSpace

POSTURES = 2


def case(seed, sizes, *, patches=6, k=2):
    """Flags of one word per patch and posture, counts over the postures, weights."""
    rng = np.random.default_rng(seed)
    flags = [
        (
            rng.integers(0, 1 << 62, (n, POSTURES, patches, 1)) & rng.integers(0, 1 << 62, (n, POSTURES, patches, 1))
        ).astype(np.uint64)
        for n in sizes
    ]
    masks = np.array([[0x5555555555555555], [0xAAAAAAAAAAAAAAAA]], np.uint64)
    weights = PairWeights(areas=rng.integers(0, 9, patches), masks=masks, factors=np.array([1, 2], np.int64))
    counts = [np.stack([weights.sum_counts(place[:, None], k) for place in light]) for light in flags]
    return flags, counts, weights


def plain(flags, weights, chosen, k):
    """(reached, worth) of one combination, bit by bit."""
    images = np.concatenate([light[c] for light, c in zip(flags, chosen, strict=True)])[..., 0]
    bits = (images[:, :, None] >> np.arange(64, dtype=np.uint64)) & np.uint64(1)
    count = bits.sum(axis=0)
    heavy = weights.areas[:, None] * np.where(np.arange(64) % 2 == 0, 1, 2)
    return int(heavy[count >= k].sum()), int((heavy * np.minimum(k, count)).sum())


@pytest.mark.parametrize("k", [1, 2, 3])
@pytest.mark.parametrize("sizes", [(4,), (3, 4), (2, 3, 2), (2, 2, 3, 2)])
def test_every_combination_is_the_plain_sum(sizes, k):
    flags, counts, weights = case(len(sizes), sizes, k=k)
    covered, benefit = combination_sums(counts, weights, k, threads=2)
    expected = [plain(flags, weights, chosen, k) for chosen in product(*map(range, sizes))]
    assert list(zip(covered.tolist(), benefit.tolist(), strict=True)) == expected
    again = combination_sums(counts, weights, k, threads=1)
    np.testing.assert_array_equal(again[0], covered)


@pytest.mark.parametrize("k", [1, 2, 3])
@pytest.mark.parametrize("most", [1, 20, 200])
@pytest.mark.parametrize("sizes", [(5,), (3, 1, 4), (2, 3, 2, 2)])
def test_patches_left_by_the_runs_are_added_up_and_agree(monkeypatch, sizes, most, k):
    _, counts, weights = case(7, sizes, patches=30, k=k)
    whole = combination_sums(counts, weights, k, threads=1)
    monkeypatch.setattr(unit_sums, "LEAST_NODES", 1)
    monkeypatch.setattr(unit_sums, "MOST_NODES", most)
    monkeypatch.setattr(unit_sums, "TASK_WORDS", 50)
    shares = []
    again = combination_sums(counts, weights, k, threads=2, progress=shares.append)
    np.testing.assert_array_equal(again, whole)
    assert shares == sorted(shares)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_patches_whose_counts_change_seldom_come_from_the_runs_alone(monkeypatch, k):
    """Several words of trials, each pair seen in runs of places: nothing is left to plain additions."""
    rng = np.random.default_rng(k)
    sizes, patches, width = (6, 1, 5, 4), 8, 2
    flags = []
    for size in sizes:
        a, b = np.sort(rng.integers(0, size + 1, (2, POSTURES, patches, width, 1)), axis=0)
        place = np.arange(size)[:, None, None, None, None]
        bits = ((place >= a) & (place < b) & (rng.random((POSTURES, patches, width, 64)) < 0.7)).astype(np.uint64)
        flags.append((bits << np.arange(64, dtype=np.uint64)).sum(axis=-1, dtype=np.uint64))
    masks = np.array([[0x00000000FFFFFFFF, 0x3], [0xFF, 0x5]], np.uint64)
    weights = PairWeights(areas=rng.integers(0, 9, patches), masks=masks, factors=np.array([1, 4], np.int64))
    counts = [np.stack([weights.sum_counts(place[:, None], k) for place in light]) for light in flags]
    monkeypatch.setattr(unit_sums, "_added_up", None)
    covered, benefit = combination_sums(counts, weights, k, threads=2)
    bit = np.unpackbits(masks.view(np.uint8), axis=1, bitorder="little").astype(np.int64)
    heavy = weights.areas[:, None] * (weights.factors @ bit)
    for at, chosen in enumerate(product(*map(range, sizes))):
        images = np.concatenate([light[c] for light, c in zip(flags, chosen, strict=True)])
        seen = np.unpackbits(images.view(np.uint8), axis=-1, bitorder="little").astype(np.int64).sum(axis=0)
        assert covered[at] == heavy[seen >= k].sum()
        assert benefit[at] == (heavy * np.minimum(seen, k)).sum()


@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize("seed", range(4))
def test_the_best_allowed_places_are_found(seed, k):
    sizes = (3, 4, 3)
    flags, counts, weights = case(seed, sizes, k=k)
    clash = np.random.default_rng(seed).random((3, 3)) < 0.5
    clash[0, 0] = False
    space = CombinationSpace(sizes=sizes, groups=(tuple(np.arange(n) for n in sizes),), clashes={(0, 2): clash})
    allowed = [c for c in product(*map(range, sizes)) if not clash[c[0], c[2]]]
    best = max(allowed, key=lambda c: plain(flags, weights, c, k))
    found = place_lights(counts, weights, space, needed=k)
    assert found.exact
    assert found.candidates == best
    assert (found.covered, found.benefit) == plain(flags, weights, best, k)
    # in pieces the same, ties too
    for cells in (1, 3, 5, 13):
        assert place_lights(counts, weights, space, needed=k, table_cells=cells) == found
    # with too many to try them all: allowed, honest, and no light alone can do better
    moved = place_lights(counts, weights, space, needed=k, limit=1)
    assert not moved.exact
    assert (moved.covered, moved.benefit) == plain(flags, weights, moved.candidates, k)
    for i in range(3):
        for place in range(sizes[i]):
            other = (*moved.candidates[:i], place, *moved.candidates[i + 1 :])
            if other in allowed:
                assert plain(flags, weights, other, k) <= (moved.covered, moved.benefit)


def test_common_elevations_are_kept():
    sizes = (2, 2)
    flags, counts, weights = case(9, sizes)
    groups = tuple((np.array([row]), np.array([row])) for row in range(2))
    found = place_lights(counts, weights, CombinationSpace(sizes=sizes, groups=groups), needed=2)
    assert found.candidates == max([(0, 0), (1, 1)], key=lambda c: plain(flags, weights, c, 2))


def test_of_equal_places_the_first_are_taken_however_they_are_cut_in_pieces():
    _, counts, weights = case(3, (3, 3, 2))
    same = [np.repeat(light[:1], len(light), axis=0) for light in counts]
    for cells in (1, 2, 4, 100):
        found = place_lights(same, weights, CombinationSpace.of((3, 3, 2)), needed=2, table_cells=cells)
        assert found.candidates == (0, 0, 0)


@pytest.mark.parametrize("limit", [1, 10**9])
def test_lights_that_always_collide_are_refused(limit):
    _, counts, weights = case(1, (2, 2))
    space = CombinationSpace(
        sizes=(2, 2), groups=((np.arange(2), np.arange(2)),), clashes={(0, 1): np.ones((2, 2), bool)}
    )
    with pytest.raises(InputError, match="panels collide"):
        place_lights(counts, weights, space, needed=2, limit=limit)
