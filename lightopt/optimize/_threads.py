"""A pool of threads over many small tasks, few of them waiting at a time."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any

__all__ = ["run_all"]

Task = tuple[Callable[..., None], tuple[Any, ...]]


def run_all(tasks: Iterable[Task], *, threads: int, done: Callable[[], None] | None = None) -> None:
    """Call each task's function with its arguments; the first exception stops the rest.

    Parameters
    ----------
    tasks
        Taken up as threads become free, so that a long generator costs no memory.
    threads
        Number of threads.
    done
        Called from the calling thread after each task.
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
