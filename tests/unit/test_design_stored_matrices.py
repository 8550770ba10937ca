"""Luminance matrices on disk: what is read is what was written, or nothing."""

from __future__ import annotations

import numpy as np
import pytest

from lightopt.design import LuminanceMatrix
from lightopt.design.responses._posture_matrices import read_matrix, write_matrix


@pytest.fixture
def kept(tmp_path):
    rng = np.random.default_rng(0)
    levels = tuple(rng.integers(0, 256, (n, 40)).astype(np.uint8) for n in (2, 3))
    matrix = LuminanceMatrix(levels=levels, areas=rng.random(40))
    path = tmp_path / "matrix.npz"
    write_matrix(path, matrix, [[(30.0, 5.0 * k) for k in range(n)] for n in (2, 3)], key="a key")
    return path, matrix


def same(found, matrix):
    return all(
        np.array_equal(a, b) for a, b in zip((*found.levels, found.areas), (*matrix.levels, matrix.areas), strict=True)
    )


def test_what_is_read_is_what_was_written(kept):
    path, matrix = kept
    found = read_matrix(path, key="a key", lights=2)
    assert found is not None
    assert same(found, matrix)
    assert read_matrix(path, key="another", lights=2) is None
    assert read_matrix(path, key="a key", lights=3) is None
    assert read_matrix(path.with_name("none.npz"), key="a key", lights=2) is None


@pytest.mark.slow
def test_any_flipped_bit_gives_the_matrix_or_none(kept):
    path, matrix = kept
    whole = path.read_bytes()
    rng = np.random.default_rng(1)
    lost = 0
    for place in rng.integers(0, 8 * len(whole), 3000):
        damaged = bytearray(whole)
        damaged[place // 8] ^= 1 << int(place % 8)
        path.write_bytes(damaged)
        found = read_matrix(path, key="a key", lights=2)
        lost += found is None
        assert found is None or same(found, matrix)
    assert lost > 1500


def test_any_part_of_a_file_gives_none(kept):
    path, _ = kept
    whole = path.read_bytes()
    for end in range(0, len(whole), 7):
        path.write_bytes(whole[:end])
        assert read_matrix(path, key="a key", lights=2) is None
