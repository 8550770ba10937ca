"""The command line as a process: its streams, its threads, its exit status, and exceptions that nobody foresaw.

Of those the person at the machine gets one line, and the traceback is in a file. The module uses the standard library
and lightopt.core.errors only, because the import of anything else may be what failed.
"""

import contextlib
import errno
import io
import os
import platform
import shlex
import sys
import threading
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

from lightopt.core.errors import error_text

DEFECT = 70  # exit status of a defect of the program; EX_SOFTWARE of BSD's sysexits
INTERRUPTED = 130
DEBUG = "LIGHTOPT_DEBUG"
_PACKAGE = Path(__file__).parents[1]
_MOST_CHARACTERS = 300

# reasons of the operating system that are no defect, whether or not the error names a file
_REFUSALS = {
    getattr(errno, name)
    for name in ("EACCES", "EDQUOT", "EFBIG", "EIO", "EMFILE", "ENFILE", "ENOSPC", "EPERM", "EROFS")
    if hasattr(errno, name)
}

# a reader that went away; Windows calls it an invalid argument
_GONE = {errno.EPIPE, errno.ECONNRESET, *((errno.EINVAL,) if sys.platform == "win32" else ())}


class _Output(io.FileIO):
    """Standard output or error; what its reader no longer takes is dropped. `may_fail`: other errors are raised."""

    def __init__(self, number: int, *, may_fail: bool) -> None:
        super().__init__(number, "wb", closefd=False)
        self._may_fail = may_fail

    def write(self, data: Any, /) -> int:
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

    def thread_failed(args: threading.ExceptHookArgs) -> None:
        if args.exc_value is not None and not isinstance(args.exc_value, SystemExit):
            failed.append(str(args.thread))
            report_unexpected(args.exc_value)

    threading.excepthook = thread_failed
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
    encoding, errors, line_buffering = "utf-8", "replace", True
    if isinstance(stream, io.TextIOWrapper):
        encoding, errors, line_buffering = stream.encoding, stream.errors or errors, stream.line_buffering
    return io.TextIOWrapper(output, encoding=encoding, errors=errors, line_buffering=line_buffering)


def debugging() -> bool:
    """Whether tracebacks go to the terminal: --debug was given, or the environment has LIGHTOPT_DEBUG."""
    return os.environ.get(DEBUG, "") not in ("", "0")


def system_refused(error: OSError) -> bool:
    """Whether the operating system refused a file of the user, or has no room: no defect of the program."""
    if isinstance(error.filename, str):
        return _PACKAGE not in Path(error.filename).parents
    return error.filename is not None or error.errno in _REFUSALS


def report_unexpected(error: BaseException) -> None:
    """Report on one line of standard error what happened and where the traceback is.

    It is in a file of its own in the folder for temporary files, which only this user can read. Where that cannot be
    written, or tracebacks are asked for, it is on standard error instead.
    """
    try:
        text = "".join(traceback.format_exception(type(error), error, error.__traceback__))
    except Exception:  # noqa: BLE001  (no memory, for instance)
        text = f"{type(error).__name__}\n"
    what = " ".join(error_text(error).split())[:_MOST_CHARACTERS]
    where, shown = "its traceback is above", debugging()
    if not shown:
        try:
            where = f"its traceback is in {_written(text)}; --debug or {DEBUG}=1 shows it on the terminal"
        except Exception as problem:  # noqa: BLE001  (the first error is reported, whatever this one is)
            where, shown = f"{where}, because no file can be written: {error_text(problem)}", True
    with contextlib.suppress(Exception):
        sys.stderr.write(f"{text if shown else ''}error: unexpected {what} (a bug in lightopt); {where}\n")
        sys.stderr.flush()


def _written(text: str) -> str:
    import tempfile  # which takes longer to load than the rest of the module

    from lightopt import __version__

    # a new name, and mode 0600: command lines name folders of the user
    number, path = tempfile.mkstemp(prefix="lightopt-error-", suffix=".txt")
    with open(number, "w", encoding="utf-8", errors="backslashreplace") as file:  # noqa: PTH123 - a descriptor
        file.write(
            f"lightopt {__version__}, Python {platform.python_version()}, {platform.platform()}\n"
            f"{shlex.join(['lightopt', *sys.argv[1:]])}\nin {Path.cwd()}\n\n{text}"
        )
    return path
