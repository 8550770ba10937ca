"""The process of a full-screen window, from outside."""

import json
import subprocess
import sys
import tempfile
import threading
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

from lightopt.core.errors import HardwareError, InputError

_START_S = 30.0
_END_S = 5.0
_WINDOW = Path(__file__).with_name("_screen_window.py")


def check_screen_library() -> None:
    """Check that the library of the windows is installed, or raise an InputError with how to install it."""
    if find_spec("pygame") is None:
        raise InputError("driver: screen needs pygame-ce; install it: pip install 'lightopt[screen]'")


class ScreenProcess:
    """A window on a monitor, black until it gets a picture at `port`; it ends when its client has closed that.

    Raises InputError: The library is missing, or the monitor is not there or has another resolution.
    Raises HardwareError: The process does not start.
    """

    def __init__(self, monitor: int, size: tuple[int, int], *, device: str) -> None:
        check_screen_library()
        with tempfile.TemporaryFile() as errors:
            # this interpreter, a file of this package
            arguments = [sys.executable, str(_WINDOW), *map(str, (monitor, *size))]
            self._process = start_apart(arguments, stdout=subprocess.PIPE, stderr=errors)
            watchdog = threading.Timer(_START_S, self._process.kill)
            watchdog.start()
            assert self._process.stdout is not None
            with self._process.stdout as answers:
                line = answers.readline()
            watchdog.cancel()
            errors.seek(0)
            words = errors.read().decode("utf-8", "replace").strip().splitlines()[-1:]
        answer: dict[str, Any] = json.loads(line) if line else {}
        if "port" not in answer:
            self._process.kill()
            self.close()
            if "problem" in answer:
                raise InputError(f"{device}: {answer['problem']}")
            raise HardwareError(f"{device}: the window's process did not start; its output: {''.join(words) or 'none'}")
        self.port = f"socket://127.0.0.1:{answer['port']}"

    def close(self) -> None:
        """Wait until the window is closed, which it is once its client has gone; never raises."""
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def start_apart(
    arguments: list[str], *, stdout: int, stderr: IO[bytes], cwd: Path | None = None
) -> subprocess.Popen[bytes]:
    """Start a program without input that Ctrl-C does not reach: it is for this one, which still has to show black."""
    return subprocess.Popen(  # noqa: S603  (without a shell)
        arguments,
        stdin=subprocess.DEVNULL,
        start_new_session=sys.platform != "win32",
        creationflags=0x00000200 if sys.platform == "win32" else 0,  # CREATE_NEW_PROCESS_GROUP
        stdout=stdout,
        stderr=stderr,
        cwd=cwd,
    )
