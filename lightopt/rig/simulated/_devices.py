"""The devices of a virtual bench: firmware, its wire, and what happens on it."""

import math
import threading
from collections import deque
from collections.abc import Collection, Mapping
from typing import Any

from lightopt.rig.simulated._firmware import build
from lightopt.rig.simulated._wires import LINE_FAULTS, FaultyLine, PtyWire, TcpWire, have_ptys

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
    """All devices of a bench, and the brightness of its lights through time.

    Hold `lock` while touching the devices: the wires are served by one thread, requests by others.

    devices: As :class:`BenchProcess` has them.
    """

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
