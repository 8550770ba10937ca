"""The hardware section of a rig file: devices behind camera, lights and stage, and whether they fit together."""

import re
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Annotated, Literal, get_args

from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from lightopt.config._camera import CameraConfig, CameraDeviceConfig
from lightopt.config._fields import (
    Complaint,
    FileName,
    Frozen,
    Positive,
    Text,
    absent,
    complaint,
    expecting,
    mapping,
    repeated,
)
from lightopt.config._light_controllers import PORT, Baud, ChannelConfig, ControllerConfig

_Seconds = Annotated[float, Field(ge=0, le=600), expecting("seconds, from 0 to 600")]
_Milliseconds = Annotated[float, Field(ge=0, le=60000), expecting("milliseconds, from 0 to 60000")]
_AXES = {
    "shot": ("[12]", "1 or 2"),
    "gsc": ("[12]", "1 or 2"),
    "grbl": ("[XYZ]", "X, Y or Z"),
    "zaber": ("([1-9][0-9]?/)?[1-9]", "a number, or device/axis such as 2/1"),
}


def _not_zero(number: float) -> float:
    if number == 0:
        raise complaint("expected a number other than 0, found 0")
    return number


class AxisConfig(Frozen):
    """One axis of the stage."""

    axis: Annotated[Text, expecting('text in quotes, the axis as the device calls it: "1", "X"')] = Field(
        description='The axis as the device calls it: "1", "2", "X", "Y".'
    )
    steps_per_deg: Annotated[
        float, Field(ge=-1e7, le=1e7), AfterValidator(_not_zero), expecting("a number other than 0, from -1e7 to 1e7")
    ] = Field(
        default=1.0, description="Device units per degree; negative where the device counts against the rig's sense."
    )
    zero: Annotated[float, Field(ge=-1e9, le=1e9), expecting("a number")] = Field(
        default=0.0, description="Device units at which the rig's angle is 0."
    )
    home_sense: Annotated[int, Field(ge=-1, le=1), AfterValidator(_not_zero), expecting("1 or -1")] = Field(
        default=-1,
        description="Sense of the device's count in which it seeks its origin, 1 or -1; for gsc, which must be told.",
    )
    speed_deg_per_s: Positive = Field(default=20.0, description="Speed that the device is set to [deg/s].")


class StageDeviceConfig(Frozen):
    """The device that turns the part."""

    driver: Annotated[Literal["shot", "gsc", "grbl", "zaber"], expecting("shot, gsc, grbl or zaber")] = Field(
        description="Protocol: shot or gsc (SIGMA KOKI / OptoSigma), grbl, zaber."
    )
    port: Text = Field(description=PORT)
    baud: Baud | None = Field(default=None, description="Baud rate; the protocol's usual one if absent.")
    elevation: AxisConfig | None = Field(default=None, description="The tilt axis; none: fixed at 0.")
    rotation: AxisConfig | None = Field(
        default=None, description="The rotary axis; none: fixed at 0.", validate_default=True
    )
    timeout_s: Positive = Field(default=1.0, description="Longest wait for a reply [s].")
    home_timeout_s: Positive = Field(default=180.0, description="Longest time that homing may take [s].")
    assume_referenced: bool = Field(
        default=False,
        description="Whether a stage that cannot report whether it was homed is moved without homing it first.",
    )

    @field_validator("elevation", "rotation")
    @classmethod
    def _known(cls, axis: AxisConfig | None, info: ValidationInfo) -> AxisConfig | None:
        driver = str(info.data.get("driver"))
        pattern, words = _AXES.get(driver, ("", ""))
        if axis is not None and words and re.fullmatch(pattern, axis.axis) is None:
            raise complaint(f'expected an axis of {driver}, {words}, found axis "{axis.axis}"')
        return axis

    @field_validator("rotation")
    @classmethod
    def _two(cls, axis: AxisConfig | None, info: ValidationInfo) -> AxisConfig | None:
        if "elevation" not in info.data:
            return axis
        tilt = info.data["elevation"]
        if axis is None and tilt is None:
            raise absent('missing key "elevation" or "rotation": an axis that the stage has', "elevation", "rotation")
        if axis is not None and tilt is not None and axis.axis == tilt.axis:
            raise complaint(f'axis "{axis.axis}" is already that of elevation; two axes have two names')
        return axis


class TimingConfig(Frozen):
    """What is waited for before an exposure."""

    light_ms: _Milliseconds = Field(default=100.0, description="From light on to the exposure [ms].")
    stage_ms: _Milliseconds = Field(default=200.0, description="From the end of a move to the exposure [ms].")
    discard_frames: Annotated[int, Field(ge=0, le=20), expecting("a whole number from 0 to 20")] = Field(
        default=1, description="Frames thrown away after a change, by a camera that has no software trigger."
    )
    frame_timeout_s: _Seconds = Field(default=5.0, description="Longest wait for a frame beyond its exposure [s].")


class HardwareConfig(Frozen):
    """The devices of a rig."""

    controllers: dict[FileName, ControllerConfig] = Field(description="The light controllers by name.")
    lights: dict[FileName, ChannelConfig] = Field(description="Where each light of the rig is plugged in.")
    stage: StageDeviceConfig | None = Field(default=None, description="The stage; none: the part stands still.")
    camera: CameraDeviceConfig = Field(description="The camera.")
    timing: TimingConfig = Field(default=TimingConfig(), description="What is waited for.")


_REAL_CAMERAS = {*get_args(CameraDeviceConfig.model_fields["driver"].annotation)} - {"virtual"}


def misfits(hardware: object, lights: tuple[str, ...] | None, camera: CameraConfig | None) -> Iterator[Complaint]:
    """What does not fit together, by the path under ``hardware``; parts that are wrong themselves are passed over.

    hardware: The section as it was read
    lights: Names of the rig's lights; None where they are wrong themselves
    camera: The rig's camera; None where it is wrong itself
    """
    section = mapping(hardware)
    controllers, channels = (mapping(section.get(key)) for key in ("controllers", "lights"))
    if lights is not None and isinstance(section.get("lights"), Mapping):
        yield from _names(channels, lights)
    if isinstance(section.get("controllers"), Mapping):
        for name, channel in channels.items():
            yield from _plug(name, mapping(channel), controllers)
        yield from _shared(channels)
    yield from _same_port(controllers, mapping(section.get("stage")))
    device = mapping(section.get("camera"))
    if camera is not None and camera.exposure_us is None and device.get("driver") in _REAL_CAMERAS:
        reason = (
            "the rig's camera has no exposure_us; add to its section the exposure time [µs] that counts as exposure 1"
        )
        yield ("camera",), device, complaint(reason)


def _names(channels: Mapping[str, object], lights: tuple[str, ...]) -> Iterator[Complaint]:
    for name in lights:
        if name not in channels:
            entry = f"{name}: {{controller: ..., channel: ..., level: ...}}"
            reason = f'the light "{name}" of the rig has no channel; add {entry}'
            yield ("lights",), dict(channels), complaint(reason)
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
        yield (("lights", name, "level"), level, complaint(f"expected at most max_level, {most}, found {level}"))
    if not isinstance(wanted, str):
        return
    if wanted not in controllers:
        there = ", ".join(controllers) or "none"
        reason = f'no controller is called "{wanted}"; there is {there}'
        yield ("lights", name, "controller"), wanted, complaint(reason)
        return
    controller = mapping(controllers[wanted])
    defaults = ControllerConfig.model_fields
    count = _whole(controller.get("channels", defaults["channels"].default))
    if count is not None and number is not None and number > count:
        reason = f"expected a channel from 1 to {count}, which {wanted} has, found {number}"
        yield ("lights", name, "channel"), number, complaint(reason)
    top = _whole(controller.get("top_level", defaults["top_level"].default))
    for key, value in (("level", level), ("max_level", most)):
        if top is not None and value is not None and value > top:
            reason = f"expected at most {top}, the top_level of {wanted}, found {value}"
            yield ("lights", name, key), value, complaint(reason)


def _shared(channels: Mapping[str, object]) -> Iterator[Complaint]:
    """Lights on the channel of another light."""
    names = list(channels)
    places: list[tuple[str, int] | None] = []
    for entry in channels.values():
        controller, number = mapping(entry).get("controller"), _whole(mapping(entry).get("channel"))
        places.append((controller, number) if isinstance(controller, str) and number is not None else None)
    for i, first in repeated(places):
        controller, number = places[i] or ("", 0)
        reason = f'channel {number} of {controller} is already that of light "{names[first]}"'
        yield ("lights", names[i], "channel"), number, complaint(reason)


def _same_port(controllers: Mapping[str, object], stage: Mapping[str, object]) -> Iterator[Complaint]:
    """Devices at the port of another device."""
    paths: list[tuple[str, ...]] = [*(("controllers", name) for name in controllers), ("stage",)]
    ports = [mapping(entry).get("port") for entry in (*controllers.values(), stage)]
    for i, first in repeated(map(_port_key, ports)):
        reason = f'port "{ports[i]}" is already that of {".".join(paths[first])}; each device has its own'
        yield (*paths[i], "port"), ports[i], complaint(reason)


def _port_key(port: object) -> str | None:
    """The same for names of the same port; None where it is none, or virtual."""
    if not isinstance(port, str) or port == "virtual":
        return None
    return port.upper() if re.fullmatch(r"COM\d+", port, re.IGNORECASE) else port


def _whole(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) else None
