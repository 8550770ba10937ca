"""The devices of a virtual bench: firmware, its wire (a pseudo-terminal, or TCP where there are none), line faults.

`port` of a wire is what a client opens; `waiting` are file descriptors to watch for something to read, none once the
cable is pulled. Nothing is waited for: `receive` takes what has come, a connection included; `send` returns how many
bytes the wire took, and without a client they are lost; `pull` pulls the cable, for good.
"""

import contextlib
import math
import os
import random
import socket
import sys
import threading
from collections import deque
from collections.abc import Collection, Mapping
from typing import Any

from lightopt.rig.simulated._firmware import Trigger, build, trigger

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
    """A loopback socket for one client at a time; `wedges`: one that leaves without a word disables it (PD3-EI)."""

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


_TRACE = 100_000

_TICK_S = 0.005  # how late a device may be with what it sends on its own while it is awake
_AWAKE_S = 1.0  # a device is awake for so long after it was sent something
_ASLEEP_S = 0.05  # how late another device may be: polling all of them as often would keep a bench busy


class Device:
    """A simulated device on its wire."""

    def __init__(self, kind: str, options: dict[str, Any], wire: PtyWire | TcpWire) -> None:
        self.firmware = build(kind, options)
        self.wire = wire
        self.deliveries = 0
        self._line = FaultyLine()
        self._out: list[tuple[float, bytes]] = []  # when [s], what
        self._received_at = -math.inf
        self._polled_at = -math.inf

    def is_awake(self, now: float) -> bool:
        """Whether it has something to send, or was sent something a moment ago."""
        return bool(self._out) or now - self._received_at < _AWAKE_S

    def is_due(self, now: float) -> bool:
        return self.is_awake(now) or now - self._polled_at >= _ASLEEP_S

    def receive(self, now: float) -> None:
        data = self.wire.receive()
        if not data:
            return
        self._received_at = now
        self.deliveries += 1
        pulled = self._line.pulled()
        if pulled is not None:
            self.wire.pull()
        if pulled is not False:
            self._reply(self.firmware.feed(data, now), now)

    def send(self, now: float) -> None:
        self._polled_at = now
        self._reply(self.firmware.poll(now), now)
        self._out.sort(key=lambda sent: sent[0])
        while self._out and self._out[0][0] <= now:
            due, data = self._out.pop(0)
            taken = self.wire.send(data)
            if taken < len(data):
                self._out.insert(0, (due, data[taken:]))
                return

    def inject(self, fault: str, options: dict[str, Any], now: float) -> None:
        self._received_at = now
        if fault in LINE_FAULTS or fault == "clear":
            self._line.inject(fault, options)
        if fault == "clear":
            self._out = [sent for sent in self._out if sent[0] <= now]  # late replies do not come any more
        if fault not in LINE_FAULTS:
            self.firmware.inject(fault, options, now)

    def _reply(self, data: bytes, now: float) -> None:
        if data:
            self._out += self._line.carry(data, now)


class SimulatedDevices:
    """All devices of a bench, and its lights through time; hold `lock` while touching them: threads share them."""

    def __init__(self, devices: Mapping[str, Mapping[str, Any]]) -> None:
        self.lock = threading.RLock()
        self._served = threading.Event()
        # changes of the lights: time [s, monotonic clock], device, channel, share of the highest brightness
        self.trace: deque[tuple[float, str, int, float]] = deque(maxlen=_TRACE)
        self.devices: dict[str, Device] = {}
        self._brightness: dict[tuple[str, int], float] = {}
        for name, spec in devices.items():
            wire = TcpWire(wedges=spec.get("wedges", False)) if spec.get("tcp", not have_ptys) else PtyWire()
            self.devices[name] = Device(spec["kind"], dict(spec.get("options", {})), wire)
        self.levels()

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
                if called or device.is_due(now):
                    device.send(now)
            self._record_lights(now)
            self._served.set()

    def levels(self) -> dict[str, dict[int, float]]:
        """Brightness of each channel of each light controller, as a share of the highest."""
        with self.lock:
            found = {name: device.firmware.levels() for name, device in self.devices.items()}
        return {name: levels for name, levels in found.items() if levels is not None}

    def positions(self, now: float) -> dict[str, dict[str, float]]:
        """Where each axis of each stage really stands, in device units."""
        with self.lock:
            found = {name: device.firmware.positions(now) for name, device in self.devices.items()}
        return {name: positions for name, positions in found.items() if positions is not None}

    def inject(self, name: str, fault: str, options: dict[str, Any], now: float) -> None:
        with self.lock:
            if name not in self.devices:
                raise ValueError(f'no device called "{name}"; there is {", ".join(self.devices)}')
            self.devices[name].inject(fault, options, now)
            self._record_lights(now)

    def pull(self, name: str) -> None:
        """Pull the cable of a device, and wait until its end is no longer in use."""
        with self.lock:
            self.devices[name].wire.pull()
            self._served.clear()
        # The system keeps a wire open for as long as the serving thread waits on it.
        self._served.wait(1)

    def close(self) -> None:
        with self.lock:
            for device in self.devices.values():
                device.wire.pull()

    def _record_lights(self, now: float) -> None:
        for name, levels in self.levels().items():
            for channel, level in levels.items():
                if self._brightness.get((name, channel), 0.0) != level:
                    self._brightness[name, channel] = level
                    self.trace.append((now, name, channel, level))
