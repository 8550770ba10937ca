"""What the machine-vision camera needs of the software of a camera: features by their standard names, and frames."""

from __future__ import annotations

from typing import Protocol

from lightopt.rig.devices._frame_order import RawFrame


class CameraSdk(Protocol):
    """An opened camera. Features have the names of GenICam's Standard Features Naming Convention (SFNC).

    Every method raises :class:`~lightopt.core.errors.HardwareError` when the camera does not answer or refuses, and
    :class:`~lightopt.rig.devices.LinkLostError` when it is gone.
    """

    @property
    def says(self) -> dict[str, str]:
        """What the camera says of itself: maker, model, serial number, address."""
        ...

    def has(self, feature: str) -> bool:
        """Whether the camera has a feature and it can be used as things are."""
        ...

    def number(self, feature: str) -> float:
        """Read a number."""
        ...

    def set_number(self, feature: str, value: float) -> None:
        """Write a number, rounded where the feature is whole."""
        ...

    def bounds(self, feature: str) -> tuple[float, float, float]:
        """Lowest and highest number, and the step between them (0: any)."""
        ...

    def unit(self, feature: str) -> str:
        """What the camera says that a number counts (us, dB); empty where it says nothing."""
        ...

    def word(self, feature: str) -> str:
        """Read the entry of an enumeration."""
        ...

    def set_word(self, feature: str, word: str) -> None:
        """Choose an entry of an enumeration."""
        ...

    def words(self, feature: str) -> tuple[str, ...]:
        """Entries of an enumeration that can be chosen."""
        ...

    def is_on(self, feature: str) -> bool:
        """Read a truth value."""
        ...

    def switch_off(self, feature: str) -> None:
        """Set a truth value to false."""
        ...

    def do(self, feature: str) -> None:
        """Execute a command."""
        ...

    def start(self) -> None:
        """Begin an acquisition; no frame of an earlier one is delivered afterwards."""
        ...

    def stop(self) -> None:
        """End the acquisition."""
        ...

    def pop(self, timeout_s: float) -> RawFrame | None:
        """The next frame, whole or not; None when none came in time."""
        ...

    def close(self) -> None:
        """Give the camera up; never raises."""
        ...


def first_of(sdk: CameraSdk, *names: str) -> str | None:
    """The first of several names of a feature that the camera has."""
    return next((name for name in names if sdk.has(name)), None)
