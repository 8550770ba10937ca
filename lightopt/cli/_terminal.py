"""What the person at the terminal sees: messages, tables, progress.

The library names options as its own parameters; messages show them as flags.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Container, Generator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from lightopt.core.run_context import RunContext, StageShare
    from lightopt.report import Table

# flags that are not the parameter's name with dashes
FLAGS = {
    "R_d_start": "--start-rd",
    "R_s_start": "--start-rs",
    "allow_outside_px": "--allow-outside",
    "away": "--highlight-margin",
    "check": "--no-check-lights",
    "exposures": "--exposure",
    "light_deg": "--light-tolerance",
    "limit": "--max-combinations",
    "lights": "--light",
    "objectives": "--objective",
    "patch_budget": "--patches",
    "pose_deg": "--pose-tolerance",
    "posture_step_deg": "--posture-step",
    "postures": "--posture",
    "rows": "--ranking-rows",
    "sigma_start": "--start-sigma",
    "step_deg": "--step",
}


def flag(name: str) -> str:
    return FLAGS.get(name, f"--{name.replace('_', '-')}")


def with_flags(message: str) -> str:
    """A message of the library with the flags of the options that it names as: option 'name'."""
    return re.sub(r"option '(\w+)'", lambda match: flag(match[1]), message)


# whether the command that runs was given these options
QUIET, VERBOSE = ContextVar("QUIET", default=False), ContextVar("VERBOSE", default=False)


def echo(text: str, *, even_if_quiet: bool = False) -> None:
    if even_if_quiet or not QUIET.get():
        typer.echo(with_flags(text))


def echo_error(*messages: str, label: str = "error: ") -> None:
    """Messages on standard error, one line each."""
    for message in messages:
        typer.echo(f"{label}{with_flags(message)}", err=True)


def echo_warning(message: str) -> None:
    typer.echo(f"warning: {with_flags(message)}", err=True)


def echo_paths(*paths: Path) -> None:
    for path in paths:
        echo(f"{path}")


SUMMED_UP_FILES = 3  # so many files beside the main ones, or more, are counted and not listed


def echo_main_paths(folder: Path, paths: Sequence[Path], *, main: Container[str]) -> None:
    """Print where the files named `main` were written, and how many others; of a verbose command all of them."""
    shown = [path for path in paths if path.name in main]
    rest = len(paths) - len(shown)
    if VERBOSE.get() or rest < SUMMED_UP_FILES:
        shown, rest = [*paths], 0
    echo_paths(*shown)
    if rest:
        echo(f"and {rest} more files in {folder}; --verbose lists them")


def version_wanted(wanted: bool) -> None:
    if wanted:
        from lightopt import __version__

        echo(f"lightopt {__version__}")
        raise typer.Exit


def show_table(header: Sequence[str], rows: Sequence[Sequence[str]], *, numbers_from: int = 1) -> None:
    """A table on standard output; columns from `numbers_from` on are aligned to the right."""
    lines = [[cell.replace("\u00a0", " ") for cell in row] for row in (header, *rows)]
    widths = [max(len(row[i]) for row in lines) for i in range(len(header))]
    for row in lines:
        cells = [
            cell.rjust(width) if i >= numbers_from else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        echo("  ".join(cells).rstrip())


def show_page_table(table: Table, *, most: int | None = None) -> None:
    """Print a table of a report; no more than `most` of its rows, unless the command is verbose."""
    show_table(table.header, table.rows[: None if VERBOSE.get() else most], numbers_from=table.numbers_from)


@contextmanager
def show_progress() -> Generator[StageShare | None]:
    """A progress bar: stage of the work, share done, time left at most; None where nobody looks at it."""
    if QUIET.get() or not sys.stderr.isatty():
        yield None
        return
    from lightopt.core.kernels import compiled_before

    if not compiled_before():
        typer.echo("first use on this machine: the compiler takes up to a minute, once", err=True)
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

    columns = "{task.description}", BarColumn(), "{task.percentage:>3.0f} %", TimeElapsedColumn()
    left = "left at most", TimeRemainingColumn()
    with Progress(*columns, *left, console=Console(file=sys.stderr), transient=True) as bar:
        task = bar.add_task("", total=1.0)
        last = 0.0

        def report(stage: str, share: float) -> None:
            nonlocal last
            if share < last:  # another stage, which has a pace of its own
                bar.reset(task)
            last = share
            bar.update(task, completed=share, description=stage)

        yield report


@contextmanager
def run_context(threads: int | None = None) -> Generator[RunContext]:
    """How a command runs: with a progress bar, messages if it is verbose, and warnings on standard error."""
    from lightopt.core.run_context import RunContext

    with show_progress() as progress:
        yield RunContext(threads=threads, progress=progress, inform=echo if VERBOSE.get() else None, warn=echo_warning)


def set_up_log(verbose: bool) -> bool:
    """Show the package's log on standard error where the option ``--verbose`` was given."""
    import logging

    log = logging.getLogger("lightopt")
    log.handlers.clear()
    if verbose:
        handler = logging.StreamHandler()
        handler.setFormatter(logging.Formatter("%(relativeCreated)8.0f ms  %(name)s: %(message)s"))
        log.addHandler(handler)
    log.setLevel(logging.INFO if verbose else logging.WARNING)
    return verbose
