"""How many threads there are to use, and work spread over them, which ends soon where it is stopped."""

import itertools
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from queue import SimpleQueue
from threading import Event
from typing import Any, TypeVar

S = TypeVar("S")
T = TypeVar("T")
U = TypeVar("U")
Task = tuple[Callable[..., None], tuple[Any, ...]]  # a function and its arguments


# in a pool's thread: set where the pool's work was stopped
_stopped: ContextVar[Event | None] = ContextVar("_stopped", default=None)


class _StoppedError(Exception):
    """Ends a task of stopped work; never raised to the caller, who gets what stopped the work."""


def end_if_stopped() -> None:
    """End the task of :func:`run_all` or :func:`in_threads` that calls it, where their work was stopped."""
    stopped = _stopped.get()
    if stopped is not None and stopped.is_set():
        raise _StoppedError


def available_processors() -> int:
    """Processors that this process may use, which batch systems and containers restrict, where that is known."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def threads_each(tasks: int, threads: int | None = None) -> int:
    """Threads for each of some tasks that run at once; `threads`: for all of them, of all processors by default."""
    return max(1, (threads or available_processors()) // max(1, tasks))


def blocks(count: int, most: int) -> Iterator[tuple[int, int]]:
    """(start, end) of blocks of `count` items, nearly equal and none larger than `most`."""
    number = -(-count // max(1, most))
    for i in range(number):
        yield count * i // number, count * (i + 1) // number


def in_threads(work: Callable[[S], T], items: Sequence[S], threads: int | None = None) -> list[T]:
    """Results of a function of each item, in order, computed by a pool of threads."""
    count = threads or available_processors()
    if count == 1 or len(items) < 2:
        return [work(item) for item in items]
    results: dict[int, T] = {}

    def one(place: int, item: S) -> None:
        results[place] = work(item)

    run_all(((one, pair) for pair in enumerate(items)), threads=count)
    return [results[place] for place in range(len(items))]


def side_by_side(first: Callable[[], T], second: Callable[[], U]) -> tuple[T, U]:
    """Results of two functions, which run at the same time."""
    results: list[Any] = in_threads(lambda function: function(), (first, second), 2)
    return results[0], results[1]


class BackgroundTasks:
    """A thread that does one task after the other, while the thread that gives them goes on.

    As a context manager: left when all tasks are done, or, where its block raises, when the one at work is done; the
    others are dropped. So are those after one that fails, whose exception the next
    :meth:`add`, :meth:`check` or :meth:`wait` raises.
    """

    def __init__(self) -> None:
        self._pool = _Pool(1)
        self._failed = False

    def __enter__(self) -> "BackgroundTasks":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self.wait()
        finally:
            self._pool.end()

    def add(self, function: Callable[..., None], *arguments: Any) -> None:
        """Do a task after those that were given before."""
        self.check()
        self._pool.start(self._do, function, arguments)

    def check(self) -> None:
        """Raise the exception of a task that has failed."""
        while not self._pool.finished.empty():
            self._pool.finish_one()

    def wait(self) -> None:
        """Return when all tasks are done."""
        while self._pool.running:
            self._pool.finish_one()

    def _do(self, function: Callable[..., None], arguments: tuple[Any, ...]) -> None:
        if not self._failed:
            try:
                function(*arguments)
            except BaseException:
                self._failed = True
                raise


def run_all(tasks: Iterable[Task], *, threads: int, done: Callable[[], None] | None = None) -> None:
    """Call each task's function as threads become free, and `done` here after each; the first exception stops all."""
    if threads == 1:
        for function, arguments in tasks:
            function(*arguments)
            if done is not None:
                done()
        return
    waiting_tasks = iter(tasks)
    idle = _idle_pools.setdefault(threads, [])
    try:
        pool = idle.pop()
    except IndexError:
        pool = _Pool(threads)
    pool.stopped = stopped = Event()
    try:
        while True:
            for function, arguments in itertools.islice(waiting_tasks, 2 * threads - pool.running):
                pool.start(function, *arguments)
            if not pool.running:
                break
            pool.finish_one()
            if done is not None:
                done()
    except BaseException:
        stopped.set()
        pool.end()
        raise
    idle.append(pool)


class _Pool:
    """Threads and a queue of finished tasks; not futures, whose lock an interrupt may leave to the wrong thread."""

    def __init__(self, threads: int) -> None:
        self._threads = ThreadPoolExecutor(threads)
        self.finished: SimpleQueue[BaseException | None] = SimpleQueue()
        self.running = 0
        self.stopped: Event | None = None

    def start(self, function: Callable[..., None], *arguments: Any) -> None:
        self._threads.submit(self._do, function, arguments)
        self.running += 1

    def finish_one(self) -> None:
        # waits for a task, and raises what it raised
        error = self.finished.get()
        self.running -= 1
        if error is not None:
            raise error

    def end(self) -> None:
        self._threads.shutdown(wait=True, cancel_futures=True)

    def _do(self, function: Callable[..., None], arguments: tuple[Any, ...]) -> None:
        _stopped.set(self.stopped)
        try:
            function(*arguments)
        except BaseException as error:  # noqa: BLE001  (raised where it is waited for)
            self.finished.put(error)
        else:
            self.finished.put(None)


# pools whose work is done, by their number of threads, since starting threads takes longer than many a small piece of
# work; work inside work takes another one. A forked process has none of its parent's threads
_idle_pools: dict[int, list[_Pool]] = {}
if hasattr(os, "register_at_fork"):  # not on Windows, where nothing forks
    os.register_at_fork(after_in_child=_idle_pools.clear)
