"""What the person at the terminal sees: messages, tables, progress."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from lightopt.core.transforms import Posture
    from lightopt.rendering import RenderProgress


def say(text: str) -> None:
    """Print a line of results to standard output."""
    typer.echo(text)


def say_error(*messages: str, label: str = "error: ") -> None:
    """Messages on standard error, one line each."""
    for message in messages:
        typer.echo(f"{label}{message}", err=True)


def say_warning(message: str) -> None:
    """A warning on standard error."""
    typer.echo(f"warning: {message}", err=True)


def version_wanted(wanted: bool) -> None:
    """Print the version and leave."""
    if wanted:
        from lightopt import __version__

        say(f"lightopt {__version__}")
        raise typer.Exit


def show_table(header: Sequence[str], rows: Sequence[Sequence[str]], *, numbers_from: int = 1) -> None:
    """A table on standard output; columns from `numbers_from` on are aligned to the right."""
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]
    for row in (header, *rows):
        cells = [
            cell.rjust(width) if i >= numbers_from else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        say("  ".join(cells).rstrip())


def together(postures: Sequence[Posture]) -> str:
    """One posture, or how many, for the cell of a table."""
    return str(postures[0]) if len(postures) == 1 else f"all {len(postures)}"


@contextmanager
def show_progress(label: str, total: int, *, quiet: bool) -> Generator[RenderProgress | None]:
    """A progress bar with rays per second while rendering `total` postures, or more; None where nobody looks at it."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[rays]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=float(total), rays="")
        finished: dict[Posture, float] = {}
        rays: dict[Posture, int] = {}

        def report(posture: Posture, share: float, cast: int) -> None:
            finished[posture], rays[posture] = share, cast
            elapsed = bar.tasks[0].elapsed or 1e-9
            speed = sum(rays.values()) / elapsed / 1e6
            bar.update(
                task,
                completed=sum(finished.values()),
                total=float(max(total, len(finished))),
                description=f"{label} {posture}",
                rays=f"{speed:.1f} Mray/s",
            )

        yield report


@contextmanager
def show_share(*, quiet: bool) -> Generator[Callable[[str, float], None] | None]:
    """A progress bar that says what is going on and which share of that is done; None where nobody looks at it."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0)

        def report(stage: str, share: float) -> None:
            bar.update(task, completed=share, description=stage)

        yield report


@contextmanager
def show_time_left(label: str, *, quiet: bool) -> Generator[Callable[[str, float], None] | None]:
    """Lines that say what is at work, how much is done of it and how long the rest will take, at most one a second.

    None where nobody looks. Nothing is printed in the first second of a stage, since most stages are over by then.
    """
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from time import monotonic

    at_work, begun = "", [0.0, 0.0, 0.0]

    def report(stage: str, share: float) -> None:
        nonlocal at_work
        now = monotonic()
        if stage != at_work:
            # the pace of one stage says nothing of another's
            at_work, begun[:] = stage, [now, now, share]
        first, last, start = begun
        if share > start and now - last >= 1.0:
            begun[1] = now
            left = (now - first) * (1.0 - share) / (share - start)
            typer.echo(f"{label} {stage}: {100.0 * share:.1f} %, at most about {left:.0f} s left", err=True)

    yield report
