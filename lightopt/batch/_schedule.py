"""Tasks of a batch given to processes: this one, or the workers of a Dask cluster."""

import hashlib
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from lightopt.batch._cluster import Workers, connected, failure_of, failure_text
from lightopt.batch._task import Outcome, RunCommand, Task, remove_leftovers, run_task
from lightopt.core.run_context import RunContext

if TYPE_CHECKING:
    from distributed import Client


def outcomes_of(
    tasks: Sequence[Task], known: Mapping[str, Outcome], workers: Workers, run_command: RunCommand, run: RunContext
) -> Generator[Outcome]:
    """Outcomes of tasks, as they are completed; `known` are those of other tasks, by their place.

    Closed before its end, it stops what runs on this machine, and begins nothing elsewhere.
    """
    if workers.alone:
        outcomes = dict(known)
        for task in tasks:
            outcomes[task.place] = run_task(task, run_command, *(outcomes[place] for place in task.needs))
            yield outcomes[task.place]
        return
    with ExitStack() as stack:
        if workers.scheduler is None:
            stack.push(lambda kind, *_: kind is not None and _remove_all_leftovers(tasks))
        client = stack.enter_context(connected(workers, run, most=len(tasks)))
        yield from _computed(client, tasks, known, run_command)


def _remove_all_leftovers(tasks: Sequence[Task]) -> None:
    # of workers that were killed in the middle of their work
    for task in tasks:
        remove_leftovers(task)


def _computed(
    client: "Client", tasks: Sequence[Task], known: Mapping[str, Outcome], run_command: RunCommand
) -> Iterator[Outcome]:
    from distributed import as_completed

    futures: dict[str, Any] = {}
    for task in tasks:
        needs = [futures.get(place) or known[place] for place in task.needs]
        # the name of a task on the scheduler: another client's task of the same results is the same task
        digest = hashlib.sha256(f"{task.key} {task.folder}".encode()).hexdigest()
        name = f"{task.job}-{digest[:32]}"
        futures[task.place] = client.submit(run_task, task, run_command, *needs, key=name, pure=False)
    places = {future.key: place for place, future in futures.items()}
    for future in as_completed(list(futures.values()), loop=client.loop):
        yield _outcome(future, places)


def _outcome(future: Any, places: Mapping[str, str]) -> Outcome:
    place = places[future.key]
    error = failure_of(future)
    if error is None:
        return future.result()
    lost: str | None = getattr(error, "task", None)
    if lost is not None and lost in places and lost != future.key:
        return Outcome(place=place, state="skipped", messages=(f"needs {places[lost]}",))
    return Outcome(place=place, state="failed", messages=(failure_text(error),))
