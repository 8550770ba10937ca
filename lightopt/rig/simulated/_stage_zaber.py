"""Simulated firmware of Zaber controllers in the ASCII protocol.

Message number and checksum of a command are optional; a command with a wrong checksum is not answered.
"""

import re
from collections.abc import Mapping

from lightopt.rig.simulated._firmware import StageFirmware

_SPEED_UNIT = 1.6384
_COMMAND = re.compile(r"/(?P<device>\d{1,2}) (?P<axis>\d)(?: (?P<id>\d{1,2}))?(?: (?P<words>[a-z].*?))? *")
_DEVICE_SETTINGS = {"deviceid": "30222", "version": "7.38", "system.serial": "104857"}
_MAXSPEED = 153_600


class ZaberFirmware(StageFirmware):
    """A chain with one device; an axis that stands off its target when it stops flags FS, one at a switch WL."""

    END = b"\n"

    def __init__(
        self,
        *,
        axes: Mapping[str, Mapping[str, float]] | None = None,
        limits: Mapping[str, tuple[int, int]] | None = None,  # limit.min and limit.max of each axis by its number
        home_speed: float = 50_000.0,  # of the search for the home sensor [microsteps/s]
    ) -> None:
        super().__init__({"1": {}, "2": {}} if axes is None else axes)
        names = list(self._axes)
        if names != [str(number + 1) for number in range(len(names))]:
            raise ValueError(f"the axes are numbered from 1, found {', '.join(names)}")
        self._settings: dict[str, dict[str, int]] = {}
        for name in names:
            low, high = (limits or {}).get(name, (0, 1_000_000))
            self._settings[name] = {"limit.min": low, "limit.max": high, "maxspeed": _MAXSPEED}
        self._home_speed = home_speed
        self._flags: dict[str, set[str]] = {name: set() for name in names}
        self._moves = dict.fromkeys(names, False)
        self._to: dict[str, float] = {}

    def _answer(self, command: bytes, now: float) -> bytes:
        start = command.rfind(b"/")
        if start < 0:
            return b""
        text = command[start:].rstrip(b"\r").decode("ascii", "replace")
        body, colon, checksum = text.rpartition(":")
        if colon and re.fullmatch(r"[0-9A-F]{2}", checksum):
            if (sum(text[1:].split(":")[0].encode()) + int(checksum, 16)) & 0xFF:
                return b""
            text = body
        match = _COMMAND.fullmatch(text)
        if match is None:
            return self._reply(0, None, "RJ", "BADCOMMAND", now)
        axis, number = int(match["axis"]), match["id"]
        if int(match["device"]) != 1:
            return b""
        if axis > len(self._flags):
            return self._reply(0, number, "RJ", "BADAXIS", now)
        words = (match["words"] or "").split()
        names = [str(axis)] if axis else list(self._flags)
        data = self._obey(words, names, axis, now)
        rejected = data in ("BADCOMMAND", "BADDATA")
        return self._reply(axis, number, "RJ" if rejected else "OK", data, now)

    def _reply(self, axis: int, number: str | None, flag: str, data: str, now: float) -> bytes:
        names = [str(axis)] if axis else list(self._flags)
        busy = any(self._axes[name].moving(now) for name in names)
        warning = next(iter(self._warnings(names, now)), "--")
        words = ["01", str(axis)] + ([f"{int(number):02d}"] if number else [])
        body = " ".join([*words, flag, "BUSY" if busy else "IDLE", warning, data]).encode()
        return b"@" + body + f":{-sum(body) & 0xFF:02X}\r\n".encode()

    def _warnings(self, names: list[str], now: float) -> list[str]:
        found: set[str] = set()
        for name in names:
            axis = self._axes[name]
            still = not axis.moving(now)
            if still and self._moves[name]:
                self._moves[name] = False
                if axis.at_limit:
                    self._flags[name].add("WL")
                elif name in self._to and axis.count(now) != self._to[name]:
                    self._flags[name].add("FS")
            found |= self._flags[name]
            if not axis.homed:
                found.add("WR")
        return sorted(found, key="FD FQ FS FT FB FP FE WH WL WP WV WT WM WR NC NI ND NU NJ".find)

    def _obey(self, words: list[str], names: list[str], axis: int, now: float) -> str:
        match words:
            case []:
                return "0"
            case ["get", "pos"]:
                return " ".join(str(round(self._axes[name].count(now))) for name in names)
            case ["get", setting] if axis == 0 and setting in _DEVICE_SETTINGS:
                return _DEVICE_SETTINGS[setting]
            case ["get", setting] if setting in self._settings[names[0]]:
                return " ".join(str(self._settings[name][setting]) for name in names)
            case ["set", "maxspeed", value]:
                if not value.isdecimal() or int(value) < 1:
                    return "BADDATA"
                for name in names:
                    self._settings[name]["maxspeed"] = int(value)
                return "0"
            case ["warnings"] | ["warnings", "clear"]:
                found = self._warnings(names, now)
                if len(words) > 1:
                    for name in names:
                        self._flags[name].clear()
                return " ".join([f"{len(found):02d}", *found])
            case ["stop"]:
                for name in names:
                    self._axes[name].stop(now)
                    self._moves[name] = False
                return "0"
            case ["home"]:
                for name in names:
                    self._axes[name].home(self._home_speed, now)
                    self._moves[name], self._to[name] = True, 0.0
                return "0"
            case ["move", "abs", where]:
                return self._move(where, names, now)
            case _:
                return "BADCOMMAND"

    def _move(self, where: str, names: list[str], now: float) -> str:
        if re.fullmatch(r"-?\d+", where) is None:
            return "BADDATA"
        target = int(where)
        if not all(self._settings[n]["limit.min"] <= target <= self._settings[n]["limit.max"] for n in names):
            return "BADDATA"
        for name in names:
            if self._axes[name].moving(now):
                self._flags[name].add("NI")
            else:
                self._flags[name].discard("NI")
            self._axes[name].move(float(target), self._settings[name]["maxspeed"] / _SPEED_UNIT, now)
            self._moves[name], self._to[name] = True, float(target)
        return "0"
