"""A stage: moves that are checked, watched and verified, whatever language the device speaks."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import ClassVar

from lightopt.core.errors import HardwareError, refuse
from lightopt.core.transforms import Posture
from lightopt.rig.devices._device import ReplyError, Retry
from lightopt.rig.devices._serial_link import SerialLink

_ROUNDING = 1e-9  # relative; angles that differ by less are the same


@dataclass(frozen=True)
class Axis:
    """An axis of the stage: how the rig's angle becomes the device's count, and how far and fast it may go."""

    name: str  # elevation or rotation
    device: str  # the axis as the device calls it
    range_deg: tuple[float, float]  # lowest and highest allowed angle [°]
    steps_per_deg: float = 1.0  # device units per degree; negative where the device counts against the rig's sense
    zero: float = 0.0  # device units at which the rig's angle is 0
    speed_deg_per_s: float = 20.0
    home_sense: int = -1  # sense of the count in which the GSC-02 seeks its origin, +1 or -1

    def angle_of(self, units: float) -> float:
        """The rig's angle [°] at a position of the device."""
        return (units - self.zero) / self.steps_per_deg + 0.0  # never -0

    def units_of(self, angle_deg: float) -> float:
        """The device's position at an angle [°] of the rig, not rounded."""
        return self.zero + angle_deg * self.steps_per_deg

    def target(self, angle_deg: float, *, step: float) -> float:
        """Nearest multiple of a `step` [device units] to an angle [°]; an InputError for one outside the range."""
        refuse(self.problems(angle_deg))
        return step * round(self.units_of(angle_deg) / step)

    def problems(self, angle_deg: float) -> list[str]:
        low, high = self.range_deg
        slack = _ROUNDING * max(1.0, abs(low), abs(high))
        if low - slack <= angle_deg <= high + slack:
            return []
        span = f"{low:g}° … {high:g}°"
        return [f"stage axis {self.name}: {angle_deg:g}° lies outside the rig's range {span}; nothing was moved"]

    def speed_units(self) -> float:
        return self.speed_deg_per_s * abs(self.steps_per_deg)


@dataclass(frozen=True)
class Reading:
    """State of a stage's device at one moment."""

    units: Mapping[str, float]  # position of each axis by the device's name of it [device units]
    moving: bool
    referenced: bool | None = None  # whether it knows its origin; None where that is unknown
    alarm: str | None = None  # message about the alarm


class Dialogue(ABC):
    """Protocol of a stage, in the device's units and names; HardwareError where it refuses or does not answer."""

    BAUD: ClassVar[int]  # the protocol's usual baud rate
    RTSCTS: ClassVar[bool] = False  # whether the device paces the line by RTS/CTS
    HOMES_TO_END: ClassVar[bool] = False
    """Whether `home` returns when the origins are found, rather than when the search has begun."""

    def __init__(self, link: SerialLink, axes: Sequence[Axis], *, home_timeout_s: float = 180.0) -> None:
        self.link = link
        self._retry = Retry(link)
        self._axes = tuple(axes)
        self.home_timeout_s = home_timeout_s

    @classmethod  # noqa: B027  (some devices tell their speeds only when they are open)
    def check_axes(cls, axes: Sequence[Axis]) -> None:
        """Refuse speeds, and axes together, that the device cannot have, as far as is known without it (InputError)."""

    @abstractmethod
    def identify(self) -> dict[str, str]:
        """What the device reports about itself."""

    @abstractmethod
    def read(self) -> Reading:
        """Query positions and state; may be repeated."""

    def step(self, axis: Axis) -> float:  # noqa: ARG002  (a device that counts in steps)
        """Smallest distance [device units] between two positions of an axis."""
        return 1.0

    def check(self, targets: Mapping[str, float]) -> None:  # noqa: B027  (not all devices have limits)
        """Raise an InputError for targets that the device is known to refuse; sends nothing that moves."""

    def prepare(self) -> None:  # noqa: B027  (not all devices keep speeds)
        """Set speeds; once, before the first move. Nothing where each move carries its speed."""

    @abstractmethod
    def go(self, targets: Mapping[str, float]) -> None:
        """Start a move; never sent twice. A ReplyError means that it is unknown whether the device took it."""

    @abstractmethod
    def home(self) -> None:
        """Start to seek the origins, or seek them to the end, as the protocol has it; never sent twice."""

    def homed(self, reading: Reading) -> str | None:
        """What is wrong with a reading after homing; None when all is well."""
        return reading.alarm

    @abstractmethod
    def halt(self) -> None:
        """Stop all axes at once."""


HOME_FIRST = "home it first: lightopt bench home RIG"
_POLL_S = 0.02  # between two queries of a moving stage,
_NEAR_S = 0.004  # and when it should arrive
_MARGIN_S = 3.0  # beyond twice the travel time: ramps, replies
_SETTLE_S = 0.5  # devices report that they stand still for a moment after the command that moves them
_HALT_S = 2.0  # a stage comes to rest within
_ONE_STEP = 1 + 1e-6


@dataclass
class Clock:
    """Source of time, which tests replace."""

    now: Callable[[], float] = field(default=time.monotonic)
    sleep: Callable[[float], None] = field(default=time.sleep)


@dataclass(frozen=True)
class StageState:
    """State of a stage; an axis that it lacks stands at 0°."""

    posture: Posture
    moving: bool
    referenced: bool | None  # whether it knows where its origin is; None where that is unknown
    alarm: str | None = None  # message about the device's alarm


class Stage:
    """The tilt and rotation axes that hold the part, over any :class:`~lightopt.rig.devices._stage.Dialogue`.

    Every method raises :class:`~lightopt.core.errors.HardwareError` when the device does not answer, or answers no.
    Alarms are reported and never cleared.

    A move is refused when the posture lies outside the range (before a command is sent), when the device has an alarm
    or knows that it is not referenced, when it moves already, and when it does not stand where it was left. After a
    failed move it is refused until the stage has been homed. An axis that is not among `axes` stands at 0.
    """

    def __init__(self, *, driver: str, dialogue: Dialogue, axes: Sequence[Axis], clock: Clock | None = None) -> None:
        self._driver = driver
        self._dialogue = dialogue
        self._axes = tuple(axes)
        self._clock = clock or Clock()
        self._link = dialogue.link
        self.events = self._link.events
        self._prepared = False
        self._left_at: dict[str, float] | None = None
        self._homed = False
        self._lost: str | None = None

    def identify(self) -> dict[str, str]:
        with self._link.lock:
            return {"driver": self._driver, "port": self._link.port, **self._dialogue.identify()}

    def state(self) -> StageState:
        with self._link.lock:
            return self._state(self._dialogue.read())

    def check(self, posture: Posture) -> None:
        """Raise what :meth:`move_to` would raise for a posture that it cannot take; sends nothing."""
        axes = {axis.name: axis for axis in self._axes}
        wrong: list[str] = []
        for name, angle in _angles(posture).items():
            if name in axes:
                wrong += axes[name].problems(angle)
            elif abs(angle) > 1e-9:
                fixed = f"but hardware.stage has no {name} axis, so it stands at 0°"
                wrong.append(f"stage axis {name}: {angle:g}° was requested, {fixed}; nothing was moved")
        refuse(wrong)

    def move_to(self, posture: Posture) -> StageState:
        """Move, wait and verify; InputError outside the limits with nothing sent, HardwareError once it is stopped."""
        self.check(posture)
        with self._link.lock:
            try:
                reading = self._dialogue.read()
            except HardwareError as error:
                raise type(error)(*error.messages, "No move had been sent to it") from None
            if (problem := self._problem(reading)) is not None:
                raise self._link.failure(f"was not moved: {problem}")
            angles = _angles(posture)
            steps = {axis.name: self._dialogue.step(axis) for axis in self._axes}
            targets = {axis.device: axis.target(angles[axis.name], step=steps[axis.name]) for axis in self._axes}
            self._dialogue.check(targets)
            if far := self._off(reading, targets, steps=0.5):
                self._note_rounding(angles, targets)
                ways = {axis: abs(targets[axis.device] - reading.units[axis.device]) for axis in self._axes}
                travel_s = max(way / axis.speed_units() for axis, way in ways.items())
                with self._stopped_on_failure():
                    if not self._prepared:
                        self._dialogue.prepare()
                        self._prepared = True
                    # whether it was taken shows in where the stage goes; sent again it might move twice
                    with self._sent_once("position"):
                        self._dialogue.go({axis.device: targets[axis.device] for axis in far})
                    reading = self._await_arrival(targets, travel_s)
            self._left_at = dict(reading.units)
            return self._state(reading)

    def confirm(self) -> StageState:
        """Check that it still stands where the last move left it; moves nothing.

        HardwareError when it stands elsewhere, moves, or has an alarm or lost its origin. It stands elsewhere after it
        was moved by hand, or switched off and on: then most devices count from another place.
        """
        with self._link.lock:
            reading = self._dialogue.read()
            if (problem := self._problem(reading)) is not None:
                raise self._link.failure(problem)
            return self._state(reading)

    def home(self) -> None:
        with self._link.lock:
            reading = self._dialogue.read()
            if reading.moving:
                raise self._link.failure("is moving, so it was not homed; wait until it stands still")
            self._left_at = None
            self._homed = False
            with self._stopped_on_failure():
                with self._sent_once("state"):
                    self._dialogue.home()
                reading = self._await_homing()
            self._homed = True
            self._lost = None
            self._left_at = dict(reading.units)

    def stop(self) -> Reading:
        """Stop all axes at once; returns the reading with which they stand still."""
        with self._link.lock:
            self._left_at = None
            self._dialogue.halt()
            until = self._clock.now() + _HALT_S
            while (reading := self._dialogue.read()).moving:
                if self._clock.now() > until:
                    raise self._link.failure(f"was told to stop and still moves {_HALT_S:g} s later: switch it off")
                self._clock.sleep(_POLL_S)
            if reading.alarm is None:
                self._left_at = dict(reading.units)
            return reading

    def close(self) -> None:
        """Give up the link; never moves an axis, never raises."""
        self._link.close()

    def _note_rounding(self, angles: Mapping[str, float], targets: Mapping[str, float]) -> None:
        for axis in self._axes:
            angle, rounded = angles[axis.name], axis.angle_of(targets[axis.device])
            if abs(rounded - angle) > 1e-6:
                between = f"{axis.name}: {angle:g}° lies between two steps, goes to {rounded:.6g}°"
                self._link.note(f"{self._link.device}: {between}")

    def _off(self, reading: Reading, targets: Mapping[str, float], *, steps: float = _ONE_STEP) -> list[Axis]:
        """Axes that stand more than so many steps from their targets."""
        off = {axis: abs(reading.units[axis.device] - targets[axis.device]) for axis in self._axes}
        return [axis for axis, units in off.items() if units > steps * self._dialogue.step(axis)]

    def _problem(self, reading: Reading) -> str | None:
        """Why it is not where it was left, or must not be moved; None where nothing is wrong."""
        if reading.alarm is not None:
            return f"alarm: {reading.alarm}"
        if reading.moving:
            return "it moves without a command"
        if self._lost is not None:
            return f"{self._lost}; {HOME_FIRST}"
        if reading.referenced is False:
            return f"it does not know where its origin is; {HOME_FIRST}"
        left = self._left_at
        if left is None or not (moved := self._off(reading, left)):
            return None
        axis = moved[0]
        was, is_now = (axis.angle_of(units[axis.device]) for units in (left, reading.units))
        why = "moved by hand, by another program, or switched off between"
        self._lost = f"{axis.name} was left at {was:.6g}° and stands at {is_now:.6g}° now: {why}"
        return f"{self._lost}; {HOME_FIRST}"

    def _await_arrival(self, targets: Mapping[str, float], travel_s: float) -> Reading:
        """Watch a move that should take `travel_s` until the stage stands at its targets."""
        started = self._clock.now()
        limit_s = 2 * travel_s + _MARGIN_S
        still_since: float | None = None
        while True:
            reading = self._dialogue.read()
            now = self._clock.now()
            if reading.alarm is not None:
                raise self._link.failure(f"alarm during the move: {reading.alarm}{self._where(reading, targets)}")
            if reading.moving:
                still_since = None
                if now - started > limit_s:
                    late = f"still moves after {limit_s:.1f} s, twice the time of the way and {_MARGIN_S:g} s"
                    why = f"jammed, or slower than speed_deg_per_s says{self._where(reading, targets)}"
                    raise self._link.failure(f"{late}: {why}")
            elif not self._off(reading, targets):
                return reading
            else:
                still_since = now if still_since is None else still_since
                if now - still_since > _SETTLE_S:
                    why = f"stalled, at a limit switch, or the command was not taken{self._where(reading, targets)}"
                    raise self._link.failure(f"stands still and is not where it should be: {why}")
            self._clock.sleep(_POLL_S if now - started < travel_s - _POLL_S else _NEAR_S)

    def _where(self, reading: Reading, targets: Mapping[str, float]) -> str:
        """Where axes stand that are not at their targets, as the end of a message."""
        parts: list[str] = []
        for axis in self._off(reading, targets):
            wanted, units = axis.angle_of(targets[axis.device]), reading.units[axis.device]
            stands = f"stands at {axis.angle_of(units):.6g}° ({units:.10g} units)"
            parts.append(f"{axis.name} should be at {wanted:.6g}° and {stands}")
        return "; " + ", ".join(parts) if parts else ""

    def _await_homing(self) -> Reading:
        started, limit_s = self._clock.now(), self._dialogue.home_timeout_s
        moved = self._dialogue.HOMES_TO_END
        wrong_since: float | None = None
        while True:
            reading = self._dialogue.read()
            now = self._clock.now()
            if reading.moving:
                moved = True
                wrong_since = None
                if now - started > limit_s:
                    raise self._link.failure(f"has not found its origin after {limit_s:g} s: check the limit switches")
            else:
                problem = self._dialogue.homed(reading)
                if problem is None and (moved or now - started > _SETTLE_S):
                    return reading
                wrong_since = now if wrong_since is None else wrong_since
                if problem is not None and now - wrong_since > _SETTLE_S:
                    raise self._link.failure(f"has not found its origin: {problem}")
            self._clock.sleep(_POLL_S)

    @contextmanager
    def _sent_once(self, evidence: str) -> Generator[None]:
        """Note a lost reply to a command that must not be sent again."""
        try:
            yield
        except ReplyError as error:
            self._link.note(f"{error}; not sent again, the {evidence} will show it")

    @contextmanager
    def _stopped_on_failure(self) -> Generator[None]:
        """Stop the stage where this fails; the error has the outcome of stopping."""
        try:
            yield
        except HardwareError as error:
            raise type(error)(*error.messages, self._stop_after(str(error))) from error
        except BaseException:
            self._link.note(self._stop_after())
            raise

    def _stop_after(self, reported: str = "") -> str:
        """Stop the stage after a failure; returns a message about the outcome."""
        self._lost = "the last move failed"
        try:
            alarm = self.stop().alarm
        except HardwareError as failed:
            return f"Stopping it failed too, so it may still move: {failed}"
        finally:
            self._left_at = None
        with_alarm = f", with an alarm: {alarm}" if alarm is not None and alarm not in reported else ""
        return f"It stands still now{with_alarm}. Before the next move, {HOME_FIRST}"

    def _state(self, reading: Reading) -> StageState:
        angles = {axis.name: axis.angle_of(reading.units[axis.device]) for axis in self._axes}
        posture = Posture(elevation_deg=angles.get("elevation", 0.0), rotation_deg=angles.get("rotation", 0.0))
        known = True if reading.referenced is None and self._homed else reading.referenced
        return StageState(posture, reading.moving, False if self._lost is not None else known, reading.alarm)


def _angles(posture: Posture) -> dict[str, float]:
    return {"elevation": posture.elevation_deg, "rotation": posture.rotation_deg}
