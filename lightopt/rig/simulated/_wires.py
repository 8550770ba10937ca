"""The wires between simulated devices and their clients: pseudo-terminals, and TCP where there are none."""

import contextlib
import os
import socket
import sys
from typing import Protocol

have_ptys = sys.platform != "win32"


class Wire(Protocol):
    """One end of a wire; everything on it is done without waiting.

    port: What a client opens.
    waiting: File descriptors to watch for something to read; none once the cable is pulled.
    receive: Take what has come, a connection included; often nothing.
    send: Send, and return how many bytes the wire took; without a client they are lost.
    pull: Pull the cable, for good.
    """

    @property
    def port(self) -> str: ...
    @property
    def waiting(self) -> tuple[int, ...]: ...
    def receive(self) -> bytes: ...
    def send(self, data: bytes) -> int: ...
    def pull(self) -> None: ...


class PtyWire:
    """A pseudo-terminal: for the client a serial port."""

    def __init__(self) -> None:
        import pty
        import tty

        self._ours, self._theirs = pty.openpty()
        # The client's end stays open here too, so that clients can come and go; raw, or it would echo.
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self._name = os.ttyname(self._theirs)
        self._open = True

    @property
    def port(self) -> str:
        return self._name

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
        self._pulled = False
        self._listen()

    @property
    def port(self) -> str:
        return f"socket://127.0.0.1:{self._number}"

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
            self._leave()
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
        self._pulled = True
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

    def _leave(self) -> None:
        assert self._client is not None
        self._client.close()
        self._client = None
        self._wedged = self._wedged or (self._wedges and not self._spoken)
        if not self._pulled:
            self._listen()
