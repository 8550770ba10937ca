from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lightopt.cli import _common as common
from lightopt.cli._process import INTERRUPTED
from lightopt.cli._terminal import echo, echo_error, echo_paths, run_context, show_table, with_flags
from lightopt.core.errors import CheckFailed, counted

if TYPE_CHECKING:
    from lightopt.batch import BatchResult, CommandForm

MOST_JOBS, MOST_FAILURES = 8, 4  # rows and messages on the terminal; the files have all
_FILES = {"FILE", "DIR", "SET", "IMAGES"}  # as the help calls values that name files
_ARGUMENTS = {"rig", "part", "images", "rigs"}
_OF_THE_BATCH = {
    *("out", "force", "quiet", "verbose", "threads", "resume", "dry_run", "help"),
    *("workers", "scheduler", "slurm", "kubernetes"),
}
_WRITTEN = {"json_file", "drawing", "serial_log", "history"}  # files beside the folder of results


def batch(
    jobs: Annotated[Path, typer.Argument(metavar="JOBS", help="Batch file (YAML): rigs, parts, jobs.")],
    out: common.Out,
    workers: int | None = common.workers_option(
        None, metavar="N", min=1, help=common.WORKERS_HELP, show_default="all processors"
    ),
    threads: int = common.workers_option(
        1, metavar="N", min=1, help="Threads of each command; no result depends on it."
    ),
    scheduler: common.Scheduler = None,
    slurm: common.Slurm = False,
    kubernetes: common.Kubernetes = False,
) -> None:
    """Run the jobs of JOBS, each for every rig and every part, on this machine or on a cluster.

    A job is a command on a rig and a part, such as check, render, fit-specular, optimize or inspect. Jobs may use the
    images, rig files and part files of other jobs. Results go to DIR/JOB/RIG/PART, complete or not at all. What is
    there, made from the same files, options and version, is kept: the same command continues a batch that was
    interrupted, and repeats what failed.

    Writes summary.csv and report.html. Exit status 1 if a task failed; the other tasks are run all the same.

    Workers of a cluster need the same version, and the same files at the same paths.

    Example: lightopt batch jobs.yaml -o out
    """
    from lightopt.batch import answer_text, jobs_table, run_batch
    from lightopt.core.threads import available_processors

    number = max(1, available_processors() // threads)
    where = common.chosen_workers(workers, scheduler, slurm, kubernetes, here=number, system=number)
    with run_context() as run:
        result = run_batch(jobs, out, command_form, run_captured, workers=where, threads=threads, run=run)
    echo(f"{answer_text(result.outcomes, len(result.tasks))}; {result.seconds:.1f} s")
    header, rows = jobs_table(result.tasks, result.outcomes)
    show_table(header, rows[:MOST_JOBS])
    if len(rows) > MOST_JOBS:
        echo(f"and {counted(len(rows) - MOST_JOBS, 'job')} more in {result.paths[0]}")
    echo_paths(*result.paths)
    if result.interrupted:
        echo_error("the same command continues the batch", label="")
        raise KeyboardInterrupt
    if failures := _failures(result):
        raise CheckFailed(*failures)


def _failures(result: BatchResult) -> list[str]:
    failed = [one for one in result.outcomes.values() if one.state == "failed"]
    texts = [f"{one.place}: {_reason(one.messages)}" for one in failed]
    if len(texts) > MOST_FAILURES:
        more = len(texts) - MOST_FAILURES + 1
        texts = [*texts[: MOST_FAILURES - 1], f"{more} more tasks failed; {result.paths[0]} has the reasons"]
    return texts


def _reason(messages: Sequence[str]) -> str:
    # the first error, which warnings may precede
    errors = [text for text in messages if not text.startswith("warning: ")]
    return (errors or ["failed"])[0].removeprefix("error: ")


def command_form(name: str) -> CommandForm | None:
    """How a command is called; None where it is none on a rig and a part whose results go to a folder."""
    from lightopt.batch import CommandForm, OptionForm
    from lightopt.cli._main import parser

    command: Any = parser().commands.get(name)  # type: ignore[attr-defined]
    parameters: list[Any] = [] if command is None else command.params
    arguments = [one.name for one in parameters if one.param_type_name == "argument"]
    out = next((one for one in parameters if one.name == "out"), None)
    if "part" not in arguments or not set(arguments) <= _ARGUMENTS or (out is not None and out.metavar != "DIR"):
        return None
    options = {
        one.opts[0].removeprefix("--"): OptionForm(
            flag=one.is_flag, has_opposite=bool(one.secondary_opts), repeatable=one.multiple, file=one.metavar in _FILES
        )
        for one in parameters
        if one.param_type_name == "option" and one.name not in _OF_THE_BATCH | _WRITTEN
    }
    return CommandForm(
        name=name,
        arguments=tuple(arguments),
        options=options,
        defaults={one.name: str(one.default) for one in parameters if one.name not in _OF_THE_BATCH | _WRITTEN},
        problems=partial(_option_problems, [name, *arguments, *(["-o", "DIR"] if out is not None else [])]),
        writes_folder=out is not None,
        takes_threads=any(one.name == "threads" for one in parameters),
    )


def _option_problems(line: Sequence[str], words: Mapping[str, Sequence[str]]) -> Iterator[tuple[str | None, str]]:
    """What a command refuses of its options before it reads rig and part, by the option's name; None for several.

    line: The command with its arguments, which are not read
    words: Of each option, by its name
    """
    left, refused, said = dict(words), set[str](), set[str]()
    while True:
        before = frozenset(refused)
        for message in _refusals([*line, *(word for own in left.values() for word in own)]):
            named = re.match(r"--(?:no-)?([\w-]+)(: )?", message)
            name = named[1] if named and named[1] in words else None
            # without an option that was refused, another one may have no effect, or a required one is missing
            if message not in said and not any(re.search(rf"--{one}\b", message) for one in before):
                yield name, message[named.end() :] if named and name and named[2] else message
            said.add(message)
            if name is not None:
                refused.add(name)
        # the other options are checked without those that are refused already
        left = {name: own for name, own in words.items() if name not in refused}
        if len(refused) == len(before):
            return


def _refusals(line: list[str]) -> Sequence[str]:
    from lightopt.cli._main import parser, refusal

    token = common.ONLY_OPTIONS.set(True)
    try:
        if parser()(line, prog_name="lightopt", standalone_mode=False) == INTERRUPTED:
            raise KeyboardInterrupt
    except common.OptionsRead:
        return ()
    except Exception as error:
        if (messages := refusal(error)) is None:
            raise
        return [with_flags(message) for message in messages]
    finally:
        common.ONLY_OPTIONS.reset(token)
    raise AssertionError(f"{line[0]} has run without a look at the options alone")


def run_captured(arguments: list[str]) -> tuple[int, str, str]:
    """Run a command line in this process: exit status, standard output, standard error."""
    from lightopt.cli._main import run

    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        status = run(arguments)
    return status, out.getvalue(), err.getvalue()
