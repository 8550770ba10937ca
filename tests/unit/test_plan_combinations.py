"""All places of the lights at once, over several postures: against adding up one combination after the other."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from lightopt.errors import InputError
from lightopt.optimize import Space
from lightopt.plan import PairWeights, combination_sums, counts_of_images, place_lights

POSTURES = 2


def case(seed, sizes, *, patches=6, k=2):
    """Flags of one word per patch and posture, counts over the postures, weights."""
    rng = np.random.default_rng(seed)
    flags = [
        (
            rng.integers(0, 1 << 62, (n, POSTURES, patches, 1))
            & rng.integers(0, 1 << 62, (n, POSTURES, patches, 1))
        ).astype(np.uint64)
        for n in sizes
    ]
    counts = [np.stack([counts_of_images(list(place), k) for place in light]) for light in flags]
    masks = np.array([[0x5555555555555555], [0xAAAAAAAAAAAAAAAA]], np.uint64)
    weights = PairWeights(areas=rng.integers(0, 9, patches), masks=masks, factors=np.array([1, 2], np.int64))
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
    reached, worth = combination_sums(counts, weights, threads=2)
    expected = [plain(flags, weights, chosen, k) for chosen in product(*map(range, sizes))]
    assert list(zip(reached.tolist(), worth.tolist(), strict=True)) == expected
    again = combination_sums(counts, weights, threads=1)
    np.testing.assert_array_equal(again[0], reached)


@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize("seed", range(4))
def test_the_best_allowed_places_are_found(seed, k):
    sizes = (3, 4, 3)
    flags, counts, weights = case(seed, sizes, k=k)
    clash = np.random.default_rng(seed).random((3, 3)) < 0.5
    clash[0, 0] = False
    space = Space(sizes=sizes, groups=(tuple(np.arange(n) for n in sizes),), clashes={(0, 2): clash})
    allowed = [c for c in product(*map(range, sizes)) if not clash[c[0], c[2]]]
    best = max(allowed, key=lambda c: plain(flags, weights, c, k))
    found = place_lights(counts, weights, space)
    assert found.exact
    assert found.candidates == best
    assert (found.reached, found.worth) == plain(flags, weights, best, k)
    # with too much work for all of them: allowed, honest, and no light alone can do better
    moved = place_lights(counts, weights, space, most_words=1)
    assert not moved.exact
    assert (moved.reached, moved.worth) == plain(flags, weights, moved.candidates, k)
    for i in range(3):
        for place in range(sizes[i]):
            other = (*moved.candidates[:i], place, *moved.candidates[i + 1 :])
            if other in allowed:
                assert plain(flags, weights, other, k) <= (moved.reached, moved.worth)


def test_common_elevations_are_kept():
    sizes = (2, 2)
    flags, counts, weights = case(9, sizes)
    groups = tuple((np.array([row]), np.array([row])) for row in range(2))
    found = place_lights(counts, weights, Space(sizes=sizes, groups=groups))
    assert found.candidates == max([(0, 0), (1, 1)], key=lambda c: plain(flags, weights, c, 2))


@pytest.mark.parametrize("most_words", [1, 10**9])
def test_lights_that_always_collide_are_refused(most_words):
    _, counts, weights = case(1, (2, 2))
    space = Space(
        sizes=(2, 2), groups=((np.arange(2), np.arange(2)),), clashes={(0, 1): np.ones((2, 2), bool)}
    )
    with pytest.raises(InputError, match="panels collide"):
        place_lights(counts, weights, space, most_words=most_words)
