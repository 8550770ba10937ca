"""What happened on the wires: every byte in a file, and what was out of the ordinary in a list."""

from __future__ import annotations

import threading
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
    threads may share it.

    Parameters
    ----------
    path
        The file; made if it is not there, continued if it is.

    Raises
    ------
    lightopt.errors.InputError
        When it cannot be written.
    """

    def __init__(self, path: Path | str) -> None:
        self._lock = threading.Lock()
        try:
            self._file = Path(path).open("a", encoding="utf-8", newline="\n")  # noqa: SIM115  (lives as long as the log)
        except OSError as error:
            raise InputError(f"{path}: the serial log cannot be written: {error.strerror or error}") from None

    def write(self, port: str, direction: str, what: bytes | str, time: str = "") -> None:
        """Append an entry: bytes that went ``out`` or came ``in``, or words as a ``note``."""
        text = what if isinstance(what, str) else repr(what)
        with self._lock:
            if not self._file.closed:
                self._file.write(f"{time or now()} {port} {direction:4} {text}\n")
                self._file.flush()

    def close(self) -> None:
        """Close the file; later entries are dropped."""
        with self._lock:
            self._file.close()


def now() -> str:
    """Now, UTC, ISO 8601 with microseconds."""
    return datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
