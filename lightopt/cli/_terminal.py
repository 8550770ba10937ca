"""What the person at the terminal sees: messages, tables, progress."""

from __future__ import annotations

import sys
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

from lightopt.cli._messages import with_flags

if TYPE_CHECKING:
    from lightopt.core.run_context import StageShare
    from lightopt.core.transforms import Posture


def echo(text: str) -> None:
    """Print a line of results to standard output."""
    typer.echo(with_flags(text))


def echo_error(*messages: str, label: str = "error: ") -> None:
    """Messages on standard error, one line each."""
    for message in messages:
        typer.echo(f"{label}{with_flags(message)}", err=True)


def echo_warning(message: str) -> None:
    """A warning on standard error."""
    typer.echo(f"warning: {with_flags(message)}", err=True)


def version_wanted(wanted: bool) -> None:
    """Print the version and leave."""
    if wanted:
        from lightopt import __version__

        echo(f"lightopt {__version__}")
        raise typer.Exit


def show_table(header: Sequence[str], rows: Sequence[Sequence[str]], *, numbers_from: int = 1) -> None:
    """A table on standard output; columns from `numbers_from` on are aligned to the right."""
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]
    for row in (header, *rows):
        cells = [
            cell.rjust(width) if i >= numbers_from else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        echo("  ".join(cells).rstrip())


def together(postures: Sequence[Posture]) -> str:
    """One posture, or how many, for the cell of a table."""
    return str(postures[0]) if len(postures) == 1 else f"all {len(postures)}"


@contextmanager
def show_progress(*, quiet: bool) -> Generator[StageShare | None]:
    """A progress bar: the stage of the work, its share that is done, the time that it will take at most.

    None where nobody looks at it.
    """
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("left at most"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0)
        last = 0.0

        def report(stage: str, share: float) -> None:
            nonlocal last
            if share < last:  # another stage, which has a pace of its own
                bar.reset(task)
            last = share
            bar.update(task, completed=share, description=stage)

        yield report


def set_up_log(verbose: bool) -> bool:
    """Show the package's log on standard error where the option ``--verbose`` was given."""
    import logging

    log = logging.getLogger("lightopt")
    for handler in tuple(log.handlers):
        log.removeHandler(handler)
    if verbose:
        handler = logging.StreamHandler()
        handler.setFormatter(logging.Formatter("%(relativeCreated)8.0f ms  %(name)s: %(message)s"))
        log.addHandler(handler)
    log.setLevel(logging.INFO if verbose else logging.WARNING)
    return verbose
