"""Log of the serial links: every byte in a file, and irregularities as they happen."""

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from lightopt.core.errors import InputError
from lightopt.rig.devices._device import Event, now


class SerialLog:
    """Log of the wires of a run: every byte is written to a file, and irregularities are reported.

    The text file has time (UTC), port, direction, and bytes as a Python literal. Entries are appended and flushed one
    by one, so that the file is whole up to the moment of a crash. Links of several threads may share it. Once opened it
    never raises: a disk that is full must not keep a light from being switched off. The first entry that cannot be
    written ends the file, which is reported once, and kept in `events`. `warn` is called with irregularities, from the
    thread in which they happen.
    """

    def __init__(self, path: Path | str | None = None, *, warn: Callable[[str], None] | None = None) -> None:
        self.events: list[Event] = []
        self._path = path
        self._warn = warn
        self._lock = threading.Lock()
        self._file: TextIO | None = None
        if path is not None:
            try:
                self._file = Path(path).open("a", encoding="utf-8", newline="\n")  # noqa: SIM115  (lives as long as the log)
            except OSError as error:
                raise InputError(f"{path}: the serial log cannot be written: {error.strerror or error}") from None

    def write(self, port: str, direction: str, what: bytes | str, time: str = "") -> None:
        """Append an entry: bytes that went ``out`` or came ``in``, or words as a ``note``."""
        text = what if isinstance(what, str) else repr(what)
        with self._lock:
            if self._file is None or self._file.closed:
                return
            try:
                self._file.write(f"{time or now()} {port} {direction:4} {text}\n")
                self._file.flush()
            except (OSError, ValueError) as error:
                reason = getattr(error, "strerror", None) or error
                problem = f"{self._path}: the serial log ends here, it can no longer be written: {reason}"
                self.events.append(Event(now(), str(self._path), problem))
                with suppress(OSError, ValueError):
                    self._file.close()  # tries once more to write what is left
            else:
                return
        self._report(problem)

    def note(self, event: Event) -> None:
        self.write(event.port, "note", event.what, event.time)
        self._report(f"{event.port}: {event.what}")

    def close(self) -> None:
        """Close the file; later entries are dropped. Never raises."""
        with self._lock, suppress(OSError, ValueError):
            if self._file is not None:
                self._file.close()

    def _report(self, what: str) -> None:
        if self._warn is not None:
            with suppress(OSError, ValueError):  # a terminal that is gone keeps no light on
                self._warn(what)


@dataclass
class LogEntry:
    """Bytes that came together, on their way into the log."""

    log: SerialLog
    port: str
    time: str = ""  # of the first of them
    data: bytearray = field(default_factory=bytearray)

    def add(self, data: bytes) -> None:
        self.time = self.time or now()
        self.data += data

    def write(self) -> None:
        if self.data:
            self.log.write(self.port, "in", bytes(self.data), self.time)
            self.time = ""
            self.data.clear()
