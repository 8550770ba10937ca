"""Tasks of one command, such as the postures of a plan, given to the workers of a Dask cluster.

What tasks share is pickled once, and is the result of a task itself: Dask gives it to each worker that needs it, makes
it again where the workers that had it were lost, and drops it everywhere when nothing needs it any more. So a worker
needs no files, and holds no more than a process does that computes alone.
"""

import hashlib
import logging
import pickle
from collections import OrderedDict
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

from lightopt.batch._cluster import Workers, connected, expected_versions, failure_of, failure_text, version_problems
from lightopt.core.errors import InputError, LightoptError, refuse
from lightopt.core.run_context import RunContext, Share

if TYPE_CHECKING:
    from distributed import Client

_log = logging.getLogger("lightopt.batch")
T = TypeVar("T")

# tasks that are given to the scheduler at a time: so many results at most wait to be fetched
_WAITING, _WAITING_OF_THREAD = 64, 4

# what tasks share is kept by the workers until so many others were used after it: the part and its caster, defects,
# patches, drawn patches, lights
_KEPT, _SMALL_BYTES = 6, 1_000


@contextmanager
def other_processes(workers: Workers, run: RunContext) -> Generator[RunContext]:
    """The run with the workers as its pool; the run itself where this process does the work.

    Raises InputError: What is wrong with the scheduler or its workers.
    """
    if workers.alone:
        yield run
        return
    with connected(workers, run) as client:
        yield run.spread_over(_Pool(client))


class _Pool:
    # a lightopt.core.parallel.ProcessPool
    def __init__(self, client: "Client") -> None:
        self._client, self._expected = client, expected_versions()
        self._shared: OrderedDict[str, Any] = OrderedDict()

    def spread(
        self,
        function: Callable[..., T],
        items: Sequence[Any],
        keep: Callable[[int, T], None],
        *shared: Any,
        report: Share | None,
    ) -> None:
        from distributed import as_completed

        everywhere = [self._send(one) for one in shared]
        places: dict[Any, int] = {}

        threads: Any = self._client.nthreads()
        workers = sorted(threads)

        def begin(place: int) -> Any:
            # The same item at the same worker each time, which may have images of it: another one where that is lost
            # or has too much to do. Not pure: the name of a task is no hash of what it is given
            task = self._expected, function, items[place], *everywhere
            own = [workers[place % len(workers)]] if workers else None
            future = self._client.submit(_run, *task, pure=False, workers=own, allow_other_workers=own is not None)
            places[future.key] = place
            return future

        most = max(_WAITING, _WAITING_OF_THREAD * sum(threads.values()))
        begun = min(most, len(items))
        completed = as_completed([begin(place) for place in range(begun)], loop=self._client.loop)
        for done, future in enumerate(completed, start=1):
            keep(places.pop(future.key), _result_of(future))
            if begun < len(items):
                completed.add(begin(begun))
                begun += 1
            if report is not None:
                report(done / len(items))

    def _send(self, value: Any) -> Any:
        # a value as tasks take it: itself where it is small, else the task that has it as its result
        import dask.config

        content = pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)
        if len(content) < _SMALL_BYTES:
            return value
        key = f"shared-{hashlib.sha256(content).hexdigest()}"
        if key not in self._shared:
            _log.info("%s, %s octets, for all workers", type(value).__name__, f"{len(content):,}")
            # Dask warns of what is large, and means what could be read from a file
            with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
                self._shared[key] = self._client.submit(pickle.loads, content, key=key)
        self._shared.move_to_end(key)
        while len(self._shared) > _KEPT:
            self._shared.popitem(last=False)
        return self._shared[key]


def _run(expected: str, function: Callable[..., Any], item: Any, *shared: Any) -> Any:
    # in a worker; also in one that came later
    refuse(version_problems(expected))
    return function(item, *shared)


def _result_of(future: Any) -> Any:
    error = failure_of(future)
    if error is None:
        return future.result()
    if isinstance(error, LightoptError):
        raise error
    if getattr(error, "task", None) is not None:
        raise InputError(failure_text(error))
    raise error
