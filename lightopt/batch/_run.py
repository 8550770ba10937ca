"""Run a batch: what is done is kept, the rest is given to workers, and a page says what became of each task."""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from lightopt.batch._expand import FormOf, expand
from lightopt.batch._schedule import Workers, outcomes_of
from lightopt.batch._summary import write_summary
from lightopt.batch._task import Outcome, RunCommand, State, Task, published
from lightopt.config import BatchConfig
from lightopt.core.run_context import RunContext
from lightopt.images import make_folder


@dataclass(frozen=True, kw_only=True)
class BatchResult:
    """What became of the tasks of a batch."""

    tasks: tuple[Task, ...]
    outcomes: Mapping[str, Outcome]  # by place; those of an interrupted batch lack some
    seconds: float
    interrupted: bool
    paths: tuple[Path, ...]  # summary and page

    def count(self, *states: State) -> int:
        """Number of tasks in any of these states."""
        return sum(outcome.state in states for outcome in self.outcomes.values())


def run_batch(
    batch: BatchConfig,
    out: Path,
    form_of: FormOf,
    run_command: RunCommand,
    *,
    workers: Workers | None = None,
    threads: int = 1,
    run: RunContext | None = None,
) -> BatchResult:
    """Run all tasks of a batch whose results are not in the output folder yet.

    form_of, run_command: How a command is called, and what runs it
    threads: Of each command; no result depends on it
    Ctrl-C ends it with the result so far; the same call continues.
    Raises InputError: What is wrong with the files, the options, the output folder, the scheduler or its workers.
    """
    run, begun = run or RunContext(), perf_counter()
    tasks = expand(batch, form_of, out, threads=threads)
    outcomes = {task.place: outcome for task in tasks if (outcome := published(task)) is not None}
    make_folder(out)
    rest = [task for task in tasks if task.place not in outcomes]
    interrupted = False
    if rest:
        known, share = dict(outcomes), run.stage(f"{len(rest)} of {len(tasks)} tasks")
        try:
            with closing(outcomes_of(rest, known, workers or Workers(), run_command, run)) as completed:
                for number, outcome in enumerate(completed, start=1):
                    outcomes[outcome.place] = outcome
                    run.inform(f"{outcome.state}: {outcome.place}, {outcome.seconds:.1f} s on {outcome.worker or '-'}")
                    share(number / len(rest))
        except KeyboardInterrupt:
            interrupted = True
    seconds = perf_counter() - begun
    paths = write_summary(batch, tasks, outcomes, out)
    return BatchResult(tasks=tasks, outcomes=outcomes, seconds=seconds, interrupted=interrupted, paths=paths)
