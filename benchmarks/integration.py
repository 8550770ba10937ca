"""Integrating gradients over an odd mask: multigrid against a direct solver; ``python -m benchmarks.integration``."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from lightopt.inspection.fusion._poisson import poisson_grid

SIZES = ((300, 400), (600, 800), (1200, 1600))
LARGEST_DIRECT = 600
"""Rows of the largest image that the direct solver gets: beyond, it takes minutes."""


def case(rows: int, columns: int) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """A disc with a hole and a slit, and an image."""
    y, x = np.mgrid[:rows, :columns]
    mask = np.hypot((x - columns / 2) / columns, (y - rows / 2) / rows) < 0.48
    mask &= np.hypot(x - 0.4 * columns, y - 0.5 * rows) > 0.1 * rows
    mask &= np.abs(x - 0.7 * columns) > 2
    noise = np.random.default_rng(0).normal(0.0, 3.0, (rows, columns))
    return mask, 100.0 * np.sin(x / 40.0) * np.cos(y / 31.0) + noise


def direct(mask: NDArray[np.bool_], gx: NDArray[np.float64], gy: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same least squares by factorisation; the first pixel of the mask is held at 0."""
    number = np.full(mask.shape, -1)
    number[mask] = np.arange(mask.sum())
    start = np.concatenate([number[:, :-1].ravel(), number[:-1].ravel()])
    end = np.concatenate([number[:, 1:].ravel(), number[1:].ravel()])
    g = np.concatenate([gx.ravel(), gy.ravel()])
    inside = (start >= 0) & (end >= 0)
    start, end, g = start[inside], end[inside], g[inside]
    edges = np.arange(len(g))
    values = np.concatenate([-np.ones(len(g)), np.ones(len(g))])
    places = np.tile(edges, 2), np.concatenate([start, end])
    d = sparse.csr_matrix((values, places), (len(g), int(mask.sum())))
    # pieces of the mask have no level: a trace of one for all keeps the matrix regular
    laplace = (d.T @ d + 1e-9 * sparse.identity(d.shape[1])).tocsc()
    result = np.zeros(mask.shape)
    result[mask] = spsolve(laplace, d.T @ g)
    return result


def main() -> None:
    warm, image = case(40, 50)
    poisson_grid(warm, np.ones((40, 49)), np.ones((39, 50))).integrate(
        np.diff(image, axis=1), np.diff(image, axis=0), level=image
    )
    print("| image | multigrid, CPU s | direct, CPU s | ratio | greatest error |\n|---|---|---|---|---|")
    for rows, columns in SIZES:
        mask, image = case(rows, columns)
        gx, gy = np.diff(image, axis=1), np.diff(image, axis=0)
        times: list[float] = []
        found = np.zeros_like(image)
        for _ in range(3):
            begun = time.process_time()
            grid = poisson_grid(mask, np.ones_like(gx), np.ones_like(gy))
            found = grid.integrate(gx, gy, level=image)
            times.append(time.process_time() - begun)
        error = np.abs(found - image)[mask].max()
        cells = "-", "-"
        if rows <= LARGEST_DIRECT:
            begun = time.process_time()
            direct(mask, gx, gy)
            slow = time.process_time() - begun
            cells = f"{slow:.2f}", f"{slow / min(times):.0f}"
        print(f"| {columns} × {rows} | {min(times):.2f} | {cells[0]} | {cells[1]} | {error:.1e} |", flush=True)


if __name__ == "__main__":
    main()
