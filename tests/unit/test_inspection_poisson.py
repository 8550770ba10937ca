"""An image comes back from its gradients, whatever the mask; and is the minimum that a direct solver finds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve

from lightopt.core.errors import LightoptError
from lightopt.inspection.fusion._poisson import poisson_grid


def picture(rows, columns, seed=0):
    y, x = np.mgrid[:rows, :columns]
    return 100 * np.sin(x / 9) * np.cos(y / 7) + 0.3 * x + np.random.default_rng(seed).normal(0, 3, (rows, columns))


def masks():
    rows, columns = 61, 83
    y, x = np.mgrid[:rows, :columns]
    disc = (x - 40) ** 2 / 35**2 + (y - 30) ** 2 / 27**2 < 1
    holed = disc & ~((x - 35) ** 2 + (y - 28) ** 2 < 49) & (abs(x - 55) > 1)
    maze = (x % 6 != 0) | (y % 17 == 3)
    dust = np.random.default_rng(4).random((rows, columns)) < 0.55
    corner = np.zeros((rows, columns), bool)
    corner[-9:, -5:] = True
    line = np.zeros((rows, columns), bool)
    line[20, 3:70] = True
    return {
        "all": np.ones((rows, columns), bool),
        "disc": disc,
        "holes and pieces": holed,
        "maze": maze,
        "dust": dust,
        "corner": corner,
        "line": line,
        "nothing": np.zeros((rows, columns), bool),
    }


@pytest.mark.parametrize("name", masks())
@pytest.mark.parametrize("weighted", [False, True])
def test_an_integrable_field_gives_its_image(name, weighted):
    mask, image = masks()[name], picture(61, 83)
    gx, gy = np.diff(image, axis=1), np.diff(image, axis=0)
    rng = np.random.default_rng(1)
    wx, wy = (10 ** rng.uniform(-2, 0, g.shape) if weighted else np.ones(g.shape) for g in (gx, gy))
    found = poisson_grid(mask, wx, wy).integrate(gx, gy, level=image)
    assert np.abs(found - np.where(mask, image, 0.0)).max() <= 1e-6


def test_any_field_gives_the_least_squares_image_of_a_direct_solver():
    mask = masks()["holes and pieces"]
    rng = np.random.default_rng(2)
    gx, gy = rng.normal(0, 5, (61, 82)), rng.normal(0, 5, (60, 83))
    wx, wy = rng.uniform(0.01, 1, gx.shape), rng.uniform(0.01, 1, gy.shape)
    grid = poisson_grid(mask, wx, wy)
    found = grid.integrate(gx, gy, level=np.zeros(mask.shape))
    number = np.full(mask.shape, -1)
    number[mask] = np.arange(mask.sum())
    start, end, w, g = (
        np.concatenate(pair)
        for pair in (
            (number[:, :-1].ravel(), number[:-1].ravel()),
            (number[:, 1:].ravel(), number[1:].ravel()),
            (wx.ravel(), wy.ravel()),
            (gx.ravel(), gy.ravel()),
        )
    )
    inside = (start >= 0) & (end >= 0)
    start, end, w, g = start[inside], end[inside], w[inside], g[inside]
    edges, n = np.arange(len(w)), int(mask.sum())
    d = sparse.csr_matrix(
        (np.concatenate([-np.ones(len(w)), np.ones(len(w))]), (np.tile(edges, 2), np.concatenate([start, end]))),
        (len(w), n),
    )
    laplace = (d.T @ sparse.diags(w) @ d + 1e-12 * sparse.identity(n)).tocsc()
    direct = np.zeros(mask.shape)
    direct[mask] = spsolve(laplace, d.T @ (w * g))
    label, count = ndimage.label(mask)
    for piece in range(1, count + 1):
        mine = label == piece
        assert abs(found[mine].mean()) < 1e-9
        assert np.abs(found[mine] - (direct[mine] - direct[mine].mean())).max() < 1e-5


def test_pieces_take_their_level_each():
    mask = np.ones((8, 9), bool)
    mask[:, 4] = False
    level = np.where(np.arange(9) < 4, 10.0, 70.0) * np.ones((8, 1))
    grid = poisson_grid(mask, np.ones((8, 8)), np.ones((7, 9)))
    assert grid.count == 2
    found = grid.integrate(np.zeros((8, 8)), np.zeros((7, 9)), level=level)
    assert np.allclose(found, np.where(mask, level, 0.0))


def test_what_is_not_a_number_is_not_integrated_in_silence():
    gx = np.zeros((4, 3))
    gx[1, 1] = np.nan
    with pytest.raises(LightoptError, match="gradient"):
        poisson_grid(np.ones((4, 4), bool), np.ones((4, 3)), np.ones((3, 4))).integrate(
            gx, np.zeros((3, 4)), level=np.zeros((4, 4))
        )
