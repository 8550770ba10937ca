"""Run a batch: what is done is kept, the rest is given to workers, and a table and a page say what became of it."""

import csv
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic, perf_counter, sleep

from lightopt.batch._cluster import Workers
from lightopt.batch._expand import FormOf, check_option_values, expand
from lightopt.batch._schedule import outcomes_of
from lightopt.batch._task import TERMINAL_NAME, Outcome, RunCommand, State, Task, published
from lightopt.core.errors import counted
from lightopt.core.run_context import RunContext
from lightopt.images import csv_text, make_folder, write_text_atomic

_SHARED_S = 60.0  # that a network's file system may take to show a file which another machine has written


@dataclass(frozen=True, kw_only=True)
class BatchResult:
    tasks: tuple[Task, ...]
    outcomes: Mapping[str, Outcome]  # by place; those of an interrupted batch lack some
    seconds: float
    interrupted: bool
    paths: tuple[Path, ...]  # summary and page

    def count(self, *states: State) -> int:
        return sum(outcome.state in states for outcome in self.outcomes.values())


def run_batch(
    jobs: Path,
    out: Path,
    form_of: FormOf,
    run_command: RunCommand,
    *,
    workers: Workers | None = None,
    threads: int = 1,
    run: RunContext | None = None,
) -> BatchResult:
    """Run all tasks of a batch file whose results are not in the output folder yet.

    form_of, run_command: How a command is called, and what runs it
    threads: Of each command; no result depends on it
    Ctrl-C ends it with the result so far; the same call continues.
    Raises InputError: What is wrong with the file, the files that it names, the options, the output folder, the
        scheduler or its workers.
    """
    run, begun = run or RunContext(), perf_counter()
    tasks = expand(jobs, form_of, out, threads=threads)
    outcomes = {task.place: outcome for task in tasks if (outcome := published(task)) is not None}
    rest = [task for task in tasks if task.place not in outcomes]
    check_option_values(jobs, form_of, {task.job for task in rest})
    make_folder(out)
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
        if workers is not None and not workers.here:
            outcomes |= _unseen(rest, outcomes)
    seconds = perf_counter() - begun
    paths = write_summary(jobs.name, tasks, outcomes, out)
    return BatchResult(tasks=tasks, outcomes=outcomes, seconds=seconds, interrupted=interrupted, paths=paths)


def _unseen(tasks: Sequence[Task], outcomes: Mapping[str, Outcome]) -> dict[str, Outcome]:
    """Failures of tasks whose results workers elsewhere have put where this machine does not see them."""
    begun = monotonic()
    hidden = [task for task in tasks if task.place in outcomes and outcomes[task.place].succeeded]
    while (hidden := [task for task in hidden if published(task) is None]) and monotonic() - begun <= _SHARED_S:
        sleep(0.5)
    found = dict[str, Outcome]()
    for task in hidden:
        outcome = outcomes[task.place]
        reason = f"worker {outcome.worker} wrote results that this machine does not see in {task.folder}"
        messages = (f"{reason}; workers need the same output folder, on a shared file system",)
        found[task.place] = replace(outcome, state="failed", messages=messages)
    return found


SUMMARY_NAME, PAGE_NAME = "summary.csv", "report.html"
_STATES = ("done", "kept", "failed", "skipped")
_COLUMNS = ("job", "rig", "part", "state", "seconds", "answer", "messages", "worker")
_NOT_RUN = "not run"


def write_summary(name: str, tasks: Sequence[Task], outcomes: Mapping[str, Outcome], out: Path) -> tuple[Path, ...]:
    """Write the table of all tasks, and the page, unless they say the same already; returns their paths."""
    rows = [_row(task, outcomes.get(task.place)) for task in tasks]
    paths = out / SUMMARY_NAME, out / PAGE_NAME
    if not (paths[1].is_file() and _says_the_same(paths[0], rows)):
        write_text_atomic(paths[0], csv_text([_COLUMNS, *rows]))
        write_text_atomic(paths[1], _page(name, tasks, outcomes, rows))
    return paths


def _says_the_same(path: Path, rows: Sequence[Sequence[str]]) -> bool:
    # that tasks were kept is no news: when and where they were done is
    def facts(row: Sequence[str]) -> Sequence[str]:
        return [*row[:3], *(["done"] if row[3] in ("done", "kept") else [row[3], row[6]])]

    try:
        with path.open(encoding="utf-8", newline="") as file:
            return [facts(row) for row in csv.reader(file)][1:] == [facts(row) for row in rows]
    except (OSError, ValueError):
        return False


def _page(name: str, tasks: Sequence[Task], outcomes: Mapping[str, Outcome], rows: Sequence[Sequence[str]]) -> str:
    # matplotlib and all that is drawn with it takes longer to load than a batch that is done
    from lightopt.report import Answer, Page, Section, Table, Warnings, page_html

    def table(some: Sequence[int]) -> Table:
        links = [_link(tasks[i]) for i in some]
        own = [list(rows[i][:-1]) for i in some]
        return Table(header=_COLUMNS[:-1], rows=own, numbers_from=len(_COLUMNS), links=links)

    failed = [i for i, row in enumerate(rows) if row[3] in ("failed", "skipped")]
    header, job_rows = jobs_table(tasks, outcomes)
    sections = [
        Section(heading="Jobs", blocks=[Table(header=header, rows=job_rows)]),
        Section(heading="Failed", blocks=[table(failed)] if failed else []),
        Section(heading="Tasks", blocks=[table(range(len(rows)))]),
    ]
    warned = sum("warning:" in row[6] for row in rows)
    number, _, rest = answer_text(outcomes, len(tasks)).partition(" ")
    lead = [
        Answer(figure=number, text=rest),
        Warnings(texts=[f"{counted(warned, 'task')} with warnings; the table of tasks has them"] if warned else []),
    ]
    return page_html(Page(title=f"Batch: {name}", subtitle=name, lead=lead, sections=sections))


def answer_text(outcomes: Mapping[str, Outcome], number: int) -> str:
    """What became of so many tasks, in a sentence."""
    counts = {state: sum(one.state == state for one in outcomes.values()) for state in _STATES}
    counts[_NOT_RUN] = number - len(outcomes)
    said = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    return f"{counted(number, 'task')}: {said}"


def jobs_table(tasks: Sequence[Task], outcomes: Mapping[str, Outcome]) -> tuple[Sequence[str], Sequence[Sequence[str]]]:
    """How many tasks of each job are in each state, and their time in all: header and rows."""
    rows: list[list[str]] = []
    for job in dict.fromkeys(task.job for task in tasks):
        own = [outcomes.get(task.place) for task in tasks if task.job == job]
        states = [_NOT_RUN if one is None else one.state for one in own]
        counts = [str(states.count(state) or "-") for state in (*_STATES, _NOT_RUN)]
        rows.append([job, *counts, f"{sum(one.seconds for one in own if one is not None):.1f}"])
    return ["job", *_STATES, _NOT_RUN, "seconds"], rows


def _row(task: Task, outcome: Outcome | None) -> list[str]:
    if outcome is None:
        return [task.job, task.rig, task.part, _NOT_RUN, "", "", "", ""]
    said = outcome.answer, "\n".join(outcome.messages), outcome.worker
    return [task.job, task.rig, task.part, outcome.state, f"{outcome.seconds:.1f}", *said]


def _link(task: Task) -> str:
    # none to results of earlier inputs, which stay where a task fails
    if published(task) is None:
        return ""
    return f"{task.place}/{PAGE_NAME if (task.folder / PAGE_NAME).is_file() else TERMINAL_NAME}"
