"""Work for the disk that goes on while the stage moves and lights settle, in threads of its own."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any

from lightopt.capture._timing import Timing

__all__ = ["DiskWork"]


class DiskWork:
    """One worker checks and writes images, one merges and writes linear ones.

    The next exposure waits for the image before it, not for linear ones, which can be made from the images at any time.

    Parameters
    ----------
    timing
        Where waiting is counted.
    """

    def __init__(self, timing: Timing) -> None:
        self._timing = timing
        self._images = ThreadPoolExecutor(1, thread_name_prefix="disk")
        self._linears = ThreadPoolExecutor(1, thread_name_prefix="linear")
        self._last: Future[Any] | None = None
        self._open: list[Future[Any]] = []

    def image(self, work: Callable[..., None], *arguments: object) -> None:
        """Check and write an image, once those before it are done."""
        self._last = self._images.submit(work, *arguments)
        self._add(self._last)

    def linear(self, work: Callable[..., None], *arguments: object) -> None:
        """Write a linear image, once the images so far are done, of which it is made."""
        last = self._last

        def then() -> None:
            if last is not None:
                last.result()
            work(*arguments)

        self._add(self._linears.submit(then))

    def wait_for_image(self, longest_s: float | None = None) -> bool:
        """Wait until the last image is on disk, at most so long [s]; whether it is. Its error is raised here."""
        if self._last is None:
            return True
        with self._timing.spent("writing_s"):
            wait([self._last], longest_s)
        if not self._last.done():
            return False
        self._last.result()
        return True

    def wait(self) -> None:
        """Wait until all is on disk; the first error is raised here."""
        with self._timing.spent("writing_s"):
            for future in self._open:
                future.result()

    def close(self) -> None:
        """Let all be finished, whatever fails."""
        self._images.shutdown(wait=True)
        self._linears.shutdown(wait=True)

    def _add(self, future: Future[Any]) -> None:
        self._open = [f for f in self._open if not f.done() or f.exception() is not None]
        self._open.append(future)
