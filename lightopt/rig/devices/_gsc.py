"""The SIGMA KOKI / OptoSigma controller GSC-02, which answers to questions only.

It knows no absolute move: the position is asked for, ``M:1+P500`` or ``M:W+P500-P200`` names the way from there,
``G:`` goes it, and the position is verified at the end. A relative move is never sent twice. Whether a command was
taken shows in ACK1 of the next ``Q:``. Seeking the origin needs a sense, ``H:1-`` or ``H:W-+``, and only ``L:W`` and
``L:E`` stop it. ``D:`` sets the speeds of both axes at once, in a slow or in a fast range.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lightopt.core.errors import InputError
from lightopt.rig.devices._axes import Axis
from lightopt.rig.devices._dialogue import Reading
from lightopt.rig.devices._errors import ReplyError
from lightopt.rig.devices._link import SerialLink
from lightopt.rig.devices._retry import Persistence
from lightopt.rig.devices._sigmakoki import (
    END,
    RAMP_MS,
    Status,
    axis_words,
    check_axes,
    command,
    parse_status,
    reading_of,
    signed,
)

_RANGES = {1: (1, 200), 2: (50, 20_000)}  # speed ranges of D: [pulses/s]
_FARTHEST = 16_777_214  # longest relative move [pulses]


def check_gsc(axes: Sequence[Axis]) -> None:
    """Refuse axes and speeds that the controller cannot have."""
    check_axes(axes, slowest=_RANGES[1][0], fastest=_RANGES[2][1])
    _speed_command(axes)


class GscDialogue:
    """The language of the GSC-02; see :class:`~lightopt.rig.devices._dialogue.Dialogue`.

    Raises
    ------
    lightopt.core.errors.InputError
        For axes or speeds that the controller cannot have.
    """

    def __init__(self, link: SerialLink, axes: Sequence[Axis]) -> None:
        check_gsc(axes)
        self.link = link
        self.homes_to_end = False
        self._patience = Persistence(link)
        self._axes = tuple(axes)
        self._speeds = _speed_command(self._axes)

    def says(self) -> dict[str, str]:
        """Version of the controller's program."""
        line = self._patience.ask(lambda: self.link.query(command("?:V"), end=END))
        version = line.decode("ascii", "replace").strip()
        return {"version": version} if version not in ("", "NG") else {}

    def read(self) -> Reading:
        """Where the axes are and whether they move."""
        return self._reading(self._patience.ask(self._status))

    def step(self, axis: Axis) -> float:  # noqa: ARG002  (the same for all)
        """One pulse."""
        return 1.0

    def check(self, targets: Mapping[str, float]) -> None:
        """Raise an InputError for a way that is longer than the command can say."""
        here = self.read().units
        for axis, target in targets.items():
            if abs(target - here[axis]) > _FARTHEST:
                raise InputError(
                    f"stage axis {axis}: {abs(target - here[axis]):.0f} pulses in one move are more than the "
                    f"{_FARTHEST} that the controller takes; nothing was moved"
                )

    def prepare(self) -> None:
        """Set the speed of both axes."""
        self._command(self._speeds)

    def go(self, targets: Mapping[str, float]) -> None:
        """Name the way from here, and go it; each is sent once."""
        here = self.read().units
        self._command(
            axis_words("M", {axis: signed(round(units - here[axis])) for axis, units in targets.items()})
        )
        self._command("G:")

    def home(self) -> None:
        """Start to seek the origin of the axes in use."""
        senses = {axis.device: "+" if axis.home_sense > 0 else "-" for axis in self._axes}
        self._command(axis_words("H", senses))

    def homed(self, reading: Reading) -> str | None:
        """The count is 0 at the origin."""
        if reading.alarm is not None:
            return reading.alarm
        off = [f"axis {axis} reads {units:g}" for axis, units in reading.units.items() if units != 0]
        return f"{', '.join(off)} pulses, not 0" if off else None

    def halt(self) -> None:
        """Stop at once; L:E also stops the search for the origin, which L:1 does not."""
        self._command("L:E")

    def _command(self, text: str) -> None:
        """Send a command, and ask whether it was taken."""
        self.link.send(command(text))
        status = self._patience.ask(self._status)
        if not status.accepted:
            raise self.link.failure(
                "refused (ACK1 is X): the command is wrong, or the stage is moving", sent=command(text)
            )

    def _status(self) -> Status:
        frame = command("Q:")
        line = self.link.query(frame, end=END)
        if line in (b"OK\r\n", b"NG\r\n"):  # from a controller that answers to commands as well
            line = self.link.read(end=END, after=frame)
        try:
            status = parse_status(line)
            reading_of(status, self._axes)
        except ValueError as error:
            raise ReplyError(self.link.words(str(error), sent=frame)) from None
        return status

    def _reading(self, status: Status) -> Reading:
        return reading_of(status, self._axes)


def _speed_command(axes: Sequence[Axis]) -> str:
    """The command that sets both speeds; an axis that the rig does not use gets the other's."""
    speeds = {axis.device: round(axis.speed_units()) for axis in axes}
    given = next(iter(speeds.values()))
    both = [speeds.get("1", given), speeds.get("2", given)]
    for number, (slowest, fastest) in reversed(_RANGES.items()):
        if all(slowest <= speed <= fastest for speed in both):
            words = "".join(f"S{max(slowest, speed // 10)}F{speed}R{RAMP_MS}" for speed in both)
            return f"D:{number}{words}"
    raise InputError(
        f"stage: the speeds {both[0]} and {both[1]} pulses/s are in different ranges of the controller "
        "(1 to 200, 50 to 20000), and it takes both from one; change speed_deg_per_s"
    )
