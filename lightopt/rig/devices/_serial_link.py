"""The serial link that drivers have: frames out, replies in, each within a total deadline.

The one home of pyserial. A reply is read byte by byte against one deadline for all of it, because a time limit per byte
would let a device that sends slowly hold up the caller for ever.
"""

import os
import re
import select
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO, TypeVar

import serial

from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices._device import Event, LinkLostError, PreemptedError, ReplyError, now, printable
from lightopt.rig.devices._serial_ports import cannot_open


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


try:
    from termios import error as _termios_error  # not an OSError
except ImportError:  # Windows
    _termios_error = OSError


_LOST = (serial.SerialException, OSError, _termios_error)
_SLICE_S = 0.02  # longest single wait for a byte; a deadline is kept to within it
_STALE_BYTES = 65536
_QUIET_S = 0.05  # a silence that ends a reply without an end
_DRAIN_S = 1.0  # longest that a line is listened to until it is silent
_WRITE_S = 1.0  # a write has this long at least: flow control may hold it up longer than a quick reply takes
_LATE_BYTES = 4096  # most that is read of what already lies in the input when a deadline is over
_SENT_BYTES = 300  # most of a command that a message has
_USUAL_BAUD = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)
Value = TypeVar("Value")


class PriorityLock:
    """A re-entrant lock that gives way to what cannot wait.

    As a context manager it waits for its turn. Who enters by :meth:`priority` takes the next turn, and the holder sees
    :attr:`preempted` and breaks off what it waits for. Of several with priority, none preempts another.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._urgent: set[object] = set()
        self._held_urgent = 0

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *exception: object) -> None:
        self._lock.release()

    @contextmanager
    def priority(self) -> Generator[None]:
        """Take the next turn, for what cannot wait, such as darkening a light."""
        mark = object()
        self._urgent.add(mark)
        try:
            with self._lock:
                self._urgent.discard(mark)
                self._held_urgent += 1
                try:
                    yield
                finally:
                    self._held_urgent -= 1
        finally:
            self._urgent.discard(mark)

    @property
    def preempted(self) -> bool:
        """Whether the holder, who asks this, should break off because something that cannot wait does."""
        return bool(self._urgent) and not self._held_urgent


class Link:
    """What a driver has of every link: whose it is, its lock, and how irregularities and failures are reported.

    Its `lock` is held during each dialogue; a driver holds it over dialogues that belong together. What cannot wait
    breaks them off by ``lock.priority()``; whoever waits for a reply then gets a :class:`PreemptedError`.
    """

    def __init__(self, port: str, *, device: str, timeout_s: float, log: SerialLog | None) -> None:
        self.port = port
        self.device = device
        self.timeout_s = timeout_s
        self.events: list[Event] = []
        self.lock = PriorityLock()
        self._log = log or SerialLog()

    def note(self, what: str, *, retry: bool = False) -> None:
        """Report an irregularity: in `events`, and to the log."""
        event = Event(now(), self.port, what, retry)
        self.events.append(event)
        self._log.note(event)

    def failure(
        self, problem: str, *, sent: bytes = b"", reply: bytes | None = None, kind: type[HardwareError] = HardwareError
    ) -> HardwareError:
        """Error that names device and port, what went wrong, the command, and the reply."""
        more = f" and {len(sent) - _SENT_BYTES} bytes more" if len(sent) > _SENT_BYTES else ""
        command = f"; sent {printable(sent[:_SENT_BYTES])}{more}" if sent else ""
        answer = "" if reply is None else f", got {printable(reply)}"
        return kind(f"{self.device} on {self.port}: {problem}{command}{answer}")

    def preempted(self, sent: bytes = b"") -> HardwareError:
        """Error of what was broken off for something that cannot wait."""
        why = "no longer waited for, because a light had to be switched off"
        return self.failure(why, sent=sent, kind=PreemptedError)

    def drain(self) -> None:
        """Read and discard what is on its way; nothing where there are no late replies."""

    def close(self) -> None:
        """Give up the link; never raises."""


class SerialLink(Link):
    """A serial port, or anything else that pyserial reaches by a URL, that a driver speaks through.

    Raises InputError when the port is not there (the message lists those that are), is none, or may not be opened.
    Raises HardwareError when another program has it, or nothing answers at its address.
    """

    def __init__(
        self,
        port: str,
        *,
        device: str,  # what stands behind it, for messages: controller main (ccs)
        baud: int,
        rtscts: bool = False,
        timeout_s: float = 1.0,  # deadline [s] of a whole reply where a call names none; of a write, a second at least
        gap_s: float = 0.0,  # least time [s] between the end of a dialogue and the next command
        log: SerialLog | None = None,
    ) -> None:
        super().__init__(port, device=device, timeout_s=timeout_s, log=log)
        self._write_s = max(timeout_s, _WRITE_S)
        self._gap_s = gap_s
        self._quiet_since = 0.0
        self._lost = False
        self._owed = False
        try:
            self._serial = serial.serial_for_url(
                port,
                baudrate=baud,
                rtscts=rtscts,
                timeout=_SLICE_S,
                # pyserial's RFC 2217 knows no limit of a write, and refuses one
                write_timeout=None if port.startswith("rfc2217:") else self._write_s,
                exclusive=True,
            )
            self._selectable = False
            with suppress(AttributeError, OSError):  # rfc2217 has no descriptor for select
                self._serial.fileno()
                self._selectable = os.name == "posix"
        except (ValueError, *_LOST) as error:
            raise cannot_open(port, device, error) from None
        self._log.write(port, "note", f"opened at {baud} baud for {device}")
        if "://" not in port and baud not in _USUAL_BAUD:
            usual = ", ".join(map(str, _USUAL_BAUD))
            self.note(f"{device}: {baud} baud is unusual (usual are {usual}); garbage or silence may come of it")

    def query(self, frame: bytes, *, end: bytes | re.Pattern[bytes] | None) -> bytes:
        """Discard pending input, send a frame, and read the reply; see :meth:`read`."""
        with self.lock:
            self.send(frame)
            self._owed = True
            reply = self.read(end=end, after=frame)
            self._owed = False
            return reply

    def send(self, frame: bytes) -> None:
        """Discard pending input and send a frame without waiting for a reply.

        Where the query before was broken off (its reply was late, or the program was interrupted), the reply may still
        be on its way; the line is then first listened to until it is silent.
        """
        with self.lock:
            if self._owed:
                self._owed = False
                self.drain()
            else:
                self.discard()
            wait_s = self._quiet_since + self._gap_s - time.monotonic()
            if wait_s > 0:
                time.sleep(wait_s)
            self.write(frame)

    def write(self, data: bytes) -> None:
        """Send bytes and leave the input as it is: for single bytes that a device obeys in the midst of a dialogue."""
        with self.lock:
            moment = now()
            try:
                self._guarded(lambda: self._take(data), data)
            finally:  # bytes first: whatever becomes of the log, a light is switched off
                self._log.write(self.port, "out", data, moment)
            self._quiet_since = time.monotonic()

    def read(
        self, *, end: bytes | re.Pattern[bytes] | None, deadline_s: float | None = None, after: bytes = b""
    ) -> bytes:
        """Read a reply up to and with its end. What lies in the input at the deadline was in time and is read, too.

        end: Bytes that end it; or a pattern, which ends it where it is first found; or None: silence after at least one
            byte.
        after: The command that was sent, for messages.

        Raises ReplyError when the deadline passes before the end, PreemptedError when something that cannot wait needs
        the wire, LinkLostError when the device is gone.
        """
        limit_s = self.timeout_s if deadline_s is None else deadline_s
        until = time.monotonic() + limit_s
        got = bytearray()
        late = 0
        heard = time.monotonic()
        entry = LogEntry(self._log, self.port)
        with self.lock:
            try:
                while True:
                    data = self._guarded(lambda: self._serial.read(1), after)
                    moment = time.monotonic()
                    if data:
                        heard = moment
                        got += data
                        entry.add(data)
                        if _ended(got, end):
                            return bytes(got)
                    else:
                        entry.write()
                        if end is None and got and moment - heard >= _QUIET_S:
                            return bytes(got)
                    if self.lock.preempted:
                        raise self.preempted(after)
                    if moment >= until:
                        # a computer that was busy finds the reply there: it is the device that may be late
                        if late == _LATE_BYTES or not self._guarded(lambda: self._serial.in_waiting, after):
                            problem = f"{'the reply is incomplete' if got else 'no reply'} after {limit_s:g} s"
                            raise self.failure(problem, sent=after, reply=bytes(got), kind=ReplyError)
                        late += 1
            finally:
                entry.write()
                self._quiet_since = time.monotonic()

    def drain(self, quiet_s: float = 0.1) -> None:
        """Read and discard until the line is silent for `quiet_s`: no late reply shall answer the next command."""
        with self.lock:
            until = time.monotonic() + _DRAIN_S
            heard = time.monotonic()
            entry = LogEntry(self._log, self.port)
            while not (preempted := self.lock.preempted) and time.monotonic() < min(until, heard + quiet_s):
                data = self._guarded(lambda: self._serial.read(1), b"")
                if data:
                    heard = time.monotonic()
                    entry.add(data)
            self._note_discarded(entry)
            if preempted:
                self._owed = True
                raise self.preempted()

    def discard(self) -> None:
        """Discard pending input, without waiting; it is logged and reported as an event."""
        with self.lock:
            entry = LogEntry(self._log, self.port)
            # in_waiting only shows whether there is anything: over TCP it is never more than 1
            while len(entry.data) < _STALE_BYTES and self._guarded(lambda: self._serial.in_waiting, b""):
                data = self._guarded(lambda: self._serial.read(1), b"")
                if not data:
                    break
                entry.add(data)
            self._note_discarded(entry)

    def close(self) -> None:
        with self.lock:
            # pyserial leaves the socket of a lost peer open
            connection = getattr(self._serial, "_socket", None)
            try:
                self._serial.close()
                if connection is not None:
                    connection.close()
            except _LOST as error:
                self.note(f"closing failed: {error}")
            self._log.write(self.port, "note", "closed")

    def _take(self, data: bytes) -> None:
        # pyserial calls a write late by the clock alone, even if every byte was taken at once: a computer that was busy
        # for a second would be a dead line. Late is what is not taken while we wait, which select asks at its end, too.
        if not (self._selectable and self._serial.is_open):
            self._serial.write(data)
            return
        until = time.monotonic() + self._write_s
        while data:
            _, free, _ = select.select([], [self._serial], [], max(until - time.monotonic(), 0.0))
            if not free:
                raise serial.SerialTimeoutException
            try:
                data = data[os.write(self._serial.fileno(), data) :]
            except BlockingIOError:
                if time.monotonic() > until:
                    raise serial.SerialTimeoutException from None

    def _guarded(self, action: Callable[[], Value], sent: bytes) -> Value:
        try:
            return action()
        except serial.SerialTimeoutException:
            late = f"does not take what is sent within {self._write_s:g} s; check flow control and cable"
            raise self.failure(late, sent=sent, kind=LinkLostError) from None
        except _LOST as error:
            if not self._lost:
                self._lost = True
                self.note(f"device lost: {error}")
            gone = "the device is gone (unplugged, switched off, or another program reads from the port)"
            raise self.failure(f"{gone}; what it does now is unknown", sent=sent, kind=LinkLostError) from None

    def _note_discarded(self, entry: LogEntry) -> None:
        count = len(entry.data)
        entry.write()
        if count:
            self.note(f"discarded {count} unexpected bytes")


def _ended(got: bytearray, end: bytes | re.Pattern[bytes] | None) -> bool:
    if end is None:
        return False
    return got.endswith(end) if isinstance(end, bytes) else end.search(got) is not None
