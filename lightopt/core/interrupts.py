"""Ctrl-C that does not raise where compiled code calls Python, and programs that it does not reach.

llvmlite releases what numba compiled in finalisers that hold a lock. Python swallows what is raised in a finaliser, the
interrupt is lost, the lock stays taken, and the next kernel waits for ever. Kernels take their constants apart by a
function of numba's, and make a SystemError of what it raises.
"""

import _thread
import os
import signal
import subprocess
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_AGAIN_AFTER_S = 0.005
_CALLED_BY_COMPILED_CODE = ("llvmlite", "numba.core.serialize")


def interrupt(number: int, frame: FrameType | None) -> None:
    """Handler of SIGINT that raises :class:`KeyboardInterrupt`, but not where compiled code calls Python."""
    if not put_off(number, frame):
        raise KeyboardInterrupt


def put_off(number: int, frame: FrameType | None) -> bool:
    """Whether compiled code was calling Python when the signal came; if so, it is sent again a little later."""
    while frame is not None:
        name = str(frame.f_globals.get("__name__"))
        if any(name == one or name.startswith(f"{one}.") for one in _CALLED_BY_COMPILED_CODE):
            # not a threading.Thread, whose start takes a lock that the main thread may be holding
            _thread.start_new_thread(_send_again, (number,))
            return True
        frame = frame.f_back
    return False


def start_apart(arguments: list[str], **options: Any) -> subprocess.Popen[Any]:
    """Start a program that Ctrl-C does not reach: it is for this one, which still has lights to switch off."""
    # in a group of its own
    apart: dict[str, Any] = {"creationflags": 0x00000200} if os.name == "nt" else {"start_new_session": True}
    return subprocess.Popen(arguments, **apart, **options)  # noqa: S603  (without a shell)


@contextmanager
def held_back() -> Generator[None]:
    """Keep Ctrl-C for the end of the block, where starting something must not be interrupted half way.

    Processes that are started in it, or by threads that are, never get it; on Windows they do.
    """
    came = list[int]()
    in_main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number)) if in_main else None
    blocked = None
    if hasattr(signal, "pthread_sigmask"):
        from multiprocessing import resource_tracker

        resource_tracker.ensure_running()  # which would unblock it in the thread that starts the first process
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if blocked is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        if in_main:
            signal.signal(signal.SIGINT, handler)
    if came:
        signal.raise_signal(signal.SIGINT)


def _send_again(number: int) -> None:
    time.sleep(_AGAIN_AFTER_S)
    if hasattr(signal, "pthread_kill"):
        # unlike the other, it wakes a main thread that waits
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        _thread.interrupt_main(signal.Signals(number))
