"""Write images in background threads, while the stage moves and lights settle."""

from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any

from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.capture._acquisition import Timing

MOST_LINEARS = 2  # linear images that wait or are being written, at most: their exposures are held in memory until then


class BackgroundWriter:
    """One worker checks and writes images, one merges and writes linear ones.

    The next exposure waits for the previous image, not for linear ones, which can be computed from the images at any
    time. After an error no further image is written. A disk that refuses counts as a failed device: an
    :class:`InputError` of the workers is raised here as :class:`HardwareError`.
    """

    def __init__(self, timing: Timing) -> None:
        self._timing = timing
        self._images = ThreadPoolExecutor(1, thread_name_prefix="disk")
        self._linears = ThreadPoolExecutor(1, thread_name_prefix="linear")
        self._last: Future[None] | None = None
        self._queued: list[Future[None]] = []

    def submit_image(self, work: Callable[..., None], *arguments: object) -> None:
        """Check and write an image, once those before it are done."""
        self._last = self._images.submit(_run_after, self._last, work, *arguments)

    def submit_linear(self, work: Callable[..., None], *arguments: object) -> None:
        """Write a linear image, once its exposures are written.

        Waits while the queue is full; a previous error is raised here.
        """
        with self._timing.spent("writing_s"):
            while len(self._unwritten()) >= MOST_LINEARS:
                wait(self._queued, return_when=FIRST_COMPLETED)
        self._queued.append(self._linears.submit(_run_after, self._last, work, *arguments))

    def wait_for_image(self, longest_s: float | None = None) -> bool:
        """Wait until the last image is on disk, at most so long [s]; returns whether it is, raises its error."""
        if self._last is None:
            return True
        with self._timing.spent("writing_s"):
            wait([self._last], longest_s)
        if not self._last.done():
            return False
        _result(self._last)
        return True

    def wait(self) -> None:
        """Wait until all is on disk; the first error is raised here."""
        self.wait_for_image()
        with self._timing.spent("writing_s"):
            while self._unwritten():
                wait(self._queued, return_when=FIRST_COMPLETED)

    def cancel_linears(self) -> None:
        self._linears.shutdown(wait=False, cancel_futures=True)

    def wait_idle(self, longest_s: float) -> bool:
        """Wait at most so long [s]; returns whether all is done."""
        last = [self._last] if self._last is not None else []
        return not wait([f for f in (*self._queued, *last) if not f.done()], longest_s).not_done

    def close(self) -> None:
        """Finish all work, whatever fails."""
        self._images.shutdown(wait=True)
        self._linears.shutdown(wait=True)

    def _unwritten(self) -> list[Future[None]]:
        """Linear images that are not written yet; the first error of those that are done is raised."""
        done = [future for future in self._queued if future.done()]
        self._queued = [future for future in self._queued if future not in done]
        for future in done:
            _result(future)
        return self._queued


def _run_after(before: Future[None] | None, work: Callable[..., None], *arguments: object) -> None:
    """Do some work once the work before it has succeeded; its error is raised otherwise."""
    if before is not None:
        before.result()
    work(*arguments)


def _result(future: Future[Any]) -> None:
    try:
        future.result()
    except InputError as error:
        raise HardwareError(*error.messages) from error
