"""Progress of work that threads do: counted by any of them, reported by the calling thread."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import Lock

Share = Callable[[float], None]
"""Called with the share that is done, 0 to 1; an exception that it raises ends the work."""


class Work:
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

    def tell(self) -> None:
        """Report the share that is done."""
        if self._report is not None:
            self._report(min(1.0, self._done / self._total))


def part_of(report: Share | None, start: float, end: float) -> Share | None:
    """Reports the share of a part of the work as a share of the whole: from `start` to `end`."""
    if report is None:
        return None
    return lambda share: report(start + (end - start) * share)


def pieces(count: int, most: int) -> Iterator[tuple[int, int]]:
    """(start, end) of pieces of `count` things, nearly equal and none larger than `most`."""
    number = -(-count // max(1, most))
    for i in range(number):
        yield count * i // number, count * (i + 1) // number
