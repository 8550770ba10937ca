"""What a run needs beside its inputs: threads, other processes, and where progress, messages and warnings go."""

import logging
from collections.abc import Callable
from copy import copy
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING

from lightopt.core.errors import InputError

if TYPE_CHECKING:
    from lightopt.core.parallel import ProcessPool

_log = logging.getLogger("lightopt.core")

Share = Callable[[float], None]  # called with the share that is done, 0 to 1; an exception that it raises ends the work
StageShare = Callable[[str, float], None]  # called with the stage of the work and the share of it that is done


def ignore(_share: float) -> None:
    """Progress where nobody listens."""


class RunContext:
    """Threads of a run, other processes that compute for it, and where it reports to. No result depends on it.

    threads: At least 1; all processors where it is None
    progress: Called from the calling thread with the stage of the work and the share of it that is done
    inform: Called with messages for the person who waits
    warn: Called with each warning, once
    Raises InputError: Fewer than one thread.
    """

    def __init__(
        self,
        *,
        threads: int | None = None,
        progress: StageShare | None = None,
        inform: Callable[[str], None] | None = None,
        warn: Callable[[str], None] | None = None,
    ) -> None:
        if threads is not None and threads < 1:
            raise InputError(f"threads: expected at least 1, found {threads}")
        self.threads = threads
        self.pool: ProcessPool | None = None
        self._progress, self._inform, self._warn = progress, inform, warn
        self._warnings: dict[str, None] = {}

    @property
    def warnings(self) -> tuple[str, ...]:
        """All warnings so far."""
        return tuple(self._warnings)

    def inform(self, text: str) -> None:
        """Pass a message on."""
        if self._inform is not None:
            self._inform(text)

    def warn(self, *texts: str) -> None:
        """Record warnings, and pass those on that are new."""
        for text in texts:
            if text not in self._warnings:
                self._warnings[text] = None
                if self._warn is not None:
                    self._warn(text)

    def stage(self, name: str) -> Share:
        """Progress of one stage."""
        _log.info("%s", name)
        return ignore if self._progress is None else partial(self._progress, name)

    def spread_over(self, pool: "ProcessPool") -> "RunContext":
        """The same run with other processes, for what can be spread over them."""
        inner = copy(self)  # with the same warnings
        inner.pool = pool
        return inner

    def within(self, name: str) -> "RunContext":
        """Context of a part of the run, whose stages are reported as "name, stage"."""
        inner, progress = copy(self), self._progress  # with the same warnings
        if progress is not None:
            inner._progress = lambda stage, share: progress(f"{name}, {stage}", share)
        return inner

    def apart(self, name: str) -> "RunContext":
        """Context of one of several runs, which records its own warnings and passes none on."""
        inner = self.within(name)
        inner._warnings, inner._warn = {}, None
        return inner


class WorkCounter:
    """Units of work, counted by any thread and reported by the calling one."""

    def __init__(self, total: float, report: Share | None) -> None:
        self._total = max(1.0, float(total))
        self._report = report
        self._done = 0.0
        self._lock = Lock()

    def add(self, units: float) -> None:
        """Count units as done."""
        with self._lock:
            self._done += units

    def report(self) -> None:
        """Report the share that is done."""
        if self._report is not None:
            self._report(min(1.0, self._done / self._total))


def part_of(report: Share | None, start: float, end: float) -> Share:
    """Reports the share of a part of the work as a share of the whole: from `start` to `end`."""
    return ignore if report is None else lambda share: report(start + (end - start) * share)
