"""The command line as a process: its streams, its threads, its exit status. Of the standard library only."""

import errno
import io
import os
import sys
import threading
from collections.abc import Callable
from typing import Any, TextIO

from lightopt.cli._unexpected import DEFECT, report_unexpected

INTERRUPTED = 130

# a reader that went away; Windows calls it an invalid argument
_GONE = {errno.EPIPE, errno.ECONNRESET, *((errno.EINVAL,) if sys.platform == "win32" else ())}


class _Output(io.FileIO):
    """Standard output or error. What is written after its reader went away is dropped: it changes no exit status.

    may_fail: Whether other errors, such as a full disk, are raised; of standard error nobody could be told
    """

    def __init__(self, number: int, *, may_fail: bool) -> None:
        super().__init__(number, "wb", closefd=False)
        self._may_fail = may_fail

    def write(self, data: Any, /) -> int:
        """Write, or drop."""
        try:
            return super().write(data)
        except OSError as error:
            # an error is raised once; what is buffered must not fail again when the process ends
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.fileno())
            os.close(nowhere)
            if self._may_fail and error.errno not in _GONE:
                raise
            return memoryview(data).nbytes


def run_process(run: Callable[[list[str]], int]) -> int:
    """Run a command line as this process, and return the exit status that it has to leave with."""
    _protect_streams()
    failed: list[str] = []
    threading.excepthook = lambda args: _thread_failed(args, failed)
    try:
        status = run(sys.argv[1:])
        try:
            sys.stdout.flush()
        except OSError as error:
            sys.stderr.write(f"error: standard output: {error}\n")
            status = 2
    except KeyboardInterrupt:
        status = INTERRUPTED
    except BaseException as error:  # noqa: BLE001  (the one place from which no exception leaves)
        report_unexpected(error)
        status = DEFECT
    if failed and status in (0, 1):
        status = DEFECT  # a verdict that a part of the work is missing from is none
    return status


def _thread_failed(args: threading.ExceptHookArgs, failed: list[str]) -> None:
    if args.exc_value is None or isinstance(args.exc_value, SystemExit):
        return
    failed.append(str(args.thread))
    report_unexpected(args.exc_value)


def _protect_streams() -> None:
    # a standard stream that was closed (>&-) would be the next file that is opened
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:  # noqa: PERF203
            os.open(os.devnull, os.O_RDWR)
    if sys.stdin is None:
        sys.stdin = io.TextIOWrapper(io.FileIO(0, closefd=False), encoding="utf-8")
    sys.stdout = _protected(sys.stdout, 1, may_fail=True)
    sys.stderr = _protected(sys.stderr, 2, may_fail=False)


def _protected(stream: TextIO | None, number: int, *, may_fail: bool) -> io.TextIOWrapper:
    if isinstance(stream, io.TextIOWrapper) and stream.isatty():
        return stream  # Windows' console is no file
    output = io.BufferedWriter(_Output(number, may_fail=may_fail))
    like = stream if isinstance(stream, io.TextIOWrapper) else None
    return io.TextIOWrapper(
        output,
        encoding="utf-8" if like is None else like.encoding,
        errors="replace" if like is None else like.errors,
        line_buffering=like is None or like.line_buffering,
    )
