"""Greedy cover: counts and gains as a plain reading of them, bounds never violated by the exact cover (MILP)."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import Bounds, LinearConstraint, milp

from lightopt.errors import InputError
from lightopt.plan import (
    PairWeights,
    added,
    counts_of_images,
    gain_of,
    greedy_cover,
    no_counts,
    reached,
    worth,
)


def random_case(seed, *, postures=7, images=3, patches=9, trials=70, k=2):
    """Images of every posture as flags, plain and packed: two words per patch, the second not full."""
    rng = np.random.default_rng(seed)
    density = rng.random((postures, 1, patches, 1)) * 0.5
    plain = rng.random((postures, images, patches, trials)) < density
    factors = np.array([1, 3], np.int64)
    kind = rng.integers(0, 2, trials)
    words = -(-trials // 64)

    def pack(flags):
        padded = np.zeros((*flags.shape[:-1], 64 * words), bool)
        padded[..., : flags.shape[-1]] = flags
        return np.packbits(padded, axis=-1, bitorder="little").view(np.uint64)

    weights = PairWeights(
        areas=rng.integers(0, 50, patches),
        masks=np.stack([pack(kind == g) for g in range(2)]),
        factors=factors,
    )
    heavy = weights.areas[:, None] * factors[kind]
    packed = [counts_of_images([pack(image) for image in posture], k) for posture in plain]
    return plain.sum(axis=1), packed, weights, heavy


def plain_worth(counts, heavy, k):
    return int((heavy * np.minimum(k, counts)).sum())


def plain_reached(counts, heavy, k):
    return int(heavy[counts >= k].sum())


@pytest.mark.parametrize("k", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_packed_counts_are_the_plain_ones(seed, k):
    plain, packed, weights, heavy = random_case(seed, k=k)
    assert weights.total == heavy.sum()
    total, so_far = no_counts(weights, k), np.zeros_like(plain[0])
    for one, more in zip(plain, packed, strict=True):
        assert worth(more, weights) == plain_worth(one, heavy, k)
        expected = plain_worth(so_far + one, heavy, k) - plain_worth(so_far, heavy, k)
        assert gain_of(total, more, weights) == expected
        total, so_far = added(total, more), so_far + one
        assert worth(total, weights) == plain_worth(so_far, heavy, k)
        assert reached(total, weights) == plain_reached(so_far, heavy, k)


def exact_worth(plain, heavy, k, count):
    """The most that a set of `count` is worth, by integer programming: x_j chosen, y_e ≤ min(k, Σ c_je x_j)."""
    pairs = heavy.size
    counts = np.minimum(plain.reshape(len(plain), pairs), k)
    cost = np.concatenate([np.zeros(len(plain)), -heavy.ravel().astype(float)])
    link = np.hstack([-counts.T, np.eye(pairs)])
    size = np.concatenate([np.ones(len(plain)), np.zeros(pairs)])[None]
    found = milp(
        cost,
        constraints=[LinearConstraint(link, ub=0.0), LinearConstraint(size, ub=count)],
        bounds=Bounds(0.0, np.concatenate([np.ones(len(plain)), np.full(pairs, k)])),
        integrality=np.concatenate([np.ones(len(plain)), np.zeros(pairs)]),
    )
    assert found.success
    return round(-found.fun)


@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize("seed", range(6))
def test_the_bound_holds_against_the_exact_cover(seed, k):
    plain, packed, weights, heavy = random_case(seed, patches=4, trials=12, k=k)
    for count in (1, 2, 3, 4):
        cover = greedy_cover(packed, weights, count=count)
        best = exact_worth(plain, heavy, k, len(cover.steps))
        assert cover.worth <= best <= cover.bound
        assert cover.worth >= cover.guarantee * best
        assert cover.guarantee > 1.0 - 1.0 / math.e
        most = max(
            plain_reached(plain[list(some)].sum(axis=0), heavy, k)
            for some in combinations(range(len(plain)), len(cover.steps))
        )
        assert most <= cover.bound_share * weights.total + 1e-6
        assert cover.reached <= most


def test_one_step_is_the_best_one():
    plain, packed, weights, heavy = random_case(1)
    cover = greedy_cover(packed, weights, count=1)
    assert cover.worth == cover.bound == exact_worth(plain, heavy, 2, 1)
    assert cover.guarantee == 1.0


@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize("seed", range(6))
def test_no_fewer_reach_the_target_than_is_said(seed, k):
    plain, packed, weights, heavy = random_case(seed, patches=4, trials=12, k=k)
    everything = plain_reached(plain.sum(axis=0), heavy, k) / weights.total
    for part in (0.5, 0.8, 1.0):
        target = part * everything
        cover = greedy_cover(packed, weights, target=target)
        assert cover.share >= target - 1e-12
        enough = next(
            size
            for size in range(len(plain) + 1)
            if any(
                plain_reached(plain[list(some)].sum(axis=0), heavy, k) >= target * weights.total
                for some in combinations(range(len(plain)), size)
            )
        )
        assert cover.least is not None
        assert cover.least <= enough <= len(cover.steps)
        for one in cover.chosen:  # none can be spared
            rest = [other for other in cover.chosen if other != one]
            assert plain_reached(plain[rest].sum(axis=0), heavy, k) < target * weights.total


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), k=st.integers(1, 3), count=st.integers(1, 7))
def test_steps_add_up_and_gains_never_grow(seed, k, count):
    plain, packed, weights, heavy = random_case(seed, patches=3, trials=5, k=k)
    cover = greedy_cover(packed, weights, count=count)
    so_far, before = np.zeros_like(plain[0]), 0
    for step in cover.steps:
        so_far = so_far + plain[step.candidate]
        assert step.worth == plain_worth(so_far, heavy, k) == before + step.gain
        assert step.reached == plain_reached(so_far, heavy, k)
        assert step.gain > 0
        before = step.worth
    assert len(set(cover.chosen)) == len(cover.steps) <= count
    assert cover.all_worth == plain_worth(plain.sum(axis=0), heavy, k)
    if len(cover.steps) < count:
        assert cover.worth == cover.all_worth


def flags(*rows):
    """One patch per flag: candidates that see just those patches, in one image each."""
    return [np.array(row, np.uint64).reshape(1, -1, 1) for row in rows]


def unit_weights(patches):
    return PairWeights(
        areas=np.ones(patches, np.int64),
        masks=np.ones((1, 1), np.uint64),
        factors=np.ones(1, np.int64),
    )


def test_what_later_ones_make_redundant_is_dropped():
    # the first sees most, yet the others together see all that it sees and more
    wide = flags([1, 1, 1, 1, 0, 0], [1, 1, 0, 0, 1, 0], [0, 0, 1, 1, 0, 1])
    cover = greedy_cover(wide, unit_weights(6))
    assert cover.chosen == (1, 2)
    assert cover.dropped == (0,)
    assert cover.worth == cover.total == 6
    # dropping makes room for another within the count
    cover = greedy_cover([*wide, *flags([0, 0, 0, 0, 0, 0])], unit_weights(6), count=3)
    assert cover.chosen == (1, 2)


def test_ties_go_to_the_earlier_candidate():
    cover = greedy_cover(flags([1, 0], [0, 1], [1, 0], [0, 1]), unit_weights(2))
    assert cover.chosen == (0, 1)


def test_nothing_to_gain_is_nothing_chosen():
    for among in (None, ()):
        cover = greedy_cover(flags([0, 0], [0, 0]), unit_weights(2), count=1, among=among)
        assert cover.chosen == ()
        assert cover.share == cover.bound_share == 0.0


def test_among_some_the_bound_is_still_that_of_all():
    wide = flags([1, 1, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1])
    cover = greedy_cover(wide, unit_weights(4), count=2, among=(1, 2))
    assert cover.chosen == (1, 2)
    assert cover.bound == 4


def test_a_target_that_cannot_be_reached_is_said_not_to_be():
    cover = greedy_cover(flags([1, 0, 0], [0, 1, 0]), unit_weights(3), target=0.9)
    assert cover.least is None
    assert cover.share == pytest.approx(2 / 3)
    assert cover.all_reached == 2


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [({"count": 0}, "1 or more, found 0"), ({"target": 0.0}, "found 0"), ({"target": 1.5}, "found 1.5")],
)
def test_bad_questions_are_refused(arguments, expected):
    with pytest.raises(InputError, match=expected):
        greedy_cover(flags([1]), unit_weights(1), **arguments)


def test_nothing_to_choose_from_is_refused():
    with pytest.raises(InputError, match="at least one candidate"):
        greedy_cover([], unit_weights(1))
