"""The settings of a simulated Grbl 1.1: ``$0`` to ``$132``, which outlast a power cycle."""

from __future__ import annotations

import re
from collections.abc import Mapping

from lightopt.rig.simulated._gcode import GcodeError

# as a Grbl 1.1h lists them when new: number=value, with as many decimals as it writes
_NEW = """
0=10 1=25 2=0 3=0 4=0 5=0 6=0 10=1 11=0.010 12=0.002 13=0 20=0 21=0 22=0 23=0 24=25.000 25=500.000 26=250 27=1.000
30=1000 31=0 32=0 100=250.000 101=250.000 102=250.000 110=500.000 111=500.000 112=500.000
120=10.000 121=10.000 122=10.000 130=200.000 131=200.000 132=200.000
"""
_UNKNOWN, _NEEDS_HOMING = 3, 10
_SOFT_LIMITS, _HOMING = 20, 22


class Settings:
    """The settings by number.

    Parameters
    ----------
    changed
        Those that are not as new, by their numbers as text.
    """

    def __init__(self, changed: Mapping[str, float]) -> None:
        self._values: dict[int, float] = {}
        self._decimals: dict[int, int] = {}
        for item in _NEW.split():
            number, _, value = item.partition("=")
            self._values[int(number)] = float(value)
            self._decimals[int(number)] = len(value.partition(".")[2])
        for key, value in changed.items():
            if not key.isdigit() or int(key) not in self._values:
                raise ValueError(f"Grbl has no setting ${key}")
            self._values[int(key)] = float(value)

    def __getitem__(self, number: int) -> float:
        return self._values[number]

    def lines(self) -> bytes:
        """Answer to ``$$`` without its ok."""
        return b"".join(
            f"${number}={value:.{self._decimals[number]}f}\r\n".encode()
            for number, value in self._values.items()
        )

    def set_from(self, line: str) -> None:
        """Obey ``$number=value``.

        Raises
        ------
        GcodeError
            When Grbl refuses it.
        """
        match = re.fullmatch(r"\$(\d+)=(\d+(?:\.\d+)?)", line)
        if match is None or int(match[1]) not in self._values:
            raise GcodeError(_UNKNOWN)
        number, value = int(match[1]), float(match[2])
        if number == _SOFT_LIMITS and value and not self._values[_HOMING]:
            raise GcodeError(_NEEDS_HOMING)
        self._values[number] = value
        if number == _HOMING and not value:
            self._values[_SOFT_LIMITS] = 0.0
