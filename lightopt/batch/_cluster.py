"""Where work runs beside this process: an embedded Dask cluster of this machine, or a Dask cluster elsewhere."""

import asyncio
import json
import logging
import math
import platform
import signal
import tempfile
import warnings
from collections.abc import Generator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

from lightopt.core.errors import InputError, error_text
from lightopt.core.interrupts import held_back
from lightopt.core.provenance import computed_by, differences
from lightopt.core.run_context import RunContext

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

_ANSWER_S = 5.0  # how long a scheduler may take to answer
_SHORT_S = 60.0  # a worker that leaves so soon after it came may lack what it needs
_KILL_S = 0.5  # how long a worker of this machine may take to end before it is killed
_MOST_CHARACTERS = 500  # of what a batch system says where it fails: some add the log of their scheduler
# packages that start workers by a batch system: module, class with its arguments, and name of the package
_SYSTEMS: Mapping[str, tuple[str, str, Mapping[str, Any], str]] = {
    "slurm": ("dask_jobqueue", "SLURMCluster", {}, "dask-jobqueue"),
    # quiet: it would draw a panel on standard output while it starts
    "kubernetes": ("dask_kubernetes.operator", "KubeCluster", {"quiet": True}, "dask-kubernetes"),
}


@dataclass(frozen=True, kw_only=True)
class Workers:
    """Where work runs: on this machine, unless a scheduler or a batch system is named."""

    number: int = 1  # of processes; one is this process. Of jobs of the batch system, where it starts them
    scheduler: str | None = None  # address of a running Dask scheduler; its workers are taken as they are
    system: Literal["slurm", "kubernetes"] | None = None

    @property
    def here(self) -> bool:
        """Whether all processes are of this machine and end with the command."""
        return self.scheduler is None and self.system is None

    @property
    def alone(self) -> bool:
        """Whether this process does the work."""
        return self.here and self.number == 1


@contextmanager
def connected(workers: Workers, run: RunContext, *, most: int | None = None) -> Generator["Client"]:
    """A client of the cluster, whose workers compute as this process does; at most so many are started here.

    Left by an exception, workers of this machine are killed.
    """
    try:
        import distributed
    except ModuleNotFoundError as error:
        raise InputError(f"several processes need Dask ({error}): pip install 'lightopt[batch]'") from None
    # what it logs of workers and connections that come and go is in the outcomes, as far as it matters
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        address: Any = workers.scheduler
        if workers.system is not None:
            address = stack.enter_context(_started(workers.system, workers.number, run))
        elif address is None:
            address = stack.enter_context(local_cluster(min(workers.number, most or workers.number)))
            stack.push(lambda kind, *_: kind is not None and _stop(address))
        else:
            _require_scheduler(address)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            client = distributed.Client(address, timeout=_ANSWER_S, set_as_default=False)
        run.warn(*(" ".join(str(one.message).split()) for one in caught if issubclass(one.category, UserWarning)))
        stack.callback(client.close, timeout=_ANSWER_S)
        if not workers.here:
            client.subscribe_topic("all", partial(_note_short_lived, run, dict[str, float](), set[str]()))
            stack.callback(client.unsubscribe_topic, "all")
        if not _check_workers(client) and workers.scheduler is not None:
            run.warn(f"no worker is connected to {workers.scheduler} yet; the work waits for one")
        # closed before all is done, what has not begun does not begin; what a worker elsewhere has begun, it completes
        yield client


def _note_short_lived(
    run: RunContext, came: dict[str, float], noted: set[str], event: tuple[float, Mapping[str, Any]]
) -> None:
    # of the scheduler's events: one that cannot load what it is given ends at once, and may come again for ever
    seconds, what = event
    worker = str(what.get("worker"))
    if what.get("action") == "add-worker":
        came[worker] = seconds
        return
    lived = seconds - came.get(worker, -math.inf)
    if what.get("action") == "remove-worker" and lived < _SHORT_S and not noted:
        noted.add(worker)
        needs = "workers need the same Python, lightopt and packages as this machine"
        run.warn(f"worker {worker} left {lived:.0f} s after it came; see what it printed: {needs}")


def _require_scheduler(address: str) -> None:
    """Refuse an address where no Dask server answers in time, before a client waits for it in a thread of its own."""
    from distributed.comm.core import connect
    from distributed.security import Security

    arguments: Any = Security().get_connection_args("client")

    async def shake_hands() -> None:
        (await asyncio.wait_for(connect(address, **arguments), _ANSWER_S)).abort()

    try:
        asyncio.run(shake_hands())
    except Exception as error:  # noqa: BLE001 - of another server that answers, Dask takes any octets for lengths
        why = f" ({error})" if isinstance(error, ValueError) else ""
        advice = "start one with: dask scheduler, and workers with: dask worker ADDRESS --nthreads 1"
        raise InputError(f"{address}: no Dask scheduler answers within {_ANSWER_S:g} s{why}; {advice}") from None


@contextmanager
def local_cluster(number: int) -> Generator["LocalCluster"]:
    import dask.config
    from distributed import LocalCluster

    start: Any = LocalCluster
    # Dask would have workers return freed memory at once, and get it again for each array: a fifth more time
    key = "distributed.nanny.pre-spawn-environ"
    environment = {name: value for name, value in dask.config.get(key).items() if name != "MALLOC_TRIM_THRESHOLD_"}
    settings = {"distributed.worker.profile.enabled": False, key: environment}
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="lightopt-", ignore_cleanup_errors=True))
        stack.enter_context(dask.config.set(settings))
        # Ctrl-C would leave it half started, with a traceback of each worker
        with held_back():
            # one thread each; the network sees neither the processes nor a dashboard
            cluster = start(
                n_workers=number,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address=None,
                scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # of its answers to "are you well"
                memory_limit=0,
                silence_logs=logging.CRITICAL,
                local_directory=folder,
                preload=["lightopt.batch._cluster"],
            )
            stack.enter_context(cluster)
        yield cluster


def dask_setup(_worker: object) -> None:
    """Let a worker of this machine ignore Ctrl-C, which a terminal of Windows sends it, too; Dask calls it in each."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _stop(cluster: "LocalCluster") -> None:
    """End workers of this machine in the middle of their work."""

    async def kill() -> None:
        for nanny in cluster.workers.values():
            nanny.auto_restart = False
        killing = (nanny.kill(timeout=_KILL_S) for nanny in cluster.workers.values())
        await asyncio.gather(*killing, return_exceptions=True)

    cluster.sync(kill)


@contextmanager
def _started(system: Literal["slurm", "kubernetes"], number: int, run: RunContext) -> Generator[Any]:
    """A cluster of a batch system, with so many workers, by the settings in Dask's own configuration files.

    It is removed at the end, whatever happens; where that fails, the user is warned.
    """
    module, name, arguments, package = _SYSTEMS[system]
    try:
        found = import_module(module)
    except ModuleNotFoundError as error:
        raise InputError(f"option '{system}' needs {package} ({error}): pip install 'lightopt[{system}]'") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that the port of its own page is taken
            cluster = getattr(found, name)(**arguments)
    except Exception as error:  # each package has errors of its own
        raise InputError(
            f"{package} could not start a cluster ({_shortened(error)}); see ~/.config/dask/*.yaml"
        ) from error
    try:
        try:
            cluster.scale(number)
        except Exception as error:
            raise InputError(f"{package} could not start {number} workers ({_shortened(error)})") from error
        yield cluster
    finally:
        try:
            cluster.__exit__(None, None, None)
        except Exception as error:  # noqa: BLE001 - the results are there all the same
            run.warn(f"{package} could not remove the cluster {cluster.name} ({_shortened(error)}); remove it yourself")


def _shortened(error: Exception) -> str:
    text = " ".join(error_text(error).split())
    return text if len(text) <= _MOST_CHARACTERS else f"{text[:_MOST_CHARACTERS]} …"


def _check_workers(client: "Client") -> int:
    """Refuse workers of another version; returns how many there are. Those that come later are refused by each task."""
    answers: Any = client.run(version_problems, expected_versions(), on_error="return")
    problems = list[str]()
    for address, answer in answers.items():
        texts = [error_text(answer)] if isinstance(answer, BaseException) else answer
        problems += [f"worker {address}: {text}" for text in texts]
    if problems:
        raise InputError(*problems[:5], "install the same versions for all workers, and start them again")
    return len(answers)


def expected_versions() -> str:
    """What computes in this process, as JSON, for :func:`version_problems` of another."""
    return json.dumps(computed_by(), sort_keys=True)


def version_problems(expected: str) -> tuple[str, ...]:
    """Why this process cannot compute what the one that started the work would."""
    other = differences(json.loads(expected), computed_by())
    return (f"{platform.node()} computes otherwise than the machine that started it: {other}",) if other else ()


def failure_of(future: Any) -> BaseException | None:
    """Why the task of a future failed; None where it has a result.

    Where the worker that holds the result was lost, this waits until another one has computed it again.
    """
    error: BaseException | None = None if future.status == "cancelled" else future.exception()
    # it may be cancelled while this waits
    return InputError("the connection to the scheduler was lost") if future.status == "cancelled" else error


def failure_text(error: BaseException) -> str:
    """The words for what :func:`failure_of` returns."""
    if getattr(error, "task", None) is not None:  # Dask's, of a task that it gave up
        return "each worker that ran it was lost, perhaps for lack of memory: give it more memory, or run it by itself"
    return error_text(error)
