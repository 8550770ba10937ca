"""How long lights may burn at a stretch, kept even while everything else hangs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from lightopt.errors import LightoptError

__all__ = ["BurnWatch"]

_AGAIN_S = 0.5  # a light that did not go dark is tried again after


@dataclass
class _Burning:
    """A light that burns, until when [s, monotonic] it may, and the timer that ends it."""

    until: float
    timer: threading.Timer


class BurnWatch:
    """Darkens lights that burn for as long as they may, from a thread of its own.

    A camera that hangs, a disk that is slow, a person who went away: the light goes dark all the same. What was being
    done then fails at its next step, because its images would be wrong.

    Parameters
    ----------
    darken
        Switches a light off; a command that is under way on its link is broken off for it.
    """

    def __init__(self, darken: Callable[[str], None]) -> None:
        self._darken = darken
        self._lock = threading.Lock()
        self._burning: dict[str, _Burning] = {}
        self._ended: dict[str, str] = {}

    def begin(self, light: str, longest_s: float) -> None:
        """From now on a light may burn so long [s]."""
        self.end(light)
        with self._lock:
            self._ended.pop(light, None)
            self._burning[light] = _Burning(
                time.monotonic() + longest_s, self._timer(light, longest_s, longest_s)
            )

    def left_s(self, light: str) -> float | None:
        """How long a light may burn on [s]; None where nothing limits it."""
        with self._lock:
            burning = self._burning.get(light)
            return None if burning is None else burning.until - time.monotonic()

    def end(self, light: str) -> None:
        """A light is dark."""
        with self._lock:
            if burning := self._burning.pop(light, None):
                burning.timer.cancel()

    def end_all(self) -> None:
        """All lights are dark, or all was tried."""
        for light in tuple(self._burning):
            self.end(light)

    def ended(self, light: str) -> str | None:
        """What to say of a light that had to be darkened; None where it had not. It is said once."""
        with self._lock:
            return self._ended.pop(light, None)

    def _timer(self, light: str, wait_s: float, longest_s: float) -> threading.Timer:
        timer = threading.Timer(wait_s, lambda: self._strike(light, timer, longest_s))
        timer.daemon = True
        timer.start()
        return timer

    def _strike(self, light: str, timer: threading.Timer, longest_s: float) -> None:
        """Time is up: darken, and try again for as long as that fails."""
        with self._lock:  # held while darkening, so that the light is not lit anew in between
            burning = self._burning.get(light)
            if burning is None or burning.timer is not timer:
                return
            try:
                self._darken(light)
            except LightoptError as error:
                self._ended[light] = f"{light} burns longer than its max_on_s of {longest_s:g} s: {error}"
                burning.timer = self._timer(light, _AGAIN_S, longest_s)
                return
            del self._burning[light]
            self._ended[light] = (
                f"{light} burned for its max_on_s of {longest_s:g} s and was switched off, although it was still "
                "needed: something took longer than planned"
            )
