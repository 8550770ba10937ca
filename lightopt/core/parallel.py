"""Independent tasks, spread over the threads of this process, or over other processes where a run has some."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

from lightopt.core.run_context import Share, WorkCounter
from lightopt.core.threads import available_processors, run_all

S = TypeVar("S")
T = TypeVar("T")


class ProcessPool(Protocol):
    """Other processes, on this machine or elsewhere. They have no state of their own: a task may run twice."""

    def spread(
        self,
        function: Callable[..., T],
        items: Sequence[Any],
        keep: Callable[[int, T], None],
        *shared: Any,
        report: Share | None,
    ) -> None:
        """As :func:`spread`. The function is of a module; items and results are pickled, and small."""
        ...


def spread(
    function: Callable[..., T],
    items: Sequence[S],
    keep: Callable[[int, T], None],
    *shared: Any,
    pool: ProcessPool | None,
    threads: int | None = None,
    report: Share | None = None,
) -> None:
    """Call ``function(item, *shared)`` for each item, and `keep` with its place and the result, in any order.

    pool: Other processes; the threads of this one where it is None
    shared: What is the same for all items; a process of the pool gets it once
    report: Called with the share that is done
    """
    if pool is not None:
        pool.spread(function, items, keep, *shared, report=report)
        return
    work = WorkCounter(len(items), report)

    def one(place: int, item: S) -> None:
        keep(place, function(item, *shared))
        work.add(1)

    tasks = ((one, pair) for pair in enumerate(items))
    run_all(tasks, threads=threads or available_processors(), done=work.report)
