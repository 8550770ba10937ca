"""SIGMA KOKI / OptoSigma controllers of the SHOT family, which answer OK or NG to each command (MAIN mode).

``A:1+P9000`` or ``A:W+P1800-P2000`` names where to go and ``G:`` goes there; ``Q:`` tells where the axes are and
whether they move; ``H:1`` or ``H:W`` seeks the mechanical origin, where the count becomes 0; ``L:E`` stops at once.
While an axis moves only stop and status are taken. The count starts at 0 when the controller is switched on, wherever
the stage stands, and nothing tells whether it has been homed since. The controller has no limits but its switches.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lightopt.rig.devices._axes import Axis
from lightopt.rig.devices._dialogue import Reading
from lightopt.rig.devices._errors import ReplyError
from lightopt.rig.devices._link import SerialLink
from lightopt.rig.devices._retry import Persistence
from lightopt.rig.devices._sigmakoki import (
    END,
    RAMP_MS,
    axis_words,
    check_axes,
    command,
    parse_status,
    reading_of,
    signed,
)

_SLOWEST, _FASTEST = 1, 500_000  # [pulses/s]


def check_shot(axes: Sequence[Axis]) -> None:
    """Refuse axes and speeds that the controller cannot have."""
    check_axes(axes, slowest=_SLOWEST, fastest=_FASTEST)


class ShotDialogue:
    """The language of the SHOT family; see :class:`~lightopt.rig.devices._dialogue.Dialogue`.

    Raises
    ------
    lightopt.core.errors.InputError
        For axes or speeds that the controller cannot have.
    """

    def __init__(self, link: SerialLink, axes: Sequence[Axis]) -> None:
        check_shot(axes)
        self.link = link
        self.homes_to_end = False
        self._patience = Persistence(link)
        self._axes = tuple(axes)

    def says(self) -> dict[str, str]:
        """Version of the controller's program."""
        version = self._patience.ask(lambda: self._query("?:V"))
        return {} if version == "NG" else {"version": version}

    def read(self) -> Reading:
        """Where the axes are and whether they move."""
        return self._patience.ask(self._read)

    def step(self, axis: Axis) -> float:  # noqa: ARG002  (the same for all)
        """One pulse."""
        return 1.0

    def check(self, targets: Mapping[str, float]) -> None:
        """The controller has no limits to check against."""

    def prepare(self) -> None:
        """Set the speed of each axis."""
        for axis in self._axes:
            fast = round(axis.speed_units())
            slow = max(_SLOWEST, fast // 10)
            text = f"D:{axis.device}S{slow}F{fast}R{RAMP_MS}"
            self._patience.ask(lambda text=text: self._command(text))

    def go(self, targets: Mapping[str, float]) -> None:
        """Name the targets, which may be said twice, and go, which may not."""
        text = axis_words("A", {axis: signed(round(units)) for axis, units in targets.items()})
        self._patience.ask(lambda: self._command(text))
        self._command("G:")

    def home(self) -> None:
        """Start to seek the origin of the axes in use."""
        self._command("H:W" if len(self._axes) == 2 else f"H:{self._axes[0].device}")

    def homed(self, reading: Reading) -> str | None:
        """The count is 0 at the origin."""
        if reading.alarm is not None:
            return reading.alarm
        off = [f"axis {axis} reads {units:g}" for axis, units in reading.units.items() if units != 0]
        return f"{', '.join(off)} pulses, not 0" if off else None

    def halt(self) -> None:
        """Stop at once."""
        self._patience.ask(lambda: self._command("L:E"))

    def _read(self) -> Reading:
        line = self.link.query(command("Q:"), end=END)
        try:
            return reading_of(parse_status(line), self._axes)
        except ValueError as error:
            raise ReplyError(self.link.words(str(error), sent=command("Q:"))) from None

    def _query(self, text: str) -> str:
        return self.link.query(command(text), end=END).decode("ascii", "replace").strip()

    def _command(self, text: str) -> None:
        reply = self.link.query(command(text), end=END)
        if reply == b"NG\r\n":
            raise self.link.failure(
                "refused (NG): the command is wrong, or the stage is moving", sent=command(text), reply=reply
            )
        if reply != b"OK\r\n":
            raise ReplyError(self.link.words("expected OK or NG", sent=command(text), reply=reply))
