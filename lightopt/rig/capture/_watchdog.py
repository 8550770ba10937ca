"""Limits how long lights stay on at a stretch, even while everything else hangs or fails."""

import threading
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field

from lightopt.core.errors import error_text

_RETRY_S = 0.5  # a light that did not go dark is tried again after


@dataclass(eq=False)
class _LitPeriod:
    """A light that is on, until when [s, monotonic] it may be, and what ends the thread that watches it."""

    longest_s: float
    until: float
    over: threading.Event = field(default_factory=threading.Event)


class LightWatchdog:
    """Darkens lights that have been on for their `max_on_s`, each from a thread of its own.

    A light goes dark even if a camera hangs, a disk is slow or nobody is there. What was being done then fails at its
    next step, because its images would be wrong. If switching off fails, it is tried again, and no light waits for
    another whose controller hangs. `darken` switches a light off; a command under way on its link is broken off for it.
    """

    def __init__(self, darken: Callable[[str], None]) -> None:
        self._darken = darken
        self._lock = threading.Lock()
        self._periods: dict[str, _LitPeriod] = {}
        self._problems: dict[str, str] = {}
        # held while a light is darkened, so that it is not lit again meanwhile
        self._darkening: defaultdict[str, threading.Lock] = defaultdict(threading.Lock)

    def start(self, light: str, longest_s: float) -> None:
        """Allow a light to be on for so long [s] from now."""
        self.stop(light)
        period = _LitPeriod(longest_s, time.monotonic() + longest_s)
        with self._lock:
            self._problems.pop(light, None)
            self._periods[light] = period
        try:
            threading.Thread(target=self._watch, args=(light, period), daemon=True).start()
        except BaseException:  # the light is not lit then
            self.stop(light)
            raise

    def remaining_s(self, light: str) -> float | None:
        """Remaining time that a light may be on [s]; None where nothing limits it."""
        with self._lock:
            period = self._periods.get(light)
            return None if period is None else period.until - time.monotonic()

    def stop(self, light: str) -> None:
        """Stop watching a light, which is dark; waits while it is being darkened."""
        with self._darkening_of(light), self._lock:
            if period := self._periods.pop(light, None):
                period.over.set()

    def stop_all(self) -> None:
        """Stop watching all lights: they are dark, or switching them off was tried."""
        for light in tuple(self._periods):
            self.stop(light)

    def pop_problem(self, light: str) -> str | None:
        """Message about a light that had to be darkened, once; None where it had not."""
        with self._lock:
            return self._problems.pop(light, None)

    def _watch(self, light: str, period: _LitPeriod) -> None:
        """Darken a light when its time is up, and try again for as long as that fails."""
        wait_s = period.longest_s
        while not period.over.wait(wait_s):
            with self._darkening_of(light):
                if period.over.is_set():
                    return
                problem: str | None = None
                try:
                    self._darken(light)
                except BaseException as error:  # noqa: BLE001  (nothing that a driver raises may end the watch)
                    problem = error_text(error)
                with self._lock:
                    if problem is None:
                        self._periods.pop(light, None)
                        period.over.set()
                        self._problems[light] = (
                            f"{light} was on for its max_on_s of {period.longest_s:g} s and was switched off, "
                            "although it was still needed: something took longer than planned"
                        )
                    else:
                        self._problems[light] = (
                            f"{light} is on for longer than its max_on_s of {period.longest_s:g} s: {problem}"
                        )
            wait_s = _RETRY_S

    def _darkening_of(self, light: str) -> threading.Lock:
        with self._lock:
            return self._darkening[light]
