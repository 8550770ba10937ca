"""Stages of every protocol on a virtual bench, quick enough for tests: from end to end in a fifth of a second."""

from __future__ import annotations

from typing import Any

from lightopt.rig.devices import Axis, open_stage
from lightopt.rig.devices._stage import Clock, Stage
from lightopt.rig.simulated import BenchProcess

KINDS = ("shot", "gsc", "grbl", "zaber")
TILT = (-45.0, 45.0)
TURN = (0.0, 360.0)

AXES = {
    "shot": [
        Axis("elevation", "1", TILT, steps_per_deg=500, zero=-25, speed_deg_per_s=800),
        Axis("rotation", "2", TURN, steps_per_deg=-200, zero=30, speed_deg_per_s=2000),
    ],
    "gsc": [
        Axis("elevation", "1", TILT, steps_per_deg=20, zero=-25, speed_deg_per_s=800),
        Axis("rotation", "2", TURN, steps_per_deg=-10, zero=30, speed_deg_per_s=2000),
    ],
    "grbl": [
        Axis("elevation", "X", TILT, zero=-50, speed_deg_per_s=800),
        Axis("rotation", "Y", TURN, zero=-380, speed_deg_per_s=2000),
    ],
    "zaber": [
        Axis("elevation", "1", TILT, steps_per_deg=1000, zero=50_000, speed_deg_per_s=800),
        Axis("rotation", "2", TURN, steps_per_deg=-500, zero=190_000, speed_deg_per_s=2000),
    ],
}
STEP = {"shot": 1.0, "gsc": 1.0, "grbl": 0.005, "zaber": 1.0}
HOMED = {"shot": 0.0, "gsc": 0.0, "grbl": -1.0, "zaber": 0.0}
DEVICE_AXES = {"shot": ("1", "2"), "gsc": ("1", "2"), "grbl": ("X", "Y"), "zaber": ("1", "2")}


def firmware(kind: str) -> dict[str, Any]:
    """A device that stands off its origin when it is switched on."""
    first, second = DEVICE_AXES[kind]
    if kind == "grbl":
        settings = {"20": 1, "22": 1, "100": 200, "101": 200, "110": 200_000, "111": 200_000, "130": 120, "131": 400}
        axes = {first: {"stands": -3}, second: {"stands": -7}}
        return {"kind": kind, "options": {"settings": settings, "axes": axes, "home_speed": 2000}}
    options: dict[str, Any] = {"axes": {first: {"stands": 4000}, second: {"stands": -3000}}, "home_speed": 500_000}
    return {"kind": kind, "options": options}


def open_kind(kind: str, port: str, *, timeout_s: float = 0.5, clock: Clock | None = None) -> Stage:
    return open_stage(kind, port=port, axes=AXES[kind], timeout_s=timeout_s, home_timeout_s=5, clock=clock)


class Pool:
    """Devices of their own for each test, made a batch at a time: a process for each test would take longer.

    A test takes no more devices of a kind than a batch has, so that at most two batches of a kind are in use.
    """

    def __init__(self, batch: int = 16) -> None:
        self._batch = batch
        self._free: dict[str, list[str]] = {}
        self._benches: dict[str, list[BenchProcess]] = {}
        self._of: dict[str, BenchProcess] = {}

    def take(self, kind: str, wire: str = "pty") -> str:
        """Name of a device that no test has had."""
        free = self._free.setdefault(f"{kind}-{wire}", [])
        if not free:
            number = len(self._of)
            names = [f"{kind}-{wire}-{number + i}" for i in range(self._batch)]
            bench = BenchProcess({name: {**firmware(kind), "tcp": wire == "tcp"} for name in names})
            benches = self._benches.setdefault(f"{kind}-{wire}", [])
            benches.append(bench)
            if len(benches) > 2:  # each bench takes processor time for as long as it runs
                benches.pop(0).close()
            self._of.update(dict.fromkeys(names, bench))
            free += reversed(names)
        return free.pop()

    def of(self, name: str) -> BenchProcess:
        """The bench of a device."""
        return self._of[name]

    def close(self) -> None:
        """End the processes."""
        for benches in self._benches.values():
            for bench in benches:
                bench.close()
