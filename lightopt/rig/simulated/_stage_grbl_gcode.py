"""The little of G-code that a stage needs, as Grbl 1.1 reads it, and the settings ``$0`` to ``$132``."""

import re
from collections.abc import Mapping

_WORD = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))")
_KNOWN = {1, 21, 53, 90, 94}
_LETTER, _NUMBER, _UNSUPPORTED, _NO_FEED = 1, 2, 20, 22


class GcodeError(Exception):
    """A line that Grbl refuses, with the number of the error."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def parse_line(text: str) -> tuple[dict[str, float], float]:
    """Target of a line by axis [mm], empty where it only sets modes, and its feed [mm/min]."""
    line = re.sub(r"\s", "", text).upper()
    words: dict[str, float] = {}
    commands: set[float] = set()
    at = 0
    while at < len(line):
        match = _WORD.match(line, at)
        if match is None:
            raise GcodeError(_NUMBER if line[at].isalpha() else _LETTER)
        letter, number = match[1], float(match[2])
        if letter == "G" and number in _KNOWN:
            commands.add(number)
        elif letter in "XYZF":
            words[letter] = number
        else:
            raise GcodeError(_UNSUPPORTED)
        at = match.end()
    feed = words.pop("F", 0.0)
    if words and 1 not in commands:
        raise GcodeError(_UNSUPPORTED)
    if words and feed <= 0:
        raise GcodeError(_NO_FEED)
    return words, feed


# as a Grbl 1.1h lists them when new: number=value, with as many decimals as it writes
_NEW = """
0=10 1=25 2=0 3=0 4=0 5=0 6=0 10=1 11=0.010 12=0.002 13=0 20=0 21=0 22=0 23=0 24=25.000 25=500.000 26=250 27=1.000
30=1000 31=0 32=0 100=250.000 101=250.000 102=250.000 110=500.000 111=500.000 112=500.000
120=10.000 121=10.000 122=10.000 130=200.000 131=200.000 132=200.000
"""


class GrblSettings:
    """The settings by number; `changed` are those that are not as new, by their numbers as text."""

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
            f"${number}={value:.{self._decimals[number]}f}\r\n".encode() for number, value in self._values.items()
        )
