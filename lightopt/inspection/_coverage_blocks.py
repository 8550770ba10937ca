"""The coverage of a posture, block of rows by block of rows: small arrays stay in a processor's cache."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from lightopt.core.threads import in_threads
from lightopt.inspection._coverage import Coverage, measure_coverage
from lightopt.inspection._deviation import Deviations
from lightopt.inspection._filter import BLOCK_ROWS, row_blocks
from lightopt.inspection._posture_view import PostureView


def coverage_in_blocks(
    view: PostureView, found: Deviations, *, seen_by: int, high: float, threads: int | None = None
) -> Coverage:
    """The surface of a posture that was inspected, as :func:`measure_coverage` tells it.

    Parameters
    ----------
    view, found, seen_by, high
        As that takes them.
    threads
        Number of threads; the result does not depend on it.
    """

    def block(top: int) -> Coverage:
        rows = slice(top, top + BLOCK_ROWS)
        z, scale = found.z[:, rows], found.scale[:, rows]
        mine = Deviations(z, scale, found.usable[:, rows], found.lit[:, rows])
        return measure_coverage(view.in_rows(rows), mine, seen_by=seen_by, high=high)

    return _joined(in_threads(block, row_blocks(len(view.clean)), threads))


def _joined(parts: Sequence[Coverage]) -> Coverage:
    # areas add up, images stand one below the other
    def joined(own: Sequence[Any]) -> Any:
        if isinstance(own[0], np.ndarray):
            return np.concatenate(own)
        if isinstance(own[0], dict):
            return {key: sum(each[key] for each in own) for key in own[0]}
        return sum(own)

    names = [field.name for field in fields(Coverage)]
    return Coverage(**{name: joined([getattr(part, name) for part in parts]) for name in names})
