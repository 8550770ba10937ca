"""Exceptions that nobody foresaw: one line for the person at the machine, the traceback in a file.

Of the standard library and lightopt.core.errors only, because the import of anything else may be what failed.
"""

import contextlib
import errno
import os
import platform
import shlex
import sys
import tempfile
import traceback
from pathlib import Path

from lightopt.core.errors import error_text

DEFECT = 70  # exit status of a defect of the program; EX_SOFTWARE of BSD's sysexits

DEBUG = "LIGHTOPT_DEBUG"
_PACKAGE = Path(__file__).parents[1]
_MOST_CHARACTERS = 300

# reasons of the operating system that are no defect, whether or not the error names a file
_REFUSALS = {
    getattr(errno, name)
    for name in ("EACCES", "EDQUOT", "EFBIG", "EIO", "EMFILE", "ENFILE", "ENOSPC", "EPERM", "EROFS")
    if hasattr(errno, name)
}


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
    where = f"--debug or {DEBUG}=1 shows it on the terminal"
    shown = debugging()
    if shown:
        where = "its traceback is above"
    else:
        try:
            where = f"its traceback is in {_written(text)}; {where}"
        except Exception as problem:  # noqa: BLE001  (the first error is reported, whatever this one is)
            where, shown = (f"its traceback is above, because no file can be written: {error_text(problem)}", True)
    with contextlib.suppress(Exception):
        sys.stderr.write(f"{text if shown else ''}error: unexpected {what} (a defect of lightopt); {where}\n")
        sys.stderr.flush()


def _written(text: str) -> str:
    """Path of a new file with a traceback, and with what it takes to find its cause."""
    from lightopt import __version__

    # a new name, and mode 0600: command lines name folders of the user
    number, path = tempfile.mkstemp(prefix="lightopt-error-", suffix=".txt")
    with open(number, "w", encoding="utf-8", errors="backslashreplace") as file:  # noqa: PTH123 - a descriptor
        file.write(
            f"lightopt {__version__}, Python {platform.python_version()}, {platform.platform()}\n"
            f"{shlex.join(['lightopt', *sys.argv[1:]])}\nin {Path.cwd()}\n\n{text}"
        )
    return path
