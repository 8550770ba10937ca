"""Area and perimeter of saturated regions against shapes whose border is known."""

from __future__ import annotations

import numpy as np
import pytest

from lightopt.optics import saturated_region


def test_disc() -> None:
    y, x = np.mgrid[0:200, 0:240] + 0.5
    levels = 255.0 + 60.0 - np.hypot(x - 120.3, y - 99.1)
    region = saturated_region(levels, 255.0)
    assert region.area == pytest.approx(np.pi * 60.0**2, rel=2e-3)
    assert region.perimeter == pytest.approx(2.0 * np.pi * 60.0, rel=1e-3)


@pytest.mark.parametrize("angle", np.radians([0.0, 17.0, 45.0]))
def test_square_at_any_angle(angle: float) -> None:
    y, x = np.mgrid[0:200, 0:220] + 0.5
    u = (x - 110.3) * np.cos(angle) + (y - 99.6) * np.sin(angle)
    v = (y - 99.6) * np.cos(angle) - (x - 110.3) * np.sin(angle)
    region = saturated_region(255.0 + 40.0 - np.maximum(np.abs(u), np.abs(v)), 255.0)
    # the line between pixel centres cuts each of the four corners short by up to half a pixel
    assert region.perimeter == pytest.approx(8 * 40.0, abs=2.0)
    assert region.area == pytest.approx(80.0**2, rel=0.02)


def test_none_all_and_one_pixel() -> None:
    dark = np.zeros((5, 6))
    assert saturated_region(dark, 255.0).area == 0
    assert saturated_region(dark, 255.0).perimeter == 0.0
    one = dark.copy()
    one[2, 3] = 510.0
    region = saturated_region(one, 255.0)
    assert region.area == 1
    assert region.perimeter == pytest.approx(4 * np.hypot(0.5, 0.5))
    # two pixels that touch at a corner have a border of their own each
    one[3, 4] = 510.0
    assert saturated_region(one, 255.0).area == 2
    assert saturated_region(one, 255.0).perimeter == pytest.approx(8 * np.hypot(0.5, 0.5))
