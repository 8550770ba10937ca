"""Registry of simulated firmware, and what it implements. Add a new device here.

Firmware is written from the tables of its protocol, not from the driver: the two meet on the wire only.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any, Protocol, cast, runtime_checkable


class Firmware(Protocol):
    """A device behind a wire. Time [s] is given, never read, so that a dialogue can be replayed.

    feed: Take bytes off the wire and return the bytes to send; incomplete commands are kept.
    poll: Bytes that the device sends on its own or late (banners, withheld replies); often none.
    inject: Set a fault of the device from now on: a stalled axis, a light that stays dark; ``clear`` ends all. Faults
        of the line never come here. Raises a ValueError that lists the faults that there are.
    """

    def feed(self, data: bytes, now: float) -> bytes: ...
    def poll(self, now: float) -> bytes: ...
    def inject(self, fault: str, options: dict[str, Any], now: float) -> None: ...


@runtime_checkable
class LightFirmware(Firmware, Protocol):
    """A light controller.

    levels: Brightness of each channel from 1 up, as a share of the highest intensity; 0 when off.
    """

    def levels(self) -> dict[int, float]: ...


@runtime_checkable
class StageFirmware(Firmware, Protocol):
    """A stage controller.

    positions: Where each axis really stands, in device units by the axis' name.
    """

    def positions(self, now: float) -> dict[str, float]: ...


# Imported when needed: a bench of two devices does not load the others.
FIRMWARE = {
    "ccs": ("lightopt.rig.simulated._light_ccs", "CcsFirmware"),
    "sa": ("lightopt.rig.simulated._light_sa", "SaFirmware"),
    "template": ("lightopt.rig.simulated._light_template", "TemplateFirmware"),
    "shot": ("lightopt.rig.simulated._stage_sigmakoki", "ShotFirmware"),
    "gsc": ("lightopt.rig.simulated._stage_sigmakoki", "GscFirmware"),
    "grbl": ("lightopt.rig.simulated._stage_grbl", "GrblFirmware"),
    "zaber": ("lightopt.rig.simulated._stage_zaber", "ZaberFirmware"),
}


def build(kind: str, options: dict[str, Any]) -> Firmware:
    """Power up the firmware of a protocol; a ValueError for an unknown one, or options that it refuses."""
    if kind not in FIRMWARE:
        raise ValueError(f'no firmware called "{kind}"; there is {", ".join(FIRMWARE)}')
    module, name = FIRMWARE[kind]
    make = cast("Callable[..., Firmware]", getattr(import_module(module), name))
    try:
        return make(**options)
    except TypeError as error:
        raise ValueError(f"firmware {kind}: {error}") from None
