"""What a pixel's mean keeps of a defect: closed forms, and the median over all places on the pixel grid."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lightopt.defects import PIXEL_RATIOS, DefectShape, pixel_shares
from lightopt.defects._pixel_shares import grid_shares

SLOPE = math.radians(10.0)


def shape(kind, length=1.0):
    if kind == "stain":
        return DefectShape(kind=kind, length=length, width=1.0, R_d_factor=0.7)
    return DefectShape(kind=kind, length=length, width=1.0, slope=SLOPE)


def at(table, ratio):
    return [np.interp(math.log(ratio), np.log(PIXEL_RATIOS), column) for column in table.T]


@pytest.mark.parametrize("ratio", [0.5, 0.7, 1.0, 2.0, 4.0])
def test_a_pixel_whose_border_lies_along_a_groove_sees_one_wall(ratio):
    """The mean slope across a pixel is the difference in height of its borders over its side: 0.8 · w/2 · tan here."""
    one, area, _, _ = grid_shares(shape("scratch", 40.0), ratio, turn=0.0, offset=(0.0, 0.5))
    assert one == pytest.approx(0.4 / ratio, rel=0.02)
    # 0.6 of a wall has the full slope, over 0.2 at each end it falls to nought: 0.6 + 2 · 0.2 / 3 of its square
    assert area == pytest.approx(0.5 * (0.6 + 0.4 / 3) / ratio, rel=0.02)


@pytest.mark.parametrize("ratio", [1.0, 2.0, 4.0])
def test_a_pixel_that_has_both_walls_sees_only_what_they_have_in_common(ratio):
    one, _, most, all_of_it = grid_shares(shape("scratch", 40.0), ratio, turn=0.0, offset=(0.0, 0.0))
    assert one == most == pytest.approx(0.0, abs=1e-12)
    assert all_of_it == pytest.approx((0.6 + 0.4 / 3) / ratio, rel=0.02)


def test_a_stain_has_the_share_of_the_pixel_that_it_covers():
    for ratio in (1.5, 2.0, 3.0):
        shares = grid_shares(shape("stain"), ratio, turn=0.3, offset=(0.1, 0.1))
        assert shares == pytest.approx([0.25 * math.pi / ratio**2] * 4, rel=0.03)


@pytest.mark.parametrize("kind", ["scratch", "dent", "bump", "pit", "blister", "stain"])
def test_large_defects_fill_the_pixel_and_small_ones_less_the_smaller_they_are(kind):
    table = pixel_shares(shape(kind, 1.0))
    assert (table >= 0.0).all()
    assert (table <= 1.0).all()
    # a blister's wall is a fifth of its width
    assert table[0, [0, 3]].min() > 0.97
    assert table[-1].max() < 0.03
    for column in (table[:, 0], table[:, 3]):
        assert (np.diff(column) < 0.02).all()


@pytest.mark.parametrize("kind", ["scratch", "dent", "pit", "blister", "stain"])
def test_the_grid_stands_for_all_places_and_turns_of_a_defect(kind):
    rng = np.random.default_rng(0)
    own = shape(kind, 20.0 if kind == "scratch" else 1.0)
    table = pixel_shares(own)
    for ratio in (0.17, 0.3, 0.5, 0.7, 1.0, 2.0, 3.0):
        drawn = [
            grid_shares(own, ratio, turn=rng.uniform(0, 2 * math.pi), offset=tuple(rng.random(2))) for _ in range(150)
        ]
        one, _, _, most = np.median(drawn, axis=0)
        expected = at(table, ratio)
        assert expected[0] == pytest.approx(one, abs=0.08)
        assert expected[3] == pytest.approx(most, abs=0.08)
