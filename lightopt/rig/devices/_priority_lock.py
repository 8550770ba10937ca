"""Whose turn it is on a wire: one dialogue at a time, and what cannot wait before all others."""

from __future__ import annotations

import threading
from collections.abc import Generator
from contextlib import contextmanager


class Turns:
    """A lock that its holder may take again, and that gives way to what cannot wait.

    Used as a context manager it waits for its turn. Whoever comes by :meth:`first` is seen by the holder as
    :attr:`overtaken`, who then breaks off what it waits for. Of several that cannot wait, none overtakes another.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._pressing: set[object] = set()
        self._held_first = 0

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *exception: object) -> None:
        self._lock.release()

    @contextmanager
    def first(self) -> Generator[None]:
        """Take the next turn, for what cannot wait, such as darkening a light."""
        mark = object()
        self._pressing.add(mark)
        try:
            with self._lock:
                self._pressing.discard(mark)
                self._held_first += 1
                try:
                    yield
                finally:
                    self._held_first -= 1
        finally:
            self._pressing.discard(mark)

    @property
    def overtaken(self) -> bool:
        """Whether the holder, who asks this, should break off because something that cannot wait does."""
        return bool(self._pressing) and not self._held_first
