"""Where the time of a capture went."""

import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timezone


@dataclass
class Timing:
    """Time spent on each part of a capture [s].

    opening_s: Reading the mesh, planning, and opening the devices.
    closing_s: Switching all lights off once more at the end, and closing the devices.
    """

    whole_s: float = 0.0
    opening_s: float = 0.0
    moving_s: float = 0.0
    settling_s: float = 0.0
    exposing_s: float = 0.0
    transfer_s: float = 0.0
    lights_s: float = 0.0
    writing_s: float = 0.0
    closing_s: float = 0.0

    @property
    def other_s(self) -> float:
        """Time that is in none of the parts: checks, means, the interpreter [s]."""
        return self.whole_s - sum(self.parts().values())

    @property
    def overhead(self) -> float:
        """Time beyond settling, exposing and transfer, as a share of these; without opening, closing and moves."""
        needed = self.settling_s + self.exposing_s + self.transfer_s
        spent = self.whole_s - self.opening_s - self.closing_s - self.moving_s
        return (spent - needed) / needed if needed else 0.0

    def parts(self) -> dict[str, float]:
        """Seconds by name, without the whole."""
        return {name: value for name, value in vars(self).items() if name != "whole_s"}

    @contextmanager
    def spent(self, name: str) -> Generator[None]:
        """Count the time of the block as `name`."""
        begun = time.monotonic()
        try:
            yield
        finally:
            setattr(self, name, getattr(self, name) + time.monotonic() - begun)


def utc(seconds: float | None = None) -> str:
    """A moment [s since 1970] in ISO 8601 with milliseconds, UTC; now by default."""
    moment = datetime.now(timezone.utc) if seconds is None else datetime.fromtimestamp(seconds, timezone.utc)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")
