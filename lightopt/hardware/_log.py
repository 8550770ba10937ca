"""What happened on the wires: every byte in a file, and what was out of the ordinary in a list."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

from lightopt.errors import InputError

__all__ = ["Event", "SerialLog"]


@dataclass(frozen=True)
class Event:
    """Something out of the ordinary on a link.

    Attributes
    ----------
    time
        When, UTC, ISO 8601.
    port
        On which port.
    what
        What, in words.
    retry
        Whether it is a command sent again.
    """

    time: str
    port: str
    what: str
    retry: bool = False

    def as_dict(self) -> dict[str, str | bool]:
        """JSON form."""
        return {"time": self.time, "port": self.port, "what": self.what, "retry": self.retry}


class SerialLog:
    """A text file with every byte on the wires of a run: time (UTC), port, direction, bytes as a Python literal.

    Entries are appended and flushed one by one, so that the file is whole up to the moment of a crash. Links of several
    threads may share it. Once opened it never raises: a disk that is full must not keep a light from being switched
    off. The first entry that cannot be written ends the log, which is warned of once.

    Parameters
    ----------
    path
        The file; made if it is not there, continued if it is.
    warn
        Called once if the log ends early.

    Attributes
    ----------
    events
        That it ended early, if it did.

    Raises
    ------
    lightopt.errors.InputError
        When it cannot be written.
    """

    def __init__(self, path: Path | str, *, warn: Callable[[str], None] | None = None) -> None:
        self.events: list[Event] = []
        self._path = path
        self._warn = warn
        self._lock = threading.Lock()
        try:
            self._file = Path(path).open("a", encoding="utf-8", newline="\n")  # noqa: SIM115  (lives as long as the log)
        except OSError as error:
            raise InputError(f"{path}: the serial log cannot be written: {error.strerror or error}") from None

    def write(self, port: str, direction: str, what: bytes | str, time: str = "") -> None:
        """Append an entry: bytes that went ``out`` or came ``in``, or words as a ``note``."""
        text = what if isinstance(what, str) else repr(what)
        with self._lock:
            if self._file.closed:
                return
            try:
                self._file.write(f"{time or now()} {port} {direction:4} {text}\n")
                self._file.flush()
            except (OSError, ValueError) as error:
                problem = self._end(error)
            else:
                return
        if self._warn is not None:
            self._warn(problem)

    def close(self) -> None:
        """Close the file; later entries are dropped. Never raises."""
        with self._lock, suppress(OSError, ValueError):
            self._file.close()

    def _end(self, error: OSError | ValueError) -> str:
        """Give the log up; what to say of it."""
        reason = getattr(error, "strerror", None) or error
        problem = f"{self._path}: the serial log ends here, it can no longer be written: {reason}"
        self.events.append(Event(now(), str(self._path), problem))
        with suppress(OSError, ValueError):
            self._file.close()  # tries once more to write what is left
        return problem


def now() -> str:
    """Now, UTC, ISO 8601 with microseconds."""
    return datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
