"""Which combinations of candidate positions are allowed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from lightopt.core.arrays import Bool, Int64

Rows = tuple[Int64, ...]  # candidates of each light, ascending: all their combinations are meant


def _no_clashes() -> Mapping[tuple[int, int], Bool]:
    return {}


@dataclass(frozen=True, kw_only=True)
class CombinationSpace:
    """The combinations to search.

    sizes: Number of candidates per light.
    groups: Disjoint sets of combinations; together they are the space. Lights that move independently make one group.
    clashes: For pairs of lights (i, j), i < j: which of their candidates collide, shape (sizes[i], sizes[j]).
    """

    sizes: tuple[int, ...]
    groups: tuple[Rows, ...]
    clashes: Mapping[tuple[int, int], Bool] = field(default_factory=_no_clashes)

    @staticmethod
    def of(sizes: Sequence[int]) -> CombinationSpace:
        return CombinationSpace(sizes=tuple(sizes), groups=(tuple(np.arange(n) for n in sizes),))


def is_allowed(space: CombinationSpace, combination: Sequence[int]) -> bool:
    """Whether one combination, a candidate of each light, belongs to the space."""
    if any(clash[combination[i], combination[j]] for (i, j), clash in space.clashes.items()):
        return False
    return any(all(k in row for k, row in zip(combination, rows, strict=True)) for rows in space.groups)


def allowed_mask(space: CombinationSpace, rows: Rows) -> Bool | None:
    """Which combinations of `rows` have no clash, the last light's varying fastest; None where all are allowed."""
    mask: Bool | None = None
    sizes = [len(r) for r in rows]
    for (i, j), clash in space.clashes.items():
        some = clash[np.ix_(rows[i], rows[j])]
        if some.any():
            if mask is None:
                mask = np.ones(math.prod(sizes), np.bool_)
            between, after = math.prod(sizes[i + 1 : j]), math.prod(sizes[j + 1 :])
            pairs = mask.reshape(-1, sizes[i], between, sizes[j], after)
            pairs &= ~some[:, None, :, None]
    return mask
