"""Axes that move at constant speed, and what can go wrong with them, for simulated stage firmware.

An axis has a count, which its controller believes, and a place where it really stands, from its mechanical origin;
both in device units. They agree once it has been homed and while no step is lost.
"""

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from lightopt.rig.simulated._firmware import Firmware, Trigger, trigger

_FAULTS = ("stall", "limit", "lost_step")


@dataclass
class _Fault:
    kind: str
    trigger: Trigger
    share: float
    busy: bool


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
        self._ends_at_switch = self._ends_stalled = self._stays_busy = False
        self.fault: _Fault | None = None  # what it suffers in a coming move
        self.at_limit = False  # whether the last move ended at a switch
        self.homed = False  # whether it has found its origin since power-up

    def lose_steps(self, steps: float) -> None:
        """Lose steps: the axis stands that much short of its count from now on."""
        self._offset -= steps

    def power_cycle(self, now: float) -> None:
        """Go off and on: the axis stays where it stands, and the count starts again."""
        self.stop(now)
        self._offset += self._start
        self._start = self._end = 0.0
        self.at_limit = self.homed = False

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
        return self._end != self._start or self._stays_busy

    def move(self, target: float, speed: float, now: float) -> None:
        """Move the count to a target at a speed [units/s]."""
        self.at_limit = False
        self._go(target, speed, now)

    def home(self, speed: float, now: float, *, becomes: float = 0.0) -> None:
        """Seek the place that many units from the mechanical origin, where the count becomes right."""
        self.at_limit = self.homed = False
        origin = becomes - self._offset
        self._go(origin, speed, now)
        self._homing = becomes
        if origin == self._start:
            self._advance(now)

    def stop(self, now: float) -> None:
        here = self.count(now)
        self._start = self._end = here
        self._homing = None
        self._stays_busy = False

    def _go(self, target: float, speed: float, began: float) -> None:
        self._start = self.count(began)
        self._began = began
        self._speed = speed
        self._homing = None
        self._ends_at_switch = self._ends_stalled = False
        if self.fault is not None and self.fault.trigger.strikes():
            target = self._start + self.fault.share * (target - self._start)
            self._ends_at_switch = self.fault.kind == "limit"
            self._ends_stalled = self.fault.kind == "stall"
        real = target + self._offset
        if not self._low <= real <= self._high:
            target = min(max(real, self._low), self._high) - self._offset
            self._ends_at_switch = True
        self._end = target
        if self._end == self._start:
            self._arrived()

    def _advance(self, now: float) -> None:
        if self._end != self._start and now >= self._began + abs(self._end - self._start) / self._speed:
            self._start = self._end
            self._arrived()
        elif self._homing is not None and self._end == self._start and not self._stays_busy:
            self._arrived()

    def _arrived(self) -> None:
        if self._ends_stalled:
            self._stays_busy = self.fault is not None and self.fault.busy
            self._homing = None
        elif self._ends_at_switch:
            self.at_limit = True
            self._homing = None
        elif self._homing is not None:
            self._offset = 0.0
            self._start = self._end = self._homing
            self._homing = None
            self.homed = True
        self._ends_stalled = self._ends_at_switch = False


class StageFirmware(Firmware):
    """Firmware of a stage, whose axes have names; `axes` are the arguments of each :class:`SimulatedAxis`.

    Faults: ``power_cycle``; of an ``axis`` or of all: ``stall`` (the axis stops after a ``share`` of a move, and
    reports that it stands still, or with ``busy`` that it moves), ``limit`` (it meets a switch there), with the options
    of :class:`Trigger` counting moves; ``lost_step`` (it lost ``steps``). ``clear`` ends them.
    """

    DEVICE_FAULTS: ClassVar[tuple[str, ...]] = ()  # further faults of the whole device, for the message

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

    @abstractmethod
    def _power_up(self) -> None:
        """Begin with the state at power-up, that of the axes apart."""

    def _suffer(self, fault: str, options: Mapping[str, Any], now: float) -> None:
        if fault == "power_cycle":
            for axis in self._axes.values():
                axis.power_cycle(now)
            self._power_up()
            return
        chosen = dict(options)
        name = chosen.pop("axis", None)
        if name is not None and name not in self._axes:
            raise ValueError(f'{fault}: no axis called "{name}"; there is {", ".join(self._axes)}')
        axes = list(self._axes.values()) if name is None else [self._axes[name]]
        if fault == "clear":
            for axis in axes:
                axis.fault = None
        elif fault == "lost_step":
            steps = float(chosen.pop("steps", 100))
            if chosen:
                raise ValueError(f"lost_step: unknown option {', '.join(chosen)}")
            for axis in axes:
                axis.lose_steps(steps)
        elif fault in ("stall", "limit"):
            share, busy = float(chosen.pop("share", 0.5)), bool(chosen.pop("busy", False))
            strikes = trigger(fault, chosen)
            for axis in axes:
                axis.fault = _Fault(fault, strikes, share, busy)
        else:
            known = (*_FAULTS, *self.DEVICE_FAULTS, *self.FAULTS, "power_cycle", "clear")
            raise ValueError(f'no fault called "{fault}"; there is {", ".join(known)}')
