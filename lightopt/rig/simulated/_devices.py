"""The devices of a virtual bench: firmware, and its wire (a pseudo-terminal, or TCP where there are none).

`port` of a wire is what a client opens; `waiting` are file descriptors to watch for something to read, none once the
cable is pulled. Nothing is waited for: `receive` takes what has come, a connection included; `send` returns how many
bytes the wire took, and without a client they are lost; `pull` pulls the cable, for good.
"""

import contextlib
import math
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Collection, Mapping
from typing import Any, TypeVar

from lightopt.rig.simulated._firmware import Firmware, SeenPicture, build

T = TypeVar("T")
Response = tuple[dict[str, Any], bytes]  # a JSON object, and bytes that follow it; often none
# Answers a request; all run in one thread. A ValueError or KeyError becomes the asker's.
Handler = Callable[[Mapping[str, Any]], Response]
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
    """A loopback socket for one client at a time."""

    def __init__(self) -> None:
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
            self._listen()
        return data

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
            # A second client is refused at once instead of hanging in the queue.
            self._listener.close()
            self._listener = None


_TICK_S = 0.005  # how late a device may be with what it sends on its own while it is awake
_AWAKE_S = 1.0  # a device is awake for so long after it was sent something
_ASLEEP_S = 0.05  # how late another device may be: polling all of them as often would keep a bench busy


class Device:
    def __init__(self, kind: str, options: dict[str, Any], wire: PtyWire | TcpWire) -> None:
        self.firmware = build(kind, options)
        self.wire = wire
        self._out = b""
        self._received_at = -math.inf
        self.polled_at = -math.inf

    def is_awake(self, now: float) -> bool:
        """Whether it has something to send, or was sent something a moment ago."""
        return bool(self._out) or now - self._received_at < _AWAKE_S

    def receive(self, now: float) -> None:
        if data := self.wire.receive():
            self._received_at = now
            self._out += self.firmware.feed(data, now)

    def send(self, now: float) -> None:
        self.polled_at = now
        self._out += self.firmware.poll(now)
        if self._out:
            self._out = self._out[self.wire.send(self._out) :]


class SimulatedDevices:
    """All devices of a bench; hold `lock` while touching them: threads share them."""

    def __init__(self, devices: Mapping[str, Mapping[str, Any]]) -> None:
        self.lock = threading.RLock()
        self.devices: dict[str, Device] = {}
        for name, spec in devices.items():
            wire = TcpWire() if spec.get("tcp", not have_ptys) else PtyWire()
            self.devices[name] = Device(spec["kind"], dict(spec.get("options", {})), wire)

    def requests(self) -> dict[str, Handler]:
        return {"state": self._state}

    def ports(self) -> dict[str, str]:
        return {name: device.wire.port for name, device in self.devices.items()}

    def waiting(self) -> list[int]:
        with self.lock:
            return [fd for device in self.devices.values() for fd in device.wire.waiting]

    def pause_s(self, now: float) -> float:
        """How long to wait for something to read before the devices are served again [s]."""
        with self.lock:
            return _TICK_S if any(one.is_awake(now) for one in self.devices.values()) else _ASLEEP_S

    def serve(self, now: float, ready: Collection[int]) -> None:
        """Let each device receive and send that has something to; `ready`: file descriptors with something to read."""
        with self.lock:
            for device in self.devices.values():
                called = any(fd in ready for fd in device.wire.waiting)
                if called:
                    device.receive(now)
                if called or device.is_awake(now) or now - device.polled_at >= _ASLEEP_S:
                    device.send(now)

    def levels(self) -> dict[str, dict[int, float]]:
        """Brightness of each channel of each light controller, as a share of the highest."""
        return self._of_each(lambda firmware: firmware.levels())

    def pictures(self) -> dict[str, SeenPicture]:
        """What each screen shows."""
        return self._of_each(lambda firmware: firmware.picture())

    def positions(self, now: float) -> dict[str, dict[str, float]]:
        """Where each axis of each stage really stands, in device units."""
        return self._of_each(lambda firmware: firmware.positions(now))

    def _of_each(self, ask: Callable[[Firmware], T | None]) -> dict[str, T]:
        # what the devices have that have it
        with self.lock:
            found = {name: ask(device.firmware) for name, device in self.devices.items()}
        return {name: value for name, value in found.items() if value is not None}

    def _state(self, _: Mapping[str, Any]) -> Response:
        with self.lock:
            return {"levels": self.levels(), "positions": self.positions(time.monotonic())}, b""

    def close(self) -> None:
        with self.lock:
            for device in self.devices.values():
                device.wire.pull()
