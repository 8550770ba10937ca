"""The wires between simulated devices and their clients: pseudo-terminals, and TCP where there are none.

`port` of a wire is what a client opens; `waiting` are file descriptors to watch for something to read, none once the
cable is pulled. Nothing is waited for: `receive` takes what has come, a connection included; `send` returns how many
bytes the wire took, and without a client they are lost; `pull` pulls the cable, for good.

Their faults are replies that are lost, late, cut short or garbled, and a cable that is pulled.
"""

import contextlib
import os
import random
import socket
import sys
from collections.abc import Mapping
from typing import Any

from lightopt.rig.simulated._firmware import Trigger, trigger

have_ptys = sys.platform != "win32"


class PtyWire:
    """A pseudo-terminal: for the client a serial port."""

    def __init__(self) -> None:
        import pty
        import tty

        self._ours, self._theirs = pty.openpty()
        # The client's end stays open here too, so that clients can come and go; raw, or it would echo.
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.port = os.ttyname(self._theirs)
        self._open = True

    @property
    def waiting(self) -> tuple[int, ...]:
        return (self._ours,) if self._open else ()

    def receive(self) -> bytes:
        with contextlib.suppress(BlockingIOError):
            return os.read(self._ours, 4096) if self._open else b""
        return b""

    def send(self, data: bytes) -> int:
        if not self._open:
            return len(data)
        with contextlib.suppress(BlockingIOError):
            return os.write(self._ours, data)
        return 0

    def pull(self) -> None:
        if self._open:
            self._open = False
            os.close(self._theirs)
            os.close(self._ours)


class TcpWire:
    """A TCP socket on the loopback that serves one client at a time, as controllers with Ethernet do.

    wedges: Whether a client that connects and leaves without a word puts the device out of order, as the PD3-EI does.
    """

    def __init__(self, *, wedges: bool = False) -> None:
        self._wedges = wedges
        self._wedged = False
        self._spoken = False
        self._client: socket.socket | None = None
        self._listener: socket.socket | None = None
        self._number = 0
        self._listen()
        self.port = f"socket://127.0.0.1:{self._number}"

    @property
    def waiting(self) -> tuple[int, ...]:
        return tuple(s.fileno() for s in (self._client, self._listener) if s is not None)

    def receive(self) -> bytes:
        if self._client is None:
            self._accept()
            return b""
        try:
            data = self._client.recv(4096)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._client.close()
            self._client = None
            self._wedged = self._wedged or (self._wedges and not self._spoken)
            self._listen()
            return b""
        self._spoken = True
        return b"" if self._wedged else data

    def send(self, data: bytes) -> int:
        if self._client is None:
            return len(data)
        try:
            return self._client.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            return len(data)

    def pull(self) -> None:
        for s in (self._client, self._listener):
            if s is not None:
                s.close()
        self._client = self._listener = None

    def _listen(self) -> None:
        listener = socket.socket()
        if sys.platform != "win32":  # there it would let others share the port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", self._number))
        listener.listen(1)
        listener.setblocking(False)
        self._number = listener.getsockname()[1]
        self._listener = listener

    def _accept(self) -> None:
        if self._listener is None:
            return
        with contextlib.suppress(OSError):
            self._client, _ = self._listener.accept()
            self._client.setblocking(False)
            self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._spoken = False
            # A second client is refused at once instead of hanging in the queue.
            self._listener.close()
            self._listener = None


# by name, each with its option and the default of that
LINE_FAULTS: dict[str, dict[str, Any]] = {
    "drop": {},
    "delay": {"delay_s": 0.5},
    "truncate": {"keep": 1},
    "garbage_before": {"bytes": 3},
    "garbage_instead": {"bytes": 5},
    "vanish": {"obeyed": False},
}


class FaultyLine:
    """Transmits the bytes that a device sends, with faults.

    Faults, each with the options of :class:`Trigger`: ``drop``; ``delay`` (by ``delay_s``); ``truncate`` (to ``keep``
    bytes); ``garbage_before`` and ``garbage_instead`` (so many ``bytes``); ``vanish`` (the cable is pulled when a
    command arrives; ``obeyed``: whether the device still hears it). Occasions of ``vanish`` are deliveries of bytes to
    the device, those of the others are replies.
    """

    def __init__(self) -> None:
        self._faults: list[tuple[str, Trigger, dict[str, Any]]] = []

    def inject(self, kind: str, options: Mapping[str, Any]) -> None:
        if kind == "clear":
            self._faults.clear()
            return
        chosen = dict(options)
        values = {key: chosen.pop(key, value) for key, value in LINE_FAULTS[kind].items()}
        values["seed"] = chosen.get("seed", 0)
        self._faults.append((kind, trigger(kind, chosen), values))

    def pulled(self) -> bool | None:
        """Whether the cable is pulled as bytes arrive at the device: None if not, else whether it still hears them."""
        for kind, strikes, options in self._faults:
            if kind == "vanish" and strikes.strikes():
                return bool(options["obeyed"])
        return None

    def carry(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        """What arrives at the client of a reply that the device sends at a time [s], and when."""
        due = now
        for kind, strikes, options in self._faults:
            if kind == "vanish" or not strikes.strikes():
                continue
            if kind == "drop":
                data = b""
            elif kind == "delay":
                due = now + float(options["delay_s"])
            elif kind == "truncate":
                data = data[: int(options["keep"])]
            else:
                # bytes as a disturbed line has them: any but those that end or begin commands
                chance = random.Random(int(options["seed"]))  # noqa: S311  (noise, not a secret)
                noise = bytes(chance.choice(range(0x80, 0xFF)) for _ in range(int(options["bytes"])))
                data = noise + (data if kind == "garbage_before" else b"")
        return [(due, data)] if data else []
