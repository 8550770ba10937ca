"""Stages of every protocol on a virtual bench, quick enough for tests: a range of 90° and 360° in half a second."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

from lightopt.hardware import Axis, open_stage
from lightopt.hardware._moves import Clock, MovingStage
from lightopt.virtualbench import BenchProcess

KINDS = ("shot", "gsc", "grbl", "zaber")
TILT = (-45.0, 45.0)
TURN = (0.0, 360.0)

AXES = {
    "shot": [
        Axis("elevation", "1", TILT, steps_per_deg=500, zero=-25, speed_deg_per_s=200),
        Axis("rotation", "2", TURN, steps_per_deg=-200, zero=30, speed_deg_per_s=800),
    ],
    "gsc": [
        Axis("elevation", "1", TILT, steps_per_deg=100, zero=-25, speed_deg_per_s=200),
        Axis("rotation", "2", TURN, steps_per_deg=-25, zero=30, speed_deg_per_s=800),
    ],
    "grbl": [
        Axis("elevation", "X", TILT, zero=-50, speed_deg_per_s=200),
        Axis("rotation", "Y", TURN, zero=-380, speed_deg_per_s=800),
    ],
    "zaber": [
        Axis("elevation", "1", TILT, steps_per_deg=1000, zero=50_000, speed_deg_per_s=200),
        Axis("rotation", "2", TURN, steps_per_deg=-500, zero=190_000, speed_deg_per_s=800),
    ],
}
STEP = {"shot": 1.0, "gsc": 1.0, "grbl": 0.005, "zaber": 1.0}
HOMED = {"shot": 0.0, "gsc": 0.0, "grbl": -1.0, "zaber": 0.0}
DEVICE_AXES = {"shot": ("1", "2"), "gsc": ("1", "2"), "grbl": ("X", "Y"), "zaber": ("1", "2")}


def firmware(kind: str) -> dict[str, Any]:
    """A device that stands off its origin when it is switched on."""
    first, second = DEVICE_AXES[kind]
    if kind == "grbl":
        settings = {
            "20": 1,
            "22": 1,
            "100": 200,
            "101": 200,
            "110": 60_000,
            "111": 60_000,
            "130": 120,
            "131": 400,
        }
        axes = {first: {"stands": -3}, second: {"stands": -7}}
        return {"kind": kind, "options": {"settings": settings, "axes": axes, "home_speed": 400}}
    options: dict[str, Any] = {"axes": {first: {"stands": 400}, second: {"stands": -300}}, "home_speed": 200_000}
    return {"kind": kind, "options": options}


def open_kind(kind: str, port: str, *, timeout_s: float = 0.5, clock: Clock | None = None) -> MovingStage:
    return open_stage(kind, port=port, axes=AXES[kind], timeout_s=timeout_s, home_timeout_s=5, clock=clock)


class Pool:
    """Many devices in one process, handed out one by one: each test has its own."""

    def __init__(self, kinds: tuple[str, ...], count: int) -> None:
        devices = {
            f"{kind}-{wire}-{i}": {**firmware(kind), "tcp": wire == "tcp"}
            for kind in kinds
            for wire in ("pty", "tcp")
            for i in range(count)
        }
        self.bench = BenchProcess(devices)
        self._next = itertools.count()
        self._free: dict[str, Iterator[int]] = {}
        self._count = count

    def take(self, kind: str, wire: str = "pty") -> str:
        """Name of a device that no test has had."""
        return f"{kind}-{wire}-{next(self._free.setdefault(kind + wire, iter(range(self._count))))}"
