"""The simulated firmware that the host can run, by the name of its protocol."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any, cast

from lightopt.rig.simulated._firmware import Firmware

# Imported when asked for: a host of two devices need not load the others.
FIRMWARE = {
    "ccs": ("lightopt.rig.simulated._ccs", "CcsFirmware"),
    "sa": ("lightopt.rig.simulated._sa", "SaFirmware"),
    "template": ("lightopt.rig.simulated._template", "TemplateFirmware"),
    "shot": ("lightopt.rig.simulated._shot", "ShotFirmware"),
    "gsc": ("lightopt.rig.simulated._gsc", "GscFirmware"),
    "grbl": ("lightopt.rig.simulated._grbl", "GrblFirmware"),
    "zaber": ("lightopt.rig.simulated._zaber", "ZaberFirmware"),
}


def build(kind: str, options: dict[str, Any]) -> Firmware:
    """Power up the firmware of a protocol.

    Parameters
    ----------
    kind
        Name of the protocol.
    options
        Keyword arguments of the firmware, of JSON's types.

    Raises
    ------
    ValueError
        For an unknown protocol, or options that its firmware refuses.
    """
    if kind not in FIRMWARE:
        raise ValueError(f'no firmware called "{kind}"; there is {", ".join(FIRMWARE)}')
    module, name = FIRMWARE[kind]
    make = cast("Callable[..., Firmware]", getattr(import_module(module), name))
    try:
        return make(**options)
    except TypeError as error:
        raise ValueError(f"firmware {kind}: {error}") from None
