"""What a rig file says of the devices behind its camera, lights and stage."""

from __future__ import annotations

import re
from typing import Annotated, Literal, TypeVar

from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from lightopt.config._fields import FileName, Frozen, Positive, Text, absent, complaint, expecting
from lightopt.config._template import Command, End, Pattern, needs_level, wrong_pair

Value = TypeVar("Value")

_Channel = Annotated[int, Field(ge=1, le=64), expecting("a channel number as on the device, from 1 to 64")]
_Level = Annotated[int, Field(ge=1, le=65535), expecting("a whole intensity of the controller, from 1")]
_Seconds = Annotated[float, Field(ge=0, le=600, allow_inf_nan=False), expecting("seconds, from 0 to 600")]
_Milliseconds = Annotated[
    float, Field(ge=0, le=60000, allow_inf_nan=False), expecting("milliseconds, from 0 to 60000")
]
_Baud = Annotated[int, Field(ge=300, le=4000000), expecting("a baud rate, from 300 to 4000000")]
_Offset = Annotated[int, Field(ge=0, le=65535), expecting("pixels, from 0 to 65535")]
_MOST = {"ccs": {"top_level": 9999}, "sa": {"channels": 6, "top_level": 9999}}
_AXES = {
    "shot": ("[12]", "1 or 2"),
    "gsc": ("[12]", "1 or 2"),
    "grbl": ("[XYZ]", "X, Y or Z"),
    "zaber": ("([1-9][0-9]?/)?[1-9]", "a number, or device/axis such as 2/1"),
}
_PORT = (
    "Serial port (/dev/serial/by-id/…, COM3), pyserial URL (socket://host:port, rfc2217://…), or virtual: "
    "simulated firmware on this computer."
)


def _only_of(
    owner: str, value: Value, info: ValidationInfo, *, what: str = "one", missing: str | None = None
) -> Value:
    """A value that only one driver has, and which that driver needs where there is a message for its absence."""
    driver = info.data.get("driver")
    if driver == owner and value is None and missing is not None:
        raise absent(missing, str(info.field_name))
    if driver not in (None, owner) and value is not None:
        raise complaint(f"only driver: {owner} has {what}, and the driver is {driver}; leave this out")
    return value


class TemplateConfig(Frozen):
    """Commands of a controller in its own words, for driver: template.

    Fields in braces are put in: {channel} counted from 1, {channel0} from 0, {letter} A, B, …; {level}, also with a
    width: {level:03d}. In double quotes the escapes for carriage return, line feed and other bytes are understood.
    """

    set: Annotated[Command, AfterValidator(needs_level)] = Field(
        description="Command that sets an intensity and lights the channel; has the field {level}."
    )
    set_reply: Pattern | None = Field(
        default=None,
        description="Regular expression that the whole reply matches, without its end; none: there is no reply.",
    )
    off: Command | None = Field(
        default=None, description="Command that darkens; `set` with level 0 if absent."
    )
    off_reply: Pattern | None = Field(
        default=None, description="Regular expression of the reply to `off`; none: there is no reply."
    )
    read: Command | None = Field(
        default=None,
        description="Command that asks for the intensity, which is 0 when dark; none: it cannot be asked.",
    )
    read_reply: Pattern | None = Field(
        default=None,
        description="Regular expression of the reply to `read`, with the digits of the intensity in a group named "
        "level: L1(?P<level>[0-9]+).",
        validate_default=True,
    )
    end: End | None = Field(default=None, description="Bytes that end a reply; silence ends it if absent.")

    @field_validator("off_reply")
    @classmethod
    def _of_off(cls, reply: str | None, info: ValidationInfo) -> str | None:
        if reply is not None and "off" in info.data and info.data["off"] is None:
            raise complaint("there is no `off` that it could answer; add it, or leave this out")
        return reply

    @field_validator("read_reply")
    @classmethod
    def _of_read(cls, reply: str | None, info: ValidationInfo) -> str | None:
        if "read" in info.data:
            wrong_pair(info.data["read"], reply)
        return reply


class ControllerConfig(Frozen):
    """A light controller."""

    driver: Annotated[
        Literal["ccs", "sa", "template"],
        expecting("ccs, sa or template, which suits devices of other makers"),
    ] = Field(description="Protocol: ccs (@ frames), sa (SA0255# family), or template.")
    port: Text = Field(description=_PORT)
    baud: _Baud | None = Field(default=None, description="Baud rate; the protocol's usual one if absent.")
    channels: _Channel = Field(default=4, description="Number of channels.")
    top_level: _Level = Field(default=255, description="Highest intensity of the controller.")
    dialect: Annotated[Literal["lan", "serial"], expecting("lan or serial")] = Field(
        default="lan", description="ccs: frames without (lan) or with (serial) a unit number."
    )
    template: TemplateConfig | None = Field(
        default=None, description="Commands, for driver: template.", validate_default=True
    )
    timeout_s: Positive = Field(default=1.0, description="Longest wait for a reply [s].")

    @field_validator("channels", "top_level")
    @classmethod
    def _sayable(cls, number: int, info: ValidationInfo) -> int:
        driver = info.data.get("driver")
        most = _MOST.get(str(driver), {}).get(str(info.field_name))
        if most is not None and number > most:
            raise complaint(f"expected at most {most}, which is all that {driver} can say, found {number}")
        return number

    @field_validator("dialect")
    @classmethod
    def _of_ccs(cls, dialect: str, info: ValidationInfo) -> str:
        if dialect != "lan" and info.data.get("driver") not in (None, "ccs"):
            raise complaint(f"only ccs has dialects, and the driver is {info.data['driver']}; leave this out")
        return dialect

    @field_validator("template")
    @classmethod
    def _of_template(cls, template: TemplateConfig | None, info: ValidationInfo) -> TemplateConfig | None:
        missing = 'missing key "template": commands and replies, for driver: template'
        return _only_of("template", template, info, missing=missing)


class ChannelConfig(Frozen):
    """Where a light of the rig is plugged in, and at which level it is lit."""

    controller: FileName = Field(description="Name of the controller.")
    channel: _Channel = Field(description="Channel, counted from 1 as on the device.")
    level: _Level = Field(
        description="Intensity at which the light has the brightness that the rig describes."
    )
    max_level: _Level | None = Field(
        default=None, description="Intensity never exceeded; the controller's highest if absent."
    )
    max_on_s: Positive | None = Field(
        default=None, description="Longest time that the light may be on at a stretch [s]; any if absent."
    )


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
        float,
        Field(ge=-1e7, le=1e7, allow_inf_nan=False),
        AfterValidator(_not_zero),
        expecting("a number other than 0, from -1e7 to 1e7"),
    ] = Field(
        default=1.0,
        description="Device units per degree; negative where the device counts against the rig's sense.",
    )
    zero: Annotated[float, Field(ge=-1e9, le=1e9, allow_inf_nan=False), expecting("a number")] = Field(
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
    port: Text = Field(description=_PORT)
    baud: _Baud | None = Field(default=None, description="Baud rate; the protocol's usual one if absent.")
    elevation: AxisConfig | None = Field(default=None, description="The tilt axis; none: fixed at 0.")
    rotation: AxisConfig | None = Field(
        default=None, description="The rotary axis; none: fixed at 0.", validate_default=True
    )
    timeout_s: Positive = Field(default=1.0, description="Longest wait for a reply [s].")
    home_timeout_s: Positive = Field(default=180.0, description="Longest time that homing may take [s].")
    assume_referenced: bool = Field(
        default=False,
        description="Whether a stage that cannot say whether it was homed is moved without --home.",
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
            raise absent(
                'missing key "elevation" or "rotation": an axis that the stage has', "elevation", "rotation"
            )
        if axis is not None and tilt is not None and axis.axis == tilt.axis:
            raise complaint(f'axis "{axis.axis}" is already that of elevation; two axes have two names')
        return axis


class CameraDeviceConfig(Frozen):
    """The device that takes the images."""

    driver: Annotated[
        Literal["virtual", "folder", "aravis", "genicam"], expecting("virtual, folder, aravis or genicam")
    ] = Field(
        default="virtual",
        description="virtual: frames rendered by the virtual bench; folder: frames replayed; aravis: GigE Vision and "
        "USB3 Vision cameras; genicam: any camera, through its maker's GenTL producer.",
    )
    folder: Text | None = Field(
        default=None,
        description="folder: an image set whose PNG files are replayed; relative to this file.",
        validate_default=True,
    )
    port: Text | None = Field(
        default=None,
        description="aravis, genicam: serial number, address or identifier of the camera, in quotes, as lightopt bench "
        "devices lists it; the only camera that there is if absent. aravis: virtual is a GigE Vision camera simulated "
        "on this computer.",
    )
    producer: Text | None = Field(
        default=None,
        description="genicam: the maker's GenTL producer, a .cti file; relative to this file.",
        validate_default=True,
    )
    pixel_format: Text | None = Field(
        default=None,
        description="aravis, genicam: pixel format, such as Mono12p; one that has the sensor's bit_depth if absent.",
    )
    offset_px: (
        Annotated[
            tuple[_Offset, _Offset],
            Field(strict=False),
            expecting("two whole numbers of pixels, [left, top]"),
        ]
        | None
    ) = Field(
        default=None,
        description="aravis, genicam: where the image begins on the sensor, from the left and from the top [pixels]; "
        "centred if absent.",
    )
    gain: Annotated[float, Field(ge=-100, le=1000, allow_inf_nan=False), expecting("a gain")] | None = Field(
        default=None,
        description="aravis, genicam: gain in the camera's own units, mostly dB; as the camera has it if absent.",
    )
    trigger: Annotated[Literal["auto", "software", "none"], expecting("auto, software or none")] = Field(
        default="auto",
        description="aravis, genicam: software: each frame is triggered; none: the camera runs freely and "
        "timing.discard_frames are thrown away after each change; auto: software where the camera has it.",
    )
    fixed_exposure_us: Positive | None = Field(
        default=None, description="aravis, genicam: exposure time [us] of a camera that cannot be told one."
    )
    packet_size: Annotated[int, Field(ge=576, le=65535), expecting("bytes, from 576 to 65535")] | None = (
        Field(
            default=None,
            description="aravis: size of a camera's packets on the network [bytes]; as it is if absent.",
        )
    )
    packet_delay_ns: (
        Annotated[int, Field(ge=0, le=1000000000), expecting("nanoseconds, from 0 to 1000000000")] | None
    ) = Field(default=None, description="aravis: pause between a camera's packets [ns]; as it is if absent.")

    @field_validator("folder")
    @classmethod
    def _of_folder(cls, folder: str | None, info: ValidationInfo) -> str | None:
        missing = 'missing key "folder": an image set to replay, for driver: folder'
        return _only_of("folder", folder, info, missing=missing)

    @field_validator("producer")
    @classmethod
    def _of_genicam(cls, producer: str | None, info: ValidationInfo) -> str | None:
        missing = 'missing key "producer": the .cti file of the camera\'s maker, for driver: genicam'
        return _only_of("genicam", producer, info, missing=missing)

    @field_validator("packet_size", "packet_delay_ns")
    @classmethod
    def _of_aravis(cls, value: int | None, info: ValidationInfo) -> int | None:
        return _only_of("aravis", value, info, what="this")

    @field_validator("port", "pixel_format", "offset_px", "gain", "trigger", "fixed_exposure_us")
    @classmethod
    def _of_machine_cameras(cls, value: object, info: ValidationInfo) -> object:
        driver = info.data.get("driver")
        if driver in ("virtual", "folder") and value not in (None, "auto"):
            raise complaint(
                f"only driver: aravis and driver: genicam have this, and the driver is {driver}; leave this out"
            )
        return value

    @field_validator("port")
    @classmethod
    def _simulated(cls, port: str | None, info: ValidationInfo) -> str | None:
        if port == "virtual" and info.data.get("driver") == "genicam":
            raise complaint("only driver: aravis has a simulated camera (or driver: virtual)")
        return port


class TimingConfig(Frozen):
    """What is waited for before an exposure."""

    light_ms: _Milliseconds = Field(default=100.0, description="From light on to the exposure [ms].")
    stage_ms: _Milliseconds = Field(default=200.0, description="From the end of a move to the exposure [ms].")
    discard_frames: Annotated[int, Field(ge=0, le=20), expecting("a whole number from 0 to 20")] = Field(
        default=1, description="Frames thrown away after a change, by a camera that has no software trigger."
    )
    frame_timeout_s: _Seconds = Field(
        default=5.0, description="Longest wait for a frame beyond its exposure [s]."
    )


class HardwareConfig(Frozen):
    """The devices of a rig."""

    controllers: dict[FileName, ControllerConfig] = Field(description="The light controllers by name.")
    lights: dict[FileName, ChannelConfig] = Field(description="Where each light of the rig is plugged in.")
    stage: StageDeviceConfig | None = Field(
        default=None, description="The stage; none: the part stands still."
    )
    camera: CameraDeviceConfig = Field(description="The camera.")
    timing: TimingConfig = Field(default=TimingConfig(), description="What is waited for.")
