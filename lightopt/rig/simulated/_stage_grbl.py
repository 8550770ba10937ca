"""Simulated firmware of Grbl 1.1h.

Written from Grbl's interface description, and held by tests to dialogues that were recorded from a Grbl 1.1h. What it
keeps of the real one: ``ok`` when a move is planned; a report in the first milliseconds after it that is still Idle;
realtime bytes; silence after ALARM:1 and ALARM:2 until a reset, and the withheld ``ok`` before the banner then; a
locked start with homing enabled; a machine space from 0 down to −$130; no reports during homing. It knows what the
driver sends and ``$X``, and plans one move: a line that follows waits for its end.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import Any, ClassVar

from lightopt.rig.simulated._axes import StageFirmware
from lightopt.rig.simulated._stage_grbl_gcode import GcodeError, GrblSettings, parse_line

_NAMES = ("X", "Y", "Z")
_BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
_UNLOCK = b"[MSG:'$H'|'$X' to unlock]\r\n"
_RESET_FIRST = b"[MSG:Reset to continue]\r\n"
_CRITICAL = (1, 2)
_SLOW_START_S = 0.004  # a report so soon after the ok is still Idle
_BRAKE_S = 0.02


class GrblFirmware(StageFirmware):
    """A Grbl 1.1h with three axes.

    Faults besides those of its axes (``limit`` raises ALARM:1): ``alarm`` (option ``code``; at once), ``refuse``
    (option ``code``: lines are answered by ``error:code``, with the options of :class:`Trigger`).

    settings: Settings other than the usual ones by number: ``{"22": 1}``.
    """

    FAULTS: ClassVar[Mapping[str, Mapping[str, Any]]] = {"refuse": {"code": 8}}
    DEVICE_FAULTS = ("alarm",)

    def __init__(
        self,
        *,
        axes: Mapping[str, Mapping[str, float]] | None = None,
        settings: Mapping[str, float] | None = None,
        home_speed: float = 50.0,
    ) -> None:
        given = axes or {}
        if not set(given) <= set(_NAMES):
            raise ValueError(f"the axes are X, Y and Z, found {', '.join(given)}")
        super().__init__({name: given.get(name, {}) for name in _NAMES})
        self._settings = GrblSettings(settings or {})
        self._home_speed = home_speed
        self._power_up()

    def feed(self, data: bytes, now: float) -> bytes:
        """Take bytes: realtime ones at once, lines in their turn."""
        out = self.poll(now)
        for value in data:
            byte = bytes([value])
            if byte == b"\x18":
                out += self._reset(now)
            elif self._critical:
                continue
            elif byte == b"?":
                out += self._answer_status(now)
            elif byte == b"!":
                self._hold(now)
            elif byte in b"\r\n":
                if self._buffer:
                    self._lines.append(self._buffer.decode("ascii", "replace"))
                self._buffer = b""
                out += self._work(now)
            elif value < 0x80:
                self._buffer += byte
        return out

    def poll(self, now: float) -> bytes:
        """Messages that it sends on its own: the banner, an alarm, an ok that had to wait."""
        out, self._pending = self._pending, b""
        if self._critical:
            return out
        self._stands(now)  # brings all axes up to now
        if any(axis.at_limit for axis in self._axes.values()):
            return out + self._alarm(1, now)
        if self._homing and not self._axes_move(now):
            self._homing = False
            found = all(axis.homed for axis in self._axes.values())
            out += b"ok\r\n" if found else self._alarm(9, now) + b"ok\r\n"
            self._state = "Idle" if found else "Alarm"
        if self._status_wanted and not self._homing:
            self._status_wanted = False
            out += self._report(now)
        return out + self._work(now)

    def _suffer(self, fault: str, options: Mapping[str, Any], now: float) -> None:
        if fault == "alarm":
            code = int(options.get("code", 1))
            if set(options) - {"code"} or not 1 <= code <= 10:
                raise ValueError("alarm wants a code from 1 to 10, and no other option")
            self._pending += self._alarm(code, now)
        else:
            super()._suffer(fault, options, now)

    def _power_up(self) -> None:
        self._restart()
        self._state = "Alarm" if self._settings[22] else "Idle"
        self._pending = _BANNER + (_UNLOCK if self._settings[22] else b"")

    def _restart(self) -> None:
        self._state = "Idle"
        self._critical = False
        self._withheld = b""
        self._pending = self._buffer = b""
        self._lines: deque[str] = deque()
        self._feed = 0.0
        self._idle_until = -math.inf
        self._braked = -math.inf
        self._homing = False
        self._status_wanted = False
        self._until_wco = self._until_ov = 0

    def _stands(self, now: float) -> dict[str, float]:
        return {name: axis.count(now) for name, axis in self._axes.items()}

    def _reset(self, now: float) -> bytes:
        """Ctrl-X: forget all but the position and the lock."""
        out = self._withheld
        lock = self._state == "Alarm"
        braking = self._state == "Hold" and now < self._braked
        if (self._state != "Hold" and self._axes_move(now)) or self._homing or braking:
            out += b"ALARM:3\r\n"
            lock = True
        self._stop_axes(now)
        self._restart()
        self._state = "Alarm" if lock else "Idle"
        return out + _BANNER + (_UNLOCK if lock else b"")

    def _alarm(self, code: int, now: float) -> bytes:
        self._stop_axes(now)
        for axis in self._axes.values():
            axis.at_limit = False
        self._homing = False
        self._state = "Alarm"
        if code in _CRITICAL:
            self._critical = True
            return f"ALARM:{code}\r\n".encode() + _RESET_FIRST
        return f"ALARM:{code}\r\n".encode()

    def _hold(self, now: float) -> None:
        if self._state == "Idle" and not self._homing:
            self._braked = now + _BRAKE_S if self._axes_move(now) else now
            self._stop_axes(now)
            self._state = "Hold"

    def _answer_status(self, now: float) -> bytes:
        if self._homing:
            self._status_wanted = True
            return b""
        return self._report(now)

    def _report(self, now: float) -> bytes:
        moving = self._axes_move(now) and now >= self._idle_until
        state = self._state
        if state == "Hold":
            state = "Hold:1" if now < self._braked else "Hold:0"
        elif state == "Idle" and moving:
            state = "Run"
        busy = state not in ("Idle", "Alarm")
        place = ",".join(f"{value + 0.0:.3f}" for value in self._stands(now).values())
        feed = self._feed if state == "Run" else 0
        fields = [state, f"{'MPos' if int(self._settings[10]) & 1 else 'WPos'}:{place}", f"FS:{feed:.0f},0"]
        if self._until_wco > 0:
            self._until_wco -= 1
        else:
            self._until_wco = 29 if busy else 9
            self._until_ov = max(self._until_ov, 1)
            fields.append("WCO:0.000,0.000,0.000")
        if self._until_ov > 0:
            self._until_ov -= 1
        else:
            self._until_ov = 19 if busy else 9
            fields.append("Ov:100,100,100")
        return f"<{'|'.join(fields)}>\r\n".encode()

    def _work(self, now: float) -> bytes:
        out = b""
        while self._lines and not self._waits(self._lines[0], now):
            text = self._lines.popleft()
            if (code := self._struck("refuse")) is not None:
                out += f"error:{code}\r\n".encode()
                continue
            try:
                out += self._dollar(text, now) if text.startswith("$") else self._gcode(text, now)
            except GcodeError as error:
                out += f"error:{error.code}\r\n".encode()
        return out

    def _waits(self, text: str, now: float) -> bool:
        if self._critical or self._homing:
            return True
        return not text.startswith("$") and (self._axes_move(now) or self._state == "Hold")

    def _gcode(self, text: str, now: float) -> bytes:
        if self._state == "Alarm":
            raise GcodeError(9)
        words, feed = parse_line(text)
        if not words:
            return b"ok\r\n"
        target = self._stands(now)
        for name, number in words.items():
            steps = self._settings[100 + _NAMES.index(name)]
            target[name] = round(number * steps) / steps
        if self._settings[20] and not self._inside(target):
            self._withheld = b"ok\r\n"
            return self._alarm(2, now)
        self._start(target, feed, now)
        return b"ok\r\n"

    def _inside(self, target: Mapping[str, float]) -> bool:
        return all(-self._settings[130 + i] <= target[name] <= 0 for i, name in enumerate(_NAMES))

    def _start(self, target: Mapping[str, float], feed: float, now: float) -> None:
        """Go straight to a target with a feed [mm/min], or as fast as the axes can."""
        here = self._stands(now)
        ways = {name: abs(target[name] - here[name]) for name in _NAMES if target[name] != here[name]}
        way = math.hypot(*ways.values())
        fastest = (self._settings[110 + _NAMES.index(name)] * way / part for name, part in ways.items())
        self._feed = min([feed, *fastest])
        self._idle_until = now + _SLOW_START_S
        for name, part in ways.items():
            self._axes[name].move(target[name], self._feed / 60 * part / way, now)

    def _dollar(self, text: str, now: float) -> bytes:
        line = text.replace(" ", "").upper()
        if line in ("$$", "$H") and (self._axes_move(now) or self._state == "Hold"):
            raise GcodeError(8)
        if line == "$$":
            return self._settings.lines() + b"ok\r\n"
        if line == "$I":
            return b"[VER:1.1h.20190830:]\r\n[OPT:V,15,128]\r\nok\r\n"
        if line == "$X":
            locked, self._state = self._state == "Alarm", "Idle"
            return (b"[MSG:Caution: Unlocked]\r\n" if locked else b"") + b"ok\r\n"
        if line == "$H":
            return self._home(now)
        raise GcodeError(3)

    def _home(self, now: float) -> bytes:
        if not self._settings[22]:
            raise GcodeError(5)
        self._homing = True
        for axis in self._axes.values():
            axis.home(self._home_speed, now, becomes=-self._settings[27])
        return b""
