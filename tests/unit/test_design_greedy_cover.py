"""Greedy cover: counts and gains as a plain reading of them, bounds never violated by the exact cover (MILP)."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.optimize import Bounds, LinearConstraint, milp

from lightopt.core.transforms import Posture
from lightopt.design.postures._cover_search import best_set, greedy_cover, improve_by_exchange
from lightopt.design.postures._exposures import CandidateExposure, select_exposures
from lightopt.design.responses._pairs import PairWeights, add_counts


def random_case(seed, *, postures=7, images=3, patches=9, trials=70, k=2, units=1):
    """Units by images of every posture, plain and packed: two words per patch, the second not full."""
    rng = np.random.default_rng(seed)
    density = rng.random((postures, 1, patches, 1)) * 0.5
    plain = (rng.random((postures, images, patches, trials)) < density) * rng.integers(
        1, units + 1, (postures, images, patches, trials)
    )
    factors = np.array([1, 3], np.int64)
    kind = rng.integers(0, 2, trials)
    words = -(-trials // 64)

    def pack(flags):
        padded = np.zeros((*flags.shape[:-1], 64 * words), bool)
        padded[..., : flags.shape[-1]] = flags
        return np.packbits(padded, axis=-1, bitorder="little").view(np.uint64)

    weights = PairWeights(
        areas=rng.integers(0, 50, patches), masks=np.stack([pack(kind == g) for g in range(2)]), factors=factors
    )
    heavy = weights.areas[:, None] * factors[kind]
    packed = [
        weights.sum_counts((np.stack([pack(image > j) for j in range(units)]) for image in posture), k)
        for posture in plain
    ]
    return plain.sum(axis=1), packed, weights, heavy


def plain_worth(counts, heavy, k):
    return int((heavy * np.minimum(k, counts)).sum())


def plain_reached(counts, heavy, k):
    return int(heavy[counts >= k].sum())


@pytest.mark.parametrize(("k", "units"), [(1, 1), (2, 1), (3, 1), (3, 3), (4, 3), (8, 3)])
@pytest.mark.parametrize("seed", range(4))
def test_packed_counts_are_the_plain_ones(seed, k, units):
    plain, packed, weights, heavy = random_case(seed, k=k, units=units)
    assert weights.total == heavy.sum()
    total, so_far = weights.zero_counts(k), np.zeros_like(plain[0])
    for one, more in zip(plain, packed, strict=True):
        assert weights.benefit(more) == plain_worth(one, heavy, k)
        expected = plain_worth(so_far + one, heavy, k) - plain_worth(so_far, heavy, k)
        assert weights.gains(total, more)[1] == expected
        total, so_far = add_counts(total, more), so_far + one
        assert weights.benefit(total) == plain_worth(so_far, heavy, k)
        assert weights.covered(total) == plain_reached(so_far, heavy, k)


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
        cover = greedy_cover(packed, weights, count=count, threads=1)
        assert cover == greedy_cover(packed, weights, count=count, threads=3)
        best = exact_worth(plain, heavy, k, len(cover.steps))
        assert cover.benefit <= best <= cover.bounds[-1]
        size = len(cover.steps)
        least = 1.0 - (1.0 - 1.0 / size) ** size  # what a greedy choice has whatever the candidates
        assert cover.benefit >= least * cover.bounds[-1] >= least * best
        assert least > 1.0 - 1.0 / math.e
        most = max(
            plain_reached(plain[list(some)].sum(axis=0), heavy, k)
            for some in combinations(range(len(plain)), len(cover.steps))
        )
        assert most <= cover.bound_share * weights.total + 1e-6
        assert cover.guarantee * most - 1e-6 <= cover.covered <= most
        assert cover.proven <= (cover.covered == most)


def test_one_step_is_the_best_one():
    plain, packed, weights, heavy = random_case(1)
    cover = greedy_cover(packed, weights, count=1)
    assert cover.benefit == cover.bounds[-1] == exact_worth(plain, heavy, 2, 1)


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
        assert cover.min_size is not None
        assert cover.min_size <= enough <= len(cover.steps)
        for one in cover.chosen:  # none can be spared
            rest = [other for other in cover.chosen if other != one]
            assert plain_reached(plain[rest].sum(axis=0), heavy, k) < target * weights.total


@given(seed=st.integers(0, 10_000), k=st.integers(1, 3), count=st.integers(1, 7))
def test_steps_add_up_and_gains_never_grow(seed, k, count):
    plain, packed, weights, heavy = random_case(seed, patches=3, trials=5, k=k)
    cover = greedy_cover(packed, weights, count=count)
    so_far, before = np.zeros_like(plain[0]), 0
    for step in cover.steps:
        so_far = so_far + plain[step.candidate]
        assert step.benefit == plain_worth(so_far, heavy, k) == before + step.gain
        assert step.covered == plain_reached(so_far, heavy, k)
        assert step.gain > 0
        before = step.benefit
    assert len(set(cover.chosen)) == len(cover.steps) <= count
    assert cover.all_benefit == plain_worth(plain.sum(axis=0), heavy, k)
    if len(cover.steps) < count:
        assert cover.benefit == cover.all_benefit


def flags(*rows):
    """One patch per flag: candidates that see just those patches, in one image each."""
    return [np.array(row, np.uint64).reshape(1, -1, 1) for row in rows]


def unit_weights(patches):
    return PairWeights(areas=np.ones(patches, np.int64), masks=np.ones((1, 1), np.uint64), factors=np.ones(1, np.int64))


def test_what_later_ones_make_redundant_is_dropped():
    # the first sees most, yet the others together see all that it sees and more
    wide = flags([1, 1, 1, 1, 0, 0], [1, 1, 0, 0, 1, 0], [0, 0, 1, 1, 0, 1])
    cover = greedy_cover(wide, unit_weights(6))
    assert cover.chosen == (1, 2)
    assert 0 not in cover.chosen
    assert cover.benefit == cover.total == 6
    # dropping makes room for another within the count
    cover = greedy_cover([*wide, *flags([0, 0, 0, 0, 0, 0])], unit_weights(6), count=3)
    assert cover.chosen == (1, 2)


@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize("seed", range(4))
def test_no_single_exchange_betters_what_exchanges_leave(seed, k):
    plain, packed, weights, heavy = random_case(seed, postures=9, patches=5, trials=20, k=k)

    def merit(some):
        counts = plain[list(some)].sum(axis=0)
        return plain_reached(counts, heavy, k), plain_worth(counts, heavy, k)

    greedy = greedy_cover(packed, weights, count=3).chosen
    for begin in (greedy, (6, 7, 8)):
        found = improve_by_exchange(packed, weights, begin, threads=2)
        assert len(set(found)) == 3
        assert found == improve_by_exchange(packed, weights, begin, threads=1)
        assert merit(found) >= merit(begin)
        for place, other in product(range(3), set(range(9)) - set(found)):
            assert merit([*found[:place], other, *found[place + 1 :]]) <= merit(found)


def test_an_exchange_takes_back_what_greed_chose_first():
    wide = flags([1, 1, 1, 1, 0, 0], [1, 1, 0, 0, 1, 0], [0, 0, 1, 1, 0, 1], [0, 0, 0, 0, 0, 1])
    greedy = greedy_cover(wide, unit_weights(6), count=2)
    assert greedy.chosen == (0, 1)
    assert set(improve_by_exchange(wide, unit_weights(6), greedy.chosen)) == {1, 2}
    assert improve_by_exchange(wide, unit_weights(6), ()) == ()


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
    assert cover.bounds[-1] == 4


def test_a_target_that_cannot_be_reached_is_said_not_to_be():
    cover = greedy_cover(flags([1, 0, 0], [0, 1, 0]), unit_weights(3), target=0.9)
    assert cover.min_size is None
    assert cover.share == pytest.approx(2 / 3)
    assert cover.all_covered == 2


def offered(*areas, images):
    """Weights of patches with one trial each, and images of one light as lists of the patches that it shows."""
    weights = PairWeights(
        areas=np.array(areas, np.int64), masks=np.ones((1, 1), np.uint64), factors=np.ones(1, np.int64)
    )
    return weights, [np.isin(np.arange(len(areas)), some)[None, None, :, None].astype(np.uint64) for some in images]


@pytest.mark.parametrize(
    ("least_gain", "target", "why"),
    [(0.05, None, "pair"), (0.06, None, None), (0.06, 0.1, "target"), (0.0, None, "pair")],
)
def test_two_exposures_that_only_together_show_enough_are_planned(least_gain, target, why):
    # neither posture shows patch 0 at exposure 1, both do at 1/4; patch 1 is seen once at 1/16, whatever else
    weights, (dark, short, shorter) = offered(100, 500, 400, images=[[], [0], [1]])
    postures = [Posture(0.0, 0.0), Posture(0.0, 90.0)]
    offers = [
        CandidateExposure(posture=0, exposure=0.0625, images=shorter),
        CandidateExposure(posture=0, exposure=0.25, images=short),
        CandidateExposure(posture=1, exposure=0.25, images=short),
    ]
    found = select_exposures(postures, [dark, dark], offers, weights, needed=2, least_gain=least_gain, target=target)
    planned = [(shot.posture, shot.exposure, shot.gain, shot.reason) for shot in found.further if shot.reason]
    assert planned == ([(postures[0], 0.25, 0.0, why), (postures[1], 0.25, 0.1, why)] if why else [])
    assert found.after == (0.1 if why else 0.0)


@pytest.mark.parametrize("seed", range(12))
def test_no_other_two_exposures_add_more_together(seed):
    rng = np.random.default_rng(seed)
    patches, lights, postures = 40, 2, [Posture(0.0, 90.0 * i) for i in range(3)]
    weights, _ = offered(*map(int, rng.integers(1, 50, patches)), images=[])

    def images(density):
        units = rng.integers(1, 4, (lights, 1, patches, 1)) * (rng.random((lights, 1, patches, 1)) < density)
        return (units > np.arange(3)[:, None, None]).astype(np.uint64)

    least = int(rng.integers(1, 6))
    now = [images(0.05) for _ in postures]
    offers = [CandidateExposure(posture=i % 3, exposure=0.5**i, images=images(0.08)) for i in range(1, 8)]

    def shown(some):
        taken = list(now)
        for i in some:
            taken[offers[i].posture] = taken[offers[i].posture] | offers[i].images
        return int(weights.areas[np.sum(taken, axis=(0, 1, 2))[:, 0] >= least].sum())

    before = shown([])
    alone = max(shown([i]) for i in range(len(offers))) - before
    two = max(shown(some) for some in combinations(range(len(offers)), 2)) - before
    # more than any adds alone, and as much as two have to
    for least_gain in (0.5 * two / weights.total, 0.5 * (two + 1) / weights.total):
        found = select_exposures(postures, now, offers, weights, needed=least, least_gain=least_gain)
        planned = [shot for shot in found.further if shot.reason]
        if alone >= max(1.0, least_gain * weights.total):
            assert planned[0].reason == "gain"
        elif two > 0 and two >= 2.0 * least_gain * weights.total:
            assert least > 1
            assert [shot.reason for shot in planned[:2]] == ["pair", "pair"]
            assert (planned[0].gain + planned[1].gain) * weights.total == pytest.approx(two)
        else:
            assert planned == []


@pytest.mark.parametrize("k", [1, 2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_the_best_of_all_sets_is_that_of_brute_force_and_never_worse_than_the_greedy_choice(seed, k):
    plain, packed, weights, heavy = random_case(seed, postures=8, patches=5, trials=40, k=k)
    for count in (1, 2, 3, 4):
        start = greedy_cover(packed, weights, count=count).chosen
        found, most, sets = best_set(packed, weights, start, count)
        every = {
            some: plain_reached(plain[list(some)].sum(axis=0), heavy, k)
            for some in combinations(range(len(plain)), count)
        }
        assert sets == len(every) == math.comb(8, count)
        assert most == max(every.values())
        assert every[tuple(sorted(found))] == max(every.values())
        assert every[tuple(sorted(found))] >= plain_reached(plain[list(start)].sum(axis=0), heavy, k)
        assert best_set(packed, weights, start, count, threads=1) == (found, most, sets)
        # where greed was right it is kept
        if plain_reached(plain[list(start)].sum(axis=0), heavy, k) == max(every.values()):
            assert found == start


def test_a_search_of_all_sets_that_is_too_much_work_proves_nothing():
    _, packed, weights, _ = random_case(3, postures=8, k=1)
    start = greedy_cover(packed, weights, count=3).chosen
    found, _, sets = best_set(packed, weights, start, 3, most_work=packed[0].size * 8)
    assert sets is None
    assert len(found) == 3


def test_greed_misses_what_all_sets_show():
    # the first candidate shows most alone; the other two show more together
    images = [[0, 1, 2, 3, 8], [0, 1, 4, 5], [2, 3, 6, 7]]
    packed = [np.array([[[sum(1 << bit for bit in one)]]], np.uint64) for one in images]
    weights = PairWeights(areas=np.ones(1, np.int64), masks=np.array([[511]], np.uint64), factors=np.ones(1, np.int64))
    greedy = greedy_cover(packed, weights, count=2)
    assert (greedy.chosen, greedy.covered, greedy.proven) == ((0, 1), 7, False)
    found, most, sets = best_set(packed, weights, greedy.chosen, 2)
    assert (sorted(found), most, sets) == ([1, 2], 8, 3)
    best = replace(greedy_cover(packed, weights, count=2, among=found), sets=sets, max_covered=most)
    assert (best.covered, best.proven) == (8, True)
    assert best.bound_share == best.share
    assert best.guarantee == 1.0
