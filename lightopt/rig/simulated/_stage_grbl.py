"""Simulated firmware of Grbl 1.1h.

Written from Grbl's interface description, and held by tests to dialogues that were recorded from a Grbl 1.1h. What it
keeps of the real one: ``ok`` when a move is planned; a report in the first milliseconds after it that is still Idle;
realtime bytes; silence after ALARM:1 and ALARM:2 until a reset, and the withheld ``ok`` before the banner then; a
locked start with homing enabled; a machine space from 0 down to −$130; no reports during homing. It knows what the
driver sends and ``$X``, and plans one move: a line that follows waits for its end.
"""

import math
import re
from collections import deque
from collections.abc import Mapping

from lightopt.rig.simulated._firmware import StageFirmware

_WORD = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))")
_KNOWN = {1, 21, 53, 90, 94}
_LETTER, _NUMBER, _UNSUPPORTED, _NO_FEED = 1, 2, 20, 22


class GcodeError(Exception):
    """A line that Grbl refuses, with the number of the error."""


def parse_line(text: str) -> tuple[dict[str, float], float]:
    """Target of a line by axis [mm], empty where it only sets modes, and its feed [mm/min]."""
    line = re.sub(r"\s", "", text).upper()
    words: dict[str, float] = {}
    commands: set[float] = set()
    while line:
        match = _WORD.match(line)
        if match is None:
            raise GcodeError(_NUMBER if line[0].isalpha() else _LETTER)
        letter, number = match[1], float(match[2])
        if letter == "G" and number in _KNOWN:
            commands.add(number)
        elif letter in "XYZF":
            words[letter] = number
        else:
            raise GcodeError(_UNSUPPORTED)
        line = line[match.end() :]
    feed = words.pop("F", 0.0)
    if words and 1 not in commands:
        raise GcodeError(_UNSUPPORTED)
    if words and feed <= 0:
        raise GcodeError(_NO_FEED)
    return words, feed


# settings as a Grbl 1.1h lists them when new: number and value, with as many decimals as it writes
_LISTED = """
0=10 1=25 2=0 3=0 4=0 5=0 6=0 10=1 11=0.010 12=0.002 13=0 20=0 21=0 22=0 23=0 24=25.000 25=500.000 26=250 27=1.000
30=1000 31=0 32=0 100=250.000 101=250.000 102=250.000 110=500.000 111=500.000 112=500.000
120=10.000 121=10.000 122=10.000 130=200.000 131=200.000 132=200.000
"""
_NEW = {number: value for number, _, value in (item.partition("=") for item in _LISTED.split())}

_NAMES = ("X", "Y", "Z")
_BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
_UNLOCK = b"[MSG:'$H'|'$X' to unlock]\r\n"
_RESET_FIRST = b"[MSG:Reset to continue]\r\n"
_CRITICAL = (1, 2)
_SLOW_START_S = 0.004  # a report so soon after the ok is still Idle
_BRAKE_S = 0.02


class GrblFirmware(StageFirmware):
    """A Grbl 1.1h with three axes; one that meets a limit switch raises ALARM:1."""

    def __init__(
        self,
        *,
        axes: Mapping[str, Mapping[str, float]] | None = None,
        settings: Mapping[str, float] | None = None,  # other than the usual ones by number: {"22": 1}
        home_speed: float = 50.0,
    ) -> None:
        given = axes or {}
        if not set(given) <= set(_NAMES):
            raise ValueError(f"the axes are X, Y and Z, found {', '.join(given)}")
        super().__init__({name: given.get(name, {}) for name in _NAMES})
        self._settings = {int(number): float(value) for number, value in _NEW.items()}
        for number, value in (settings or {}).items():
            if number not in _NEW:
                raise ValueError(f"Grbl has no setting ${number}")
            self._settings[int(number)] = float(value)
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
                self._status_wanted = self._homing  # no report while it seeks the switches
                out += b"" if self._homing else self._report(now)
            elif byte == b"!":
                if self._state == "Idle" and not self._homing:
                    self._braked = now + _BRAKE_S if self._axes_move(now) else now
                    self._stop_axes(now)
                    self._state = "Hold"
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
            try:
                out += self._dollar(text, now) if text.startswith("$") else self._gcode(text, now)
            except GcodeError as error:
                out += f"error:{error.args[0]}\r\n".encode()
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
        inside = all(-self._settings[130 + i] <= target[name] <= 0 for i, name in enumerate(_NAMES))
        if self._settings[20] and not inside:
            self._withheld = b"ok\r\n"
            return self._alarm(2, now)
        self._start(target, feed, now)
        return b"ok\r\n"

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
            decimals = {int(number): len(value.partition(".")[2]) for number, value in _NEW.items()}
            lines = (f"${number}={value:.{decimals[number]}f}\r\n" for number, value in self._settings.items())
            return "".join(lines).encode() + b"ok\r\n"
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
