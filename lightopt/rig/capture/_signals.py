"""Signals that end a run: each unwinds it as Ctrl-C does, and none interrupts switching off."""

import signal
import threading
from collections.abc import Generator
from contextlib import contextmanager
from types import CodeType, FrameType
from typing import Any

from lightopt.core.interrupts import put_off

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")


class EndSignals:
    """While active, SIGINT, SIGTERM, SIGHUP and Windows' SIGBREAK raise :class:`KeyboardInterrupt` in the main thread.

    After the first one the others are held back, so that none interrupts while the rig is made safe, which takes a
    bounded time. A signal that is ignored (as SIGHUP under nohup) stays ignored. In a thread other than the
    main one nothing is changed. `pending` is the name of the signal that came while shielded.
    """

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}
        self._shielded = False
        self.pending: str | None = None
        self._holding: set[CodeType] = set()

    def install(self) -> "EndSignals":
        for name in _NAMES if threading.current_thread() is threading.main_thread() else ():
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._receive)
        return self

    def restore(self, *_exception: object) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)
        self._before.clear()

    __enter__, __exit__ = install, restore

    @contextmanager
    def shielded(self) -> Generator[None]:
        """Hold signals back while the rig is made safe; see :attr:`pending`."""
        self._shielded = True
        try:
            yield
        finally:
            self._shielded = False

    def hold_in(self, code: CodeType) -> None:
        """Hold signals back from the first instruction of a function on: before it can ask for :meth:`shielded`."""
        self._holding.add(code)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        name, caller = signal.Signals(number).name, frame
        while caller is not None and caller.f_code not in self._holding:
            caller = caller.f_back
        if self._shielded or caller is not None:
            self.pending = name
            return
        if put_off(number, frame):
            return
        self._shielded = True  # here, because a second signal may come before anybody catches this one
        raise KeyboardInterrupt(name)
