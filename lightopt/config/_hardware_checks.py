"""Whether the devices of a rig and the rest of its file fit together."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any, cast, get_args

from lightopt.config._camera import CameraConfig
from lightopt.config._fields import Complaint, complaint
from lightopt.config._hardware import CameraDeviceConfig

VIRTUAL = "virtual"
_REAL_CAMERAS = {*get_args(CameraDeviceConfig.model_fields["driver"].annotation)} - {VIRTUAL}
_CHANNELS = 4
_TOP_LEVEL = 255


def misfits(
    hardware: object, lights: tuple[str, ...] | None, camera: CameraConfig | None
) -> Iterator[Complaint]:
    """What does not fit together, by the path under ``hardware``; parts that are wrong themselves are passed over.

    hardware: The section as it was read
    lights: Names of the rig's lights; None where they are wrong themselves
    camera: The rig's camera; None where it is wrong itself
    """
    if not isinstance(hardware, Mapping):
        return
    section = cast("Mapping[str, object]", hardware)
    controllers, channels = _entries(section.get("controllers")), _entries(section.get("lights"))
    if lights is not None and channels is not None:
        yield from _names(channels, lights)
    if controllers is not None and channels is not None:
        for name, channel in channels.items():
            yield from _plug(name, _mapping(channel), controllers)
        yield from _shared(channels)
    yield from _same_port(controllers or {}, _mapping(section.get("stage")))
    device = _mapping(section.get("camera"))
    if camera is not None and camera.exposure_us is None and device.get("driver") in _REAL_CAMERAS:
        yield (
            ("camera",),
            device,
            complaint(
                "the rig's camera has no exposure_us; add to its section the exposure time [µs] that counts as "
                "exposure 1"
            ),
        )


def _names(channels: Mapping[str, object], lights: tuple[str, ...]) -> Iterator[Complaint]:
    for name in lights:
        if name not in channels:
            yield (
                ("lights",),
                dict(channels),
                complaint(
                    f'the light "{name}" of the rig has no channel; add {name}: {{controller: ..., channel: ..., '
                    "level: ...}"
                ),
            )
    for name, channel in channels.items():
        if name not in lights:
            near = get_close_matches(name, lights, n=1)
            meant = f'; did you mean "{near[0]}"?' if near else f"; its lights are {', '.join(lights)}"
            yield ("lights", name), channel, complaint(f'the rig has no light "{name}"{meant}')


def _plug(name: str, channel: Mapping[str, object], controllers: Mapping[str, object]) -> Iterator[Complaint]:
    """What is wrong with where one light is plugged in."""
    wanted, number = channel.get("controller"), _whole(channel.get("channel"))
    level, most = _whole(channel.get("level")), _whole(channel.get("max_level"))
    if level is not None and most is not None and level > most:
        yield (
            ("lights", name, "level"),
            level,
            complaint(f"expected at most max_level, {most}, found {level}"),
        )
    if not isinstance(wanted, str):
        return
    if wanted not in controllers:
        there = ", ".join(controllers) or "none"
        reason = f'no controller is called "{wanted}"; there is {there}'
        yield ("lights", name, "controller"), wanted, complaint(reason)
        return
    controller = _mapping(controllers[wanted])
    count = _whole(controller.get("channels", _CHANNELS))
    if count is not None and number is not None and number > count:
        reason = f"expected a channel from 1 to {count}, which {wanted} has, found {number}"
        yield ("lights", name, "channel"), number, complaint(reason)
    top = _whole(controller.get("top_level", _TOP_LEVEL))
    for key, value in (("level", level), ("max_level", most)):
        if top is not None and value is not None and value > top:
            reason = f"expected at most {top}, the top_level of {wanted}, found {value}"
            yield ("lights", name, key), value, complaint(reason)


def _shared(channels: Mapping[str, object]) -> Iterator[Complaint]:
    first: dict[tuple[object, object], str] = {}
    for name, entry in channels.items():
        channel = _mapping(entry)
        place = (channel.get("controller"), channel.get("channel"))
        if not isinstance(place[0], str) or _whole(place[1]) is None:
            continue
        if place in first:
            reason = f'channel {place[1]} of {place[0]} is already that of light "{first[place]}"'
            yield ("lights", name, "channel"), place[1], complaint(reason)
        first.setdefault(place, name)


def _same_port(controllers: Mapping[str, object], stage: Mapping[str, object]) -> Iterator[Complaint]:
    first: dict[str, str] = {}
    places = [(("controllers", name), _mapping(entry)) for name, entry in controllers.items()]
    for path, device in [*places, (("stage",), stage)]:
        port = device.get("port")
        if not isinstance(port, str) or port == VIRTUAL:
            continue
        known = port.upper() if re.fullmatch(r"COM\d+", port, re.IGNORECASE) else port
        if known in first:
            reason = f'port "{port}" is already that of {first[known]}; each device has its own'
            yield (*path, "port"), port, complaint(reason)
        first.setdefault(known, ".".join(path))


def _entries(value: object) -> dict[str, object] | None:
    return dict(cast("Mapping[str, object]", value)) if isinstance(value, Mapping) else None


def _mapping(value: object) -> Mapping[str, Any]:
    return cast("Mapping[str, Any]", value) if isinstance(value, Mapping) else {}


def _whole(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) else None
