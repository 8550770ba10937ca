"""The process of a full-screen window, from outside; the one home of what starts it."""

import json
import subprocess
import sys
import tempfile
import threading
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

from lightopt.core.errors import HardwareError, InputError

_START_S = 30.0
_END_S = 5.0
_WINDOW = Path(__file__).with_name("_screen_window.py")


def check_screen_library() -> None:
    """Check that the library of the windows is installed, or raise an InputError with how to install it."""
    if find_spec("pygame") is None:
        raise InputError("driver: screen needs pygame-ce; install it: pip install 'lightopt[screen]'")


def find_monitors() -> list[tuple[int, int]]:
    """Width and height of each monitor [pixels], the first one number 1; InputError where they cannot be listed."""
    check_screen_library()
    process, answer = _start([], "monitors")
    process.wait()
    return [(width, height) for width, height in answer["monitors"]]


class ScreenProcess:
    """A window on a monitor, black until it gets a picture at `port`; it ends when its client has closed that.

    Raises InputError: The library, the monitor or its resolution is another.
    Raises HardwareError: The process does not start.
    """

    def __init__(self, monitor: int, size: tuple[int, int], *, device: str) -> None:
        check_screen_library()
        self._process, answer = _start([monitor, *size], device)
        self.port = f"socket://127.0.0.1:{answer['port']}"

    def close(self) -> None:
        """Wait until the window is closed, which it is once its client has gone; never raises."""
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _start(arguments: list[int], device: str) -> tuple[subprocess.Popen[bytes], dict[str, Any]]:
    with tempfile.TemporaryFile() as errors:
        process = _popen(arguments, errors)
        watchdog = threading.Timer(_START_S, process.kill)
        watchdog.start()
        assert process.stdout is not None
        try:
            with process.stdout:
                line = process.stdout.readline()
        finally:
            watchdog.cancel()
        if not line:
            process.kill()
            process.wait()
            errors.seek(0)
            words = errors.read().decode("utf-8", "replace").strip().splitlines()[-1:]
            raise HardwareError(f"{device}: the window's process did not start; its output: {''.join(words) or 'none'}")
    answer: dict[str, Any] = json.loads(line)
    if "problem" in answer:
        process.wait()
        raise InputError(f"{device}: {answer['problem']}")
    return process, answer


def _popen(arguments: list[int], errors: BinaryIO) -> subprocess.Popen[bytes]:
    return subprocess.Popen(  # noqa: S603  (this interpreter, a file of this package)
        [sys.executable, str(_WINDOW), *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=errors,
        # Ctrl-C is for this program, which still has to show black
        start_new_session=sys.platform != "win32",
        creationflags=0x00000200 if sys.platform == "win32" else 0,  # CREATE_NEW_PROCESS_GROUP
    )
