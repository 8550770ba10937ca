"""Whether a frame is the one that was asked for: whole, new, and after the one before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.hardware._errors import ReplyError

__all__ = ["FrameOrder", "RawFrame"]

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
        The camera's own.
    timestamp_ns
        The camera's own time [ns]; None where it has none.
    problem
        What is wrong with it in words; None: it is whole.
    """

    data: NDArray[np.uint8]
    width: int
    height: int
    number: int
    code: int | None = None
    timestamp_ns: int | None = None
    problem: str | None = None


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
            raise ReplyError(f"frame {frame.number} is incomplete: {frame.problem}")
        last = self._last
        if last is not None:
            step = frame.number - last.number
            if step < 0 and last.number > _LAST_ID - _NEAR and frame.number < _NEAR:
                step = 1  # the count of GigE Vision 1 ends at 65535
            if step == 0:
                raise ReplyError(f"frame {frame.number} came a second time")
            if step < 0:
                raise ReplyError(f"frame {frame.number} came after frame {last.number}")
            if frame.timestamp_ns and last.timestamp_ns and frame.timestamp_ns <= last.timestamp_ns:
                raise ReplyError(
                    f"frame {frame.number} is stale: it was taken {(last.timestamp_ns - frame.timestamp_ns) / 1e6:.3g} "
                    f"ms before frame {last.number}"
                )
            self.lost += step - 1
        self._last = frame
