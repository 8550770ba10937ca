"""How many threads there are to use, and work spread over them."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

__all__ = ["available_processors", "in_threads"]

T = TypeVar("T")


def available_processors() -> int:
    """Processors that this process may use, which batch systems and containers restrict, where that can be told."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_threads(work: Callable[[int], T], starts: Sequence[int], threads: int | None = None) -> list[T]:
    """Results of a function of pieces' starts, in order, worked out by a pool of threads."""
    count = threads or available_processors()
    if count == 1 or len(starts) < 2:
        return [work(start) for start in starts]
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(work, starts))
