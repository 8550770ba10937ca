"""The serial link: deadlines, lost devices, exclusive ports, and the log of every byte."""

from __future__ import annotations

import ast
import contextlib
import errno
import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices import SerialLog, serial_ports
from lightopt.rig.devices._device import LinkLostError, ReplyError
from lightopt.rig.devices._serial_link import SerialLink

needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")


class Far:
    """The far end of a wire: a pseudo-terminal or a TCP connection."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        if kind == "pty":
            import pty
            import tty

            self.ours, self.theirs = pty.openpty()
            tty.setraw(self.theirs)
            self.port = os.ttyname(self.theirs)
        else:
            self.listener = socket.create_server(("127.0.0.1", 0))
            self.port = f"socket://127.0.0.1:{self.listener.getsockname()[1]}"
        self.open = True

    def link(self, **options: object) -> SerialLink:
        settings = {"device": "stage", "baud": 9600, "timeout_s": 0.3} | options
        link = SerialLink(self.port, **settings)  # type: ignore[arg-type]
        if self.kind == "tcp":
            self.connection, _ = self.listener.accept()
        return link

    def say(self, data: bytes) -> None:
        if self.kind == "pty":
            os.write(self.ours, data)
        else:
            self.connection.sendall(data)

    def hear(self) -> bytes:
        return os.read(self.ours, 100) if self.kind == "pty" else self.connection.recv(100)

    def answer(self, *replies: bytes, pause_s: float = 0.0) -> threading.Thread:
        """Wait for a command, then say the replies one after the other."""

        def run() -> None:
            self.hear()
            for reply in replies:
                self.say(reply)
                time.sleep(pause_s)

        thread = threading.Thread(target=run)
        thread.start()
        return thread

    def vanish(self) -> None:
        if not self.open:
            return
        self.open = False
        if self.kind == "pty":
            os.close(self.theirs)
            os.close(self.ours)
        else:
            self.listener.close()
            if hasattr(self, "connection"):
                self.connection.close()


@pytest.fixture(params=["tcp", pytest.param("pty", marks=needs_pty)])
def far(request: pytest.FixtureRequest) -> Iterator[Far]:
    end = Far(request.param)
    yield end
    end.vanish()


def test_reply_up_to_its_end(far: Far) -> None:
    link = far.link()
    thread = far.answer(b"OK\r", b"\nmore")
    assert link.query(b"Q:\r\n", end=b"\r\n") == b"OK\r\n"
    thread.join()
    assert link.read(end=re.compile(rb"m.r")) == b"mor"
    assert link.read(end=None) == b"e"
    link.close()


def test_a_device_that_dribbles_does_not_stretch_the_deadline(far: Far) -> None:
    """pyserial's readline starts its time anew with every byte."""
    link = far.link()
    thread = far.answer(*[b"x"] * 60, pause_s=0.05)
    with pytest.raises(
        ReplyError, match=r'stage on .*: the reply is incomplete after 0.3 s; sent "Q:", got "x+"'
    ) as raised:
        link.query(b"Q:", end=b"\n")
    assert str(raised.value).count("x") < 60
    thread.join()
    link.close()


def test_silence(far: Far) -> None:
    link = far.link(timeout_s=0.1)
    started = time.monotonic()
    with pytest.raises(ReplyError, match=r'no reply after 0.1 s; sent "\?\\x18", got nothing'):
        link.query(b"?\x18", end=b"\n")
    assert 0.1 <= time.monotonic() - started < 10
    link.close()


def test_what_lies_in_the_input_is_no_reply(far: Far) -> None:
    """It is thrown away before a command, logged and told."""
    link = far.link()
    far.say(b"OK\r\n")
    time.sleep(0.05)
    thread = far.answer(b"NG\r\n")
    assert link.query(b"Q:", end=b"\r\n") == b"NG\r\n"
    thread.join()
    assert [e.what for e in link.events] == ["discarded 4 unexpected bytes"]
    link.close()


def test_the_reply_to_a_query_that_was_interrupted_answers_no_other(far: Far, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C comes between a command and its reply; then the lights are switched off."""
    monkeypatch.setattr(SerialLink.drain, "__defaults__", (0.9,))  # however busy the machine
    link = far.link(timeout_s=10)
    first = far.answer(b"", b"OK for the first\r\n", pause_s=0.05)
    with monkeypatch.context() as patch:

        def interrupted(_: int) -> bytes:
            raise KeyboardInterrupt

        patch.setattr(link._serial, "read", interrupted)
        with pytest.raises(KeyboardInterrupt):
            link.query(b"first", end=b"\r\n")
    second = threading.Thread(target=lambda: (first.join(), far.answer(b"OK for the second\r\n").join()))
    second.start()
    assert link.query(b"second", end=b"\r\n") == b"OK for the second\r\n"
    second.join()
    assert "discarded 18 unexpected bytes" in link.events[-1].what
    link.close()


def test_draining_waits_for_what_comes_late(far: Far) -> None:
    link = far.link()
    link.send(b"Q:")
    thread = far.answer(b"O", b"K", b"\r\n", pause_s=0.03)
    link.drain(quiet_s=0.9)  # a busy machine may say the next byte later than it means to
    thread.join()
    with pytest.raises(ReplyError, match="no reply"):
        link.read(end=b"\n", deadline_s=0.05)
    assert "discarded 4 unexpected bytes" in link.events[-1].what
    link.close()


def test_draining_ends_although_the_device_babbles(far: Far) -> None:
    link = far.link()
    link.write(b"Q:")
    thread = far.answer(*[b"x"] * 120, pause_s=0.05)
    link.drain(quiet_s=0.9)
    assert thread.is_alive()  # it babbles on
    thread.join()
    link.close()


def test_a_device_that_vanishes_is_reported_whatever_is_done(far: Far) -> None:
    link = far.link(log=None)
    far.vanish()
    with pytest.raises(LinkLostError, match=r"stage on .*: the device is gone .*unknown"):
        link.read(end=b"\n")
    for action in (link.discard, link.drain, lambda: link.query(b"x", end=b"\n"), lambda: link.read(end=None)):
        with pytest.raises(LinkLostError):
            action()
    assert sum("device lost" in e.what for e in link.events) == 1
    link.close()
    link.close()


def test_a_device_that_vanishes_during_a_reply(far: Far) -> None:
    link = far.link(timeout_s=30)
    timer = threading.Timer(0.1, far.vanish)
    timer.start()
    started = time.monotonic()
    with pytest.raises(LinkLostError, match='sent "Q:"'):
        link.query(b"Q:", end=b"\n")
    assert time.monotonic() - started < 20
    timer.join()
    link.close()


def test_least_time_between_commands(far: Far) -> None:
    link = far.link(gap_s=0.05)
    link.send(b"a")
    started = time.monotonic()
    link.send(b"b")
    assert time.monotonic() - started >= 0.049
    link.close()


def test_dialogues_of_threads_do_not_mix(far: Far) -> None:
    link = far.link(timeout_s=2)

    def echo() -> None:
        data = b""
        while data != b"last":
            data = far.hear()
            time.sleep(0.002)
            far.say(data + b"\n")

    echoing = threading.Thread(target=echo)
    echoing.start()
    wrong: list[bytes] = []

    def ask(word: bytes) -> None:
        for _ in range(10):
            reply = link.query(word, end=b"\n")
            if reply != word + b"\n":
                wrong.append(reply)

    askers = [threading.Thread(target=ask, args=(word,)) for word in (b"first", b"second")]
    for thread in askers:
        thread.start()
    for thread in askers:
        thread.join()
    link.query(b"last", end=b"\n")
    echoing.join()
    assert wrong == []
    assert link.events == []
    link.close()


@needs_pty
def test_one_process_per_port() -> None:
    far = Far("pty")
    link = far.link()
    with pytest.raises(HardwareError, match=rf"laser: port {far.port} is in use by another program"):
        SerialLink(far.port, device="laser", baud=9600)
    program = (
        "from lightopt.rig.devices._serial_link import SerialLink\n"
        f"try: SerialLink({far.port!r}, device='x', baud=9600)\n"
        "except Exception as error: print(type(error).__name__, error)\n"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert said.startswith("HardwareError x: port")
    assert "in use" in said
    link.close()
    far.link().close()
    far.vanish()


def test_write_that_nobody_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    """pyserial's own default would wait for ever."""
    import serial
    from scripted import scripted_link

    link, port = scripted_link(monkeypatch, [])

    def refuse(_: bytes) -> int:
        raise serial.SerialTimeoutException("Write timeout")

    port.write = refuse  # type: ignore[method-assign]
    with pytest.raises(LinkLostError, match=r"does not take what is sent within 1 s; check flow control"):
        link.send(b"x")
    assert port.opened_with["write_timeout"] == 1.0
    assert scripted_link(monkeypatch, [], timeout_s=2.5)[1].opened_with["write_timeout"] == 2.5


@needs_pty
def test_write_that_the_line_holds_up() -> None:
    """More than the system takes at once: it is sent where the other end reads, and late where nobody does."""
    far = Far("pty")
    link = far.link()
    heard: list[bytes] = []

    def listen() -> None:
        while sum(map(len, heard)) < 50_000:
            heard.append(far.hear())

    listening = threading.Thread(target=listen)
    listening.start()
    link.write(bytes(range(250)) * 200)
    listening.join()
    assert b"".join(heard) == bytes(range(250)) * 200
    with pytest.raises(LinkLostError, match=r"does not take what is sent within 1 s; check flow control"):
        link.write(b"x" * 1_000_000)
    far.vanish()
    link.close()


@needs_pty
def test_a_line_that_refuses_what_it_seemed_to_take_is_late_and_not_tried_for_ever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    far = Far("pty")
    link = far.link()
    monkeypatch.setattr(link, "_write_s", 0.1)

    def refuse(_descriptor: int, _data: bytes) -> int:
        raise BlockingIOError(errno.EAGAIN, "again")

    with monkeypatch.context() as patched:
        patched.setattr(os, "write", refuse)
        begun = time.monotonic()
        with pytest.raises(LinkLostError, match=r"does not take what is sent within 0.1 s"):
            link.send(b"Q:")
    assert time.monotonic() - begun < 30.0
    far.vanish()
    link.close()


@pytest.mark.filterwarnings("ignore:set(Daemon|Name)")  # pyserial's
def test_a_port_of_rfc_2217_opens() -> None:
    """Of pyserial's own server; it knows no limit of a write."""
    import serial
    from serial.rfc2217 import PortManager

    listener = socket.create_server(("127.0.0.1", 0))
    device = serial.serial_for_url("loop://", timeout=0.05)
    ended = threading.Event()

    def serve() -> None:
        connection, _ = listener.accept()
        connection.settimeout(0.05)
        sender = type("Sender", (), {"write": staticmethod(connection.sendall)})()
        manager = PortManager(device, sender)
        while not ended.is_set():
            with contextlib.suppress(TimeoutError):
                received = connection.recv(1024)
                device.write(b"".join(manager.filter(received)))
            waiting = device.read(device.in_waiting)
            if waiting:
                connection.sendall(b"".join(manager.escape(waiting)))
        connection.close()

    serving = threading.Thread(target=serve)
    serving.start()
    link = SerialLink(f"rfc2217://127.0.0.1:{listener.getsockname()[1]}", device="lights", baud=9600)
    try:
        assert link.query(b"hello\n", end=b"\n") == b"hello\n"
    finally:
        link.close()
        ended.set()
        serving.join()
        listener.close()


@needs_pty
def test_a_busy_computer_is_no_dead_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that is held up while it writes or before it reads: the bytes were taken, and the reply is there."""
    far = Far("pty")
    link = far.link(timeout_s=0.1)
    monkeypatch.setattr(link, "_write_s", 0.1)
    taken = os.write

    def held_up(descriptor: int, data: bytes) -> int:
        time.sleep(0.2)
        count = taken(descriptor, data[:1])
        time.sleep(0.2)
        return count

    with monkeypatch.context() as patched:
        patched.setattr(os, "write", held_up)
        link.send(b"Q:")
    far.say(b"ready\n")
    reading = link._serial.read
    pauses = iter([0.2])

    def read_late(size: int) -> bytes:
        data = reading(size)
        time.sleep(next(pauses, 0.0))
        return data

    monkeypatch.setattr(link._serial, "read", read_late)
    assert link.read(end=b"\n") == b"ready\n"
    assert link.events == []
    link.close()
    far.vanish()


@needs_pty
def test_babble_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """What always has something more in the input is late all the same."""
    far = Far("pty")
    link = far.link(timeout_s=0.05)
    monkeypatch.setattr(link._serial, "read", lambda _: b"x")
    monkeypatch.setattr(type(link._serial), "in_waiting", property(lambda _: 1))
    with pytest.raises(ReplyError, match=r"the reply is incomplete after 0.05 s"):
        link.read(end=b"\n")
    link.close()
    far.vanish()


@pytest.mark.parametrize("failure", [OSError(5, "EIO"), ValueError])
def test_only_failures_of_the_device_are_failures_of_the_device(
    monkeypatch: pytest.MonkeyPatch, failure: BaseException | type[BaseException]
) -> None:
    from scripted import scripted_link

    link, port = scripted_link(monkeypatch, [])

    def fail(_: int) -> bytes:
        raise failure

    port.read = fail  # type: ignore[method-assign]
    with pytest.raises(LinkLostError if isinstance(failure, OSError) else ValueError):
        link.read(end=b"\n")


# ---- ports that cannot be opened: the user's to mend, before anything is sent


def test_missing_port_lists_those_that_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    port = "COM99" if sys.platform == "win32" else str(tmp_path / "ttyUSB0")
    with pytest.raises(
        InputError, match=rf"lamp: port {re.escape(port)} cannot be opened.*ports on this computer: "
    ) as e:
        SerialLink(port, device="lamp", baud=9600)
    listed = e.value.messages[0].partition("ports on this computer: ")[2]
    assert listed == "none" or all(p.name in listed for p in serial_ports())


def test_ports_are_listed_with_what_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    from serial.tools import list_ports
    from serial.tools.list_ports_common import ListPortInfo

    led, stage = ListPortInfo("/dev/ttyUSB1"), ListPortInfo("/dev/ttyS0")
    led.description, led.vid, led.pid, led.serial_number = "FT232R", 0x0403, 0x6001, "A50285BI"

    def comports(include_links: bool = False) -> list[ListPortInfo]:
        assert include_links
        return [led, stage]

    monkeypatch.setattr(list_ports, "comports", comports)
    first, second = serial_ports()
    assert (first.name, first.description, first.usb) == ("/dev/ttyS0", "", "")
    assert (second.name, second.description, second.usb) == ("/dev/ttyUSB1", "FT232R", "0403:6001 A50285BI")
    with pytest.raises(InputError, match=r"ports on this computer: /dev/ttyS0, /dev/ttyUSB1 \(FT232R\)"):
        SerialLink("/no/such/port", device="lamp", baud=9600)


@pytest.mark.parametrize("port", ["bogus://x", "/no/such/port", "hwgrep://no:thing"])
def test_ports_that_are_none(port: str) -> None:
    with pytest.raises(InputError, match=r"lamp: port .*(cannot be|is not a port)"):
        SerialLink(port, device="lamp", baud=9600)


@pytest.mark.parametrize("port", ["socket://", "socket://nowhere", "socket://:4000", "rfc2217://nowhere"])
def test_addresses_without_host_or_number(port: str) -> None:
    with pytest.raises(InputError, match=r"names no host and number; expected (socket|rfc2217)://host:number"):
        SerialLink(port, device="lamp", baud=9600)


def test_nobody_listens() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
    with pytest.raises(HardwareError, match=r"cannot be reached.*check address and network, that the device is on"):
        SerialLink(f"socket://127.0.0.1:{number}", device="lamp", baud=9600)


# ---- the log


def entries(path: Path) -> list[tuple[str, str, str]]:
    lines = path.read_text(encoding="utf-8").splitlines()
    pattern = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z (\S+) (in|out|note) +(.*)"
    found = [re.fullmatch(pattern, line) for line in lines]
    assert all(found)
    return [(m[1], m[2], m[3]) for m in found if m]


def test_every_byte_is_logged(far: Far, tmp_path: Path) -> None:
    path = tmp_path / "serial.log"
    log = SerialLog(path)
    link = far.link(log=log)
    thread = far.answer(b"\x00\xffOK\r\n")
    link.query(b"a\r\n", end=b"\r\n")
    thread.join()
    far.say(b"stale")
    time.sleep(0.05)
    link.send(b"b'\\")
    link.note("sent again", retry=True)
    assert (sum(event.retry for event in link.events), len(link.events)) == (1, 2)  # readable before anything is closed
    found = [(way, ast.literal_eval(what) if way != "note" else what) for _, way, what in entries(path)]
    assert found[1:] == [
        ("out", b"a\r\n"),
        ("in", b"\x00\xffOK\r\n"),
        ("in", b"stale"),
        ("note", "discarded 5 unexpected bytes"),
        ("out", b"b'\\"),
        ("note", "sent again"),
    ]
    link.close()
    assert entries(path)[-1] == (far.port, "note", "closed")
    log.close()
    log.write("p", "note", "after the end")
    assert len(entries(path)) == 8


def test_log_survives_a_kill(tmp_path: Path) -> None:
    path = tmp_path / "serial.log"
    program = (
        "import os\nfrom lightopt.rig.devices import SerialLog\n"
        f"log = SerialLog({str(path)!r})\nlog.write('COM1', 'out', b'SA#')\nos.kill(os.getpid(), 9)\n"
        if sys.platform != "win32"
        else "import os\nfrom lightopt.rig.devices import SerialLog\n"
        f"log = SerialLog({str(path)!r})\nlog.write('COM1', 'out', b'SA#')\nos._exit(9)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=False)
    assert entries(path) == [("COM1", "out", "b'SA#'")]


def test_log_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the serial log cannot be written"):
        SerialLog(tmp_path / "nowhere" / "serial.log")


class FullDisk:
    """A file on a disk that is full after the first entry."""

    closed = False

    def __init__(self) -> None:
        self.written: list[str] = []

    def write(self, text: str) -> None:
        if self.written:
            raise OSError(errno.ENOSPC, "No space left on device")
        self.written.append(text)

    def flush(self) -> None:
        pass

    def close(self) -> None:
        self.closed = True
        raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_ends_the_log_and_nothing_else(far: Far, tmp_path: Path) -> None:
    said: list[str] = []
    log = SerialLog(tmp_path / "serial.log", warn=said.append)
    log._file.close()
    log._file = FullDisk()  # type: ignore[assignment]
    link = far.link(log=log)  # the first entry
    for _ in range(3):
        link.write(b"off")
        assert far.hear() == b"off"
    assert [event.what for event in log.events] == said
    assert len(said) == 1
    assert "the serial log ends here, it can no longer be written: No space left" in said[0]
    link.close()
    log.close()


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are those of POSIX")
def test_an_unusual_baud_rate_is_reported() -> None:
    ours, theirs = os.openpty()
    try:
        link = SerialLink(os.ttyname(theirs), device="lamp", baud=38401)
        link.close()
    finally:
        os.close(ours)
        os.close(theirs)
    (event,) = link.events
    assert event.what.startswith("lamp: 38401 baud is unusual (usual are 1200, 2400, 4800, 9600, ")
