"""Whether a frame is the one that was asked for: whole, new, and after the one before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.rig.devices._errors import ReplyError

_LAST_ID = 0xFFFF
_NEAR = 0x1000  # numbers so near to the end and the beginning of the count are a wrap, not a step back


@dataclass(frozen=True, kw_only=True)
class RawFrame:
    """A frame as it came over the cable.

    Attributes
    ----------
    data
        Its bytes, shape (n,).
    width, height
        As it says of itself [pixels].
    code
        Its pixel format as a number of the naming convention; None where it does not say.
    number
        The camera's own; None where it has none.
    timestamp_ns
        The camera's own time [ns]; None where it has none.
    problem
        What is wrong with it in words; None: it is whole.
    """

    data: NDArray[np.uint8]
    width: int
    height: int
    number: int | None
    code: int | None = None
    timestamp_ns: int | None = None
    problem: str | None = None

    @property
    def name(self) -> str:
        """What it is called in messages."""
        return "a frame without a number" if self.number is None else f"frame {self.number}"


class FrameOrder:
    """Remembers the last frame of an acquisition and judges the next by it.

    Attributes
    ----------
    lost
        Frames that the camera counted and that never came, since the beginning.
    """

    def __init__(self) -> None:
        self.lost = 0
        self._last: RawFrame | None = None

    def begin(self) -> None:
        """A new acquisition: cameras may count from the beginning again."""
        self._last = None

    def passed(self, frame: RawFrame) -> None:
        """A frame that nobody asked for went by."""
        self._last = frame

    def check(self, frame: RawFrame) -> None:
        """Refuse a frame that cannot be the one that was asked for.

        Raises
        ------
        ReplyError
            When it is incomplete, came before, or is older than the one before.
        """
        if frame.problem is not None:
            raise ReplyError(f"{frame.name} is incomplete: {frame.problem}")
        last = self._last
        if last is not None:
            step = _step(last.number, frame.number)
            if step == 0:
                raise ReplyError(f"{frame.name} came a second time")
            if step < 0:
                raise ReplyError(f"{frame.name} came after {last.name}")
            if frame.timestamp_ns and last.timestamp_ns and frame.timestamp_ns <= last.timestamp_ns:
                raise ReplyError(
                    f"{frame.name} is stale: it was taken {(last.timestamp_ns - frame.timestamp_ns) / 1e6:.3g} "
                    f"ms before {last.name}"
                )
            self.lost += step - 1
        self._last = frame


def _step(last: int | None, number: int | None) -> int:
    """Frames from one to the next as they are numbered; 1 where they are not."""
    if last is None or number is None or last == number == 0:  # a count that stays at its beginning is none
        return 1
    step = number - last
    if step < 0 and last > _LAST_ID - _NEAR and number < _NEAR:
        return 1  # the count of GigE Vision 1 ends at 65535
    return step
