"""Light controllers whatever their protocol: what opens them, and all lights off."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from lightopt.core.errors import HardwareError, LightoptError, error_text
from lightopt.rig.devices._parallel import side_by_side
from lightopt.rig.devices._roles import LightController

_ATTEMPTS = 3
"""A channel is told to go dark so often where its driver fails in a way of which it knows nothing."""


class LightsStillOnError(HardwareError):
    """Channels could not be switched off.

    Parameters
    ----------
    *messages
        What failed.
    channels
        Those that may still be lit, by the name of the controller.
    """

    def __init__(self, *messages: str, channels: Mapping[str, Sequence[int]]) -> None:
        super().__init__(*messages)
        self.channels = dict(channels)


@dataclass(frozen=True)
class LightSettings:
    """What a driver must know to open a light controller.

    Attributes
    ----------
    name
        Name of the controller in the rig file.
    port
        Serial port or pyserial URL.
    baud
        Baud rate; None is the protocol's usual one.
    channels
        Number of channels.
    top_level
        Highest intensity.
    dialect
        ccs: ``lan`` or ``serial``.
    template
        template: commands and patterns of replies, by the words of the rig file.
    timeout_s
        Longest wait for a reply [s].
    max_levels
        Intensities never exceeded, by channel; where none is given it is `top_level`.
    """

    name: str
    port: str
    baud: int | None = None
    channels: int = 4
    top_level: int = 255
    dialect: str = "lan"
    template: Mapping[str, str | None] | None = None
    timeout_s: float = 1.0
    max_levels: Mapping[int, int] = field(default_factory=dict[int, int])


def all_off(
    controllers: Mapping[str, LightController], *, burning: Mapping[str, Collection[int]] | None = None
) -> None:
    """Darken every channel of every controller, each of them even if others fail; no controller waits for another.

    Parameters
    ----------
    controllers
        By their names in the rig file.
    burning
        Channels that are known to burn, by controller: they come first.

    Raises
    ------
    LightsStillOnError
        Once all were tried, with a message per controller and reason that names the channels that may still be lit.
    """
    first = burning or {}
    reasons = side_by_side(
        {
            name: lambda name=name, controller=controller: _darken_all(controller, first.get(name, ()))
            for name, controller in controllers.items()
        }
    )
    if any(reasons.values()):
        raise LightsStillOnError(
            *(
                f"controller {name}, channel{'s' if len(channels) > 1 else ''} {', '.join(map(str, channels))}: "
                f"not switched off, may still be lit: {reason}"
                for name, found in reasons.items()
                for reason, channels in _by_reason(found).items()
            ),
            channels={name: sorted(found) for name, found in reasons.items() if found},
        )


def _darken_all(controller: LightController, first: Collection[int]) -> dict[int, str]:
    """Switch every channel off, some of them first; why that failed, by channel."""
    channels = sorted(range(1, controller.channels + 1), key=lambda channel: channel not in first)
    reasons = {channel: _darken(controller, channel) for channel in channels}
    return {channel: reason for channel, reason in reasons.items() if reason is not None}


def _by_reason(found: Mapping[int, str]) -> dict[str, list[int]]:
    channels: dict[str, list[int]] = {}
    for channel in sorted(found):
        channels.setdefault(found[channel], []).append(channel)
    return channels


def _darken(controller: LightController, channel: int) -> str | None:
    """Switch a channel off; why that failed, or None.

    A driver asks again by itself where it knows how its device fails; any other exception is a reason to try again.
    """
    reason = None
    for _ in range(_ATTEMPTS):
        try:
            controller.set_level(channel, 0)
        except LightoptError as error:  # noqa: PERF203
            return error_text(error)
        except Exception as error:  # noqa: BLE001  (whatever fails here, the other lights must go dark)
            reason = error_text(error)
        else:
            return None
    return reason
