"""What became of the tasks of a batch: a table of jobs, a CSV file and a page with all tasks."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from lightopt.batch._task import RECORD_NAME, TERMINAL_NAME, Outcome, Task
from lightopt.config import BatchConfig
from lightopt.core.errors import counted
from lightopt.images import csv_text, write_text_atomic
from lightopt.report import Answer, Page, Section, Table, Warnings, page_html

SUMMARY_NAME, PAGE_NAME = "summary.csv", "report.html"
_STATES = ("done", "kept", "failed", "skipped")
_COLUMNS = ("job", "rig", "part", "state", "seconds", "answer", "messages", "worker")
_NOT_RUN = "not run"


def write_summary(
    batch: BatchConfig, tasks: Sequence[Task], outcomes: Mapping[str, Outcome], out: Path
) -> tuple[Path, ...]:
    """Write the table of all tasks, and the page; returns their paths."""
    rows = [_row(task, outcomes.get(task.place)) for task in tasks]
    write_text_atomic(out / SUMMARY_NAME, csv_text([_COLUMNS, *rows]))
    failed = [row for row in rows if row[3] in ("failed", "skipped")]
    sections = [
        Section(heading="Jobs", blocks=[jobs_table(tasks, outcomes)]),
        Section(heading="Failed", blocks=[_tasks_table(failed, [])] if failed else []),
        Section(heading="Tasks", blocks=[_tasks_table(rows, [_link(task, outcomes) for task in tasks])]),
    ]
    warned = sum("warning:" in row[6] for row in rows)
    lead = [
        Answer(figure=answer_text(outcomes, len(tasks)).partition(" ")[0], text=_rest(outcomes, len(tasks))),
        Warnings(texts=[f"{counted(warned, 'task')} with warnings; the table of tasks has them"] if warned else []),
    ]
    name = batch.source.path.name
    page = page_html(Page(title=f"Batch: {name}", subtitle=name, lead=lead, sections=sections))
    write_text_atomic(out / PAGE_NAME, page)
    return out / SUMMARY_NAME, out / PAGE_NAME


def answer_text(outcomes: Mapping[str, Outcome], number: int) -> str:
    """What became of so many tasks, in a sentence."""
    counts = {state: sum(one.state == state for one in outcomes.values()) for state in _STATES}
    counts[_NOT_RUN] = number - len(outcomes)
    said = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    return f"{counted(number, 'task')}: {said}"


def _rest(outcomes: Mapping[str, Outcome], number: int) -> str:
    return answer_text(outcomes, number).partition(" ")[2]


def jobs_table(tasks: Sequence[Task], outcomes: Mapping[str, Outcome]) -> Table:
    """How many tasks of each job are in each state, and their time in all."""
    rows: list[list[str]] = []
    for job in dict.fromkeys(task.job for task in tasks):
        own = [outcomes.get(task.place) for task in tasks if task.job == job]
        states = [_NOT_RUN if one is None else one.state for one in own]
        counts = [str(states.count(state) or "-") for state in (*_STATES, _NOT_RUN)]
        rows.append([job, *counts, f"{sum(one.seconds for one in own if one is not None):.1f}"])
    return Table(header=["job", *_STATES, _NOT_RUN, "seconds"], rows=rows)


def _row(task: Task, outcome: Outcome | None) -> list[str]:
    if outcome is None:
        return [task.job, task.rig, task.part, _NOT_RUN, "", "", "", ""]
    said = outcome.answer, "\n".join(outcome.messages), outcome.worker
    return [task.job, task.rig, task.part, outcome.state, f"{outcome.seconds:.1f}", *said]


def _link(task: Task, outcomes: Mapping[str, Outcome]) -> str:
    if task.place not in outcomes or not (task.folder / RECORD_NAME).is_file():
        return ""
    own = next(name for name in (PAGE_NAME, TERMINAL_NAME) if name == TERMINAL_NAME or (task.folder / name).is_file())
    return f"{task.place}/{own}"


def _tasks_table(rows: Sequence[Sequence[str]], links: Sequence[str]) -> Table:
    return Table(header=_COLUMNS[:-1], rows=[row[:-1] for row in rows], numbers_from=len(_COLUMNS), links=links)
