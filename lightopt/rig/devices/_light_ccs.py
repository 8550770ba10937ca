"""Driver of light controllers that speak CCS ``@`` frames (CCS PD2, PD3, PSB; VS Technology VLP).

A frame is ``@``, the channel from 00, an instruction with its data, in the serial dialect the unit number 00, a
checksum (sum of all bytes before it, modulo 256, two upper-case hexadecimal digits), CR, LF. A reply is ``@``, the
channel, ``O`` with data or ``N`` with the number of an error, and a checksum.
"""

import re

from lightopt.rig.devices._device import RefusedError, ReplyError, printable
from lightopt.rig.devices._light import LightController, LightSettings
from lightopt.rig.devices._serial_link import SerialLink

_DAMAGED = "02"
_REFUSALS = {
    "01": "it does not know the command",
    _DAMAGED: "the command reached it damaged: checksum error",
    "03": "the value or channel is out of its range",
}


class CcsController(LightController):
    """A light controller with CCS ``@`` frames: in dialect ``lan`` without unit number, in ``serial`` with it.

    The first thing on the wire is the question for the unit's status: some controllers need a power cycle after a
    connection on which nothing was sent. No light changes. A controller that refuses ``M`` cannot be read back.
    """

    NAME = "ccs"
    BAUD = 38400
    GAP_S = 0.0055  # the controllers ask for 5 ms between commands

    def __init__(self, link: SerialLink, settings: LightSettings) -> None:
        super().__init__(link, settings)
        self._unit = "00" if settings.dialect == "serial" else ""
        self._digits = max(3, len(str(self.top_level)))
        self._query_identity()
        self._reads = self._can_read_levels()

    def _query_identity(self) -> dict[str, str]:
        return {"status": self._ask(1, "C")}

    def _send_level(self, channel: int, level: int) -> None:
        """Set the intensity, then switch: a light comes on at its level, and goes dark twice over."""
        on = level > 0
        try:
            self._ask(channel, f"F{level:0{self._digits}d}")
        finally:
            if not on:  # even if the intensity was not accepted
                self._ask(channel, "L0")
        if on:
            self._ask(channel, "L1")

    def _query_level(self, channel: int) -> int:
        level, _, on = self._settings(channel)
        return level if on else 0

    def _verify(self, channel: int, level: int) -> None:
        held, mode, on = self._settings(channel)
        if mode != 0 and level > 0:
            strobe = f"channel {channel} is in strobe mode S{mode:02d}, in which it waits for triggers"
            advice = "set it to S00 (on/off) with the maker's tool, or by sending"
            raise self._link.failure(f"{strobe}; {advice} {printable(self._frame(channel, 'S00'))}")
        if held != level or on != (level > 0):
            state = f"{held} and is switched {'on' if on else 'off'}"
            raise self._link.failure(f"channel {channel} was set to {level} but holds {state}")

    def _settings(self, channel: int) -> tuple[int, int, bool]:
        """Intensity, mode, and whether it is switched on."""
        data = self._ask(channel, "M", r"F(\d{3,4})\.S(\d\d)\.L([01])(?:00)?")
        level, mode, on = data.split(".")
        return int(level[1:]), int(mode[1:]), on[1] == "1"

    def _ask(self, channel: int, instruction: str, expected: str = r"\d{0,4}") -> str:
        """Send an instruction that may be repeated; the data of the reply."""
        return self._retry.run(lambda: self._ask_once(channel, instruction, expected))

    def _frame(self, channel: int, instruction: str) -> bytes:
        body = f"@{channel - 1:02d}{instruction}{self._unit}".encode("ascii")
        return body + _checksum(body) + b"\r\n"

    def _ask_once(self, channel: int, instruction: str, expected: str) -> str:
        frame = self._frame(channel, instruction)
        reply = self._link.query(frame, end=b"\r\n")
        match = re.fullmatch(rb"(@(\d\d)([ON])([ -~]*))([0-9A-F]{2})\r\n", reply)
        kind = ReplyError
        if match is None:
            problem = "the reply is not a frame"
        elif match[5] != _checksum(match[1]):
            problem = "the reply has a wrong checksum"
        elif int(match[2]) != channel - 1:
            problem = "the reply is for another channel"
        elif match[3] == b"N":
            code = match[4][:2].decode("ascii")
            problem = f"{_REFUSALS.get(code, 'it refuses')} (NG {match[4].decode('ascii')})"
            kind = ReplyError if code == _DAMAGED else RefusedError
        elif re.fullmatch(expected, data := match[4].decode("ascii")) is None:
            problem = "the reply is to another command"
        else:
            return data
        raise self._link.failure(problem, sent=frame, reply=reply, kind=kind)


def _checksum(body: bytes) -> bytes:
    return f"{sum(body) % 256:02X}".encode("ascii")
