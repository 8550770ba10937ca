"""How many threads there are to use, and work spread over them."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any, TypeVar

__all__ = ["Task", "available_processors", "in_threads", "run_all"]

T = TypeVar("T")
Task = tuple[Callable[..., None], tuple[Any, ...]]
"""A function and its arguments."""


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


def run_all(tasks: Iterable[Task], *, threads: int, done: Callable[[], None] | None = None) -> None:
    """Call each task's function with its arguments; the first exception stops the rest.

    Parameters
    ----------
    tasks
        Taken up as threads become free, so that a long generator costs no memory.
    threads
        Number of threads.
    done
        Called from the calling thread after each task; an exception that it raises stops the rest, too.
    """
    waiting_tasks = iter(tasks)
    with ThreadPoolExecutor(threads) as pool:
        running: set[Future[None]] = set()
        try:
            while True:
                for function, arguments in itertools.islice(waiting_tasks, 2 * threads - len(running)):
                    running.add(pool.submit(function, *arguments))
                if not running:
                    return
                finished, running = wait(running, return_when=FIRST_COMPLETED)
                for future in finished:
                    future.result()
                    if done is not None:
                        done()
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
