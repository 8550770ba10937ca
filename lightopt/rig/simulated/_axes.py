"""Axes that move at constant speed, for simulated stage firmware.

An axis has a count, which its controller believes, and a place where it really stands, from its mechanical origin;
both in device units. They agree once it has been homed and while no step is lost.
"""

import math
from collections.abc import Mapping

from lightopt.rig.simulated._firmware import Firmware


class SimulatedAxis:
    """One axis: where it really `stands` at power-up, and its limit switches."""

    def __init__(self, *, stands: float = 0.0, low: float = -math.inf, high: float = math.inf) -> None:
        self._low = low
        self._high = high
        self._offset = stands  # real = count + offset
        self._start = self._end = 0.0
        self._began = 0.0
        self._speed = 1.0
        self._homing: float | None = None
        self._ends_at_switch = False
        self.at_limit = False  # whether the last move ended at a switch
        self.homed = False  # whether it has found its origin since power-up

    def count(self, now: float) -> float:
        """What the controller believes."""
        self._advance(now)
        way = self._end - self._start
        gone = min(abs(way), self._speed * max(0.0, now - self._began))
        return self._start + math.copysign(gone, way)

    def real(self, now: float) -> float:
        return self.count(now) + self._offset

    def moving(self, now: float) -> bool:
        self._advance(now)
        return self._end != self._start

    def move(self, target: float, speed: float, now: float) -> None:
        """Move the count to a target at a speed [units/s]."""
        self._go(target, speed, now)

    def home(self, speed: float, now: float, *, becomes: float = 0.0) -> None:
        """Seek the place that many units from the mechanical origin, where the count becomes right."""
        self.homed = False
        self._go(becomes - self._offset, speed, now, homing=becomes)

    def stop(self, now: float) -> None:
        self._start = self._end = self.count(now)
        self._homing = None

    def _go(self, target: float, speed: float, began: float, *, homing: float | None = None) -> None:
        self.at_limit = False
        self._start = self.count(began)
        self._began = began
        self._speed = speed
        self._homing = homing
        real = target + self._offset
        self._ends_at_switch = not self._low <= real <= self._high
        if self._ends_at_switch:
            target = min(max(real, self._low), self._high) - self._offset
        self._end = target
        if self._end == self._start:
            self._arrived()

    def _advance(self, now: float) -> None:
        if self._end != self._start and now >= self._began + abs(self._end - self._start) / self._speed:
            self._start = self._end
            self._arrived()

    def _arrived(self) -> None:
        if self._ends_at_switch:
            self.at_limit = True
        elif self._homing is not None:
            self._offset = 0.0
            self._start = self._end = self._homing
            self.homed = True
        self._homing = None
        self._ends_at_switch = False


class StageFirmware(Firmware):
    """Firmware of a stage, whose axes have names; `axes` are the arguments of each :class:`SimulatedAxis`."""

    def __init__(self, axes: Mapping[str, Mapping[str, float]]) -> None:
        super().__init__()
        if not axes:
            raise ValueError("a stage has at least one axis")
        self._axes = {name: SimulatedAxis(**options) for name, options in axes.items()}

    def positions(self, now: float) -> dict[str, float]:
        return {name: axis.real(now) for name, axis in self._axes.items()}

    def _axes_move(self, now: float) -> bool:
        return any(axis.moving(now) for axis in self._axes.values())

    def _stop_axes(self, now: float) -> None:
        for axis in self._axes.values():
            axis.stop(now)
