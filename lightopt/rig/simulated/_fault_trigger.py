"""When a fault strikes: by count or by seeded chance, so that a failed test can be run again."""

from __future__ import annotations

import random
from collections.abc import Mapping
from typing import Any


class Trigger:
    """Decides at each occasion whether a fault strikes.

    Parameters
    ----------
    after
        Occasions that pass unharmed first.
    count
        Occasions that it strikes; None: all that follow.
    probability
        Chance that it strikes at an occasion that `after` and `count` leave to it.
    seed
        Seed of the chance.

    Raises
    ------
    ValueError
        For numbers out of range.
    """

    struck = 0
    """How often faults struck in this process, those of all triggers together."""

    def __init__(
        self, *, after: int = 0, count: int | None = 1, probability: float = 1.0, seed: int = 0
    ) -> None:
        if after < 0 or (count is not None and count < 1) or not 0 <= probability <= 1:
            raise ValueError("after counts from 0, count from 1, and probability lies between 0 and 1")
        self._after = after
        self._left = count
        self._probability = probability
        self._random = random.Random(seed)  # noqa: S311  (chance of a fault, not a secret)

    @property
    def spent(self) -> bool:
        """Whether it will never strike again."""
        return self._left == 0

    def strikes(self) -> bool:
        """Whether the fault strikes at this occasion."""
        if self._after > 0:
            self._after -= 1
            return False
        if self.spent or self._random.random() >= self._probability:
            return False
        if self._left is not None:
            self._left -= 1
        Trigger.struck += 1
        return True


def trigger(fault: str, options: Mapping[str, Any]) -> Trigger:
    """Trigger of a fault from the options of a request; a ValueError names the fault."""
    try:
        return Trigger(**options)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{fault}: {error}") from None
