"""The hardware section of a rig file: devices behind camera, lights and stage, and whether they fit together."""

import re
import string
from collections.abc import Hashable, Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, Field, StringConstraints, ValidationInfo

from lightopt.config import _fields as fields
from lightopt.config._camera import CameraConfig, CameraDeviceConfig
from lightopt.config._fields import LIST, Complaint, Frozen, complaint, expecting
from lightopt.config._light import LightConfig
from lightopt.core.errors import did_you_mean

_Baud = Annotated[int, Field(ge=300, le=4000000), expecting("a baud rate, from 300 to 4000000")]
_Channel = Annotated[int, Field(ge=1, le=256), expecting("a channel number as on the device, from 1 to 256")]
_Level = Annotated[int, Field(ge=1, le=65535), expecting("a whole intensity of the controller, from 1")]
_MOST = {
    "ccs": {"channels": 64, "top_level": 9999},
    "sa": {"channels": 6, "top_level": 9999},
    "template": {"channels": 64},
}

# description of the ports of controllers and stages
_PORT = (
    "Serial port (/dev/serial/by-id/…, COM3), pyserial URL (socket://host:port, rfc2217://…), or virtual: "
    "simulated firmware on this computer."
)

_FIELDS = ("channel", "channel0", "letter", "level")
_WIDTH = re.compile(r"(0?[1-9]\d?)?d?")


def _bytes(text: str) -> str:
    for wide in (c for c in text if ord(c) > 255):
        raise complaint(f'"{wide}" is no single byte; expected characters up to \\xff')
    return text


def _escaped(text: str) -> str:
    if found := re.search(r"\\(?:[rnt0]|x[0-9a-fA-F]{2})", text):
        advice = "for the byte that they mean put the text in double quotes"
        raise complaint(f"the characters {found[0]} would be sent as they stand; {advice}")
    return text


def _filled_in(text: str) -> str:
    try:
        pieces = list(string.Formatter().parse(text))
    except ValueError as error:
        raise complaint(f"not a template: {error}; a brace that is meant is written twice") from None
    for _, name, form, conversion in pieces:
        if name is None:
            continue
        if name not in _FIELDS or conversion:
            there = ", ".join(f"{{{f}}}" for f in _FIELDS)
            raise complaint(f"no field {{{name}}}; there are {there}; a brace that is meant is written twice")
        if _WIDTH.fullmatch(form or "") is None or (form and name == "letter"):
            raise complaint(f"{{{name}:{form}}}: expected a width such as {{level:03d}}, or none")
    return text


def _has_level(text: str) -> bool:
    return any(name == "level" for _, name, _, _ in string.Formatter().parse(text))


def _compiled(text: str) -> str:
    try:
        re.compile(text.encode("latin-1"))
    except re.error as error:
        raise complaint(f"not a regular expression: {error}") from None
    return text


_LINE = Annotated[str, StringConstraints(min_length=1, max_length=200), AfterValidator(_bytes)]

Command = Annotated[_LINE, AfterValidator(_escaped), AfterValidator(_filled_in), expecting("the text of a command")]
Pattern = Annotated[_LINE, AfterValidator(_compiled), expecting("a regular expression")]
End = Annotated[_LINE, AfterValidator(_escaped), expecting("the bytes that end a reply")]


class TemplateConfig(Frozen):
    """Commands of a controller in its own words, for driver: template.

    Fields in braces are put in: {channel} counted from 1, {channel0} from 0, {letter} A, B, …; {level}, also with a
    width: {level:03d}. In double quotes the escapes for carriage return, line feed and other bytes are understood.
    """

    set: Annotated[Command, fields.that(_has_level, "the field {level} is missing: the command would set no intensity")]
    """Command that sets an intensity and lights the channel; has the field {level}."""
    set_reply: Pattern | None = None
    """Regular expression that the whole reply matches, without its end; none: there is no reply."""
    off: Command | None = None
    """Command that switches a channel off; `set` with level 0 if absent."""
    off_reply: Pattern | None = None
    """Regular expression of the reply to `off`; none: there is no reply."""
    read: Command | None = None
    """Command that queries the intensity, which is 0 when dark; none: it cannot be queried."""
    read_reply: Pattern | None = Field(default=None, validate_default=True)
    """Regular expression of the reply to `read`, with a group named level for the intensity: L1(?P<level>[0-9]+)."""
    end: End | None = None
    """Bytes that end a reply; silence ends it if absent."""

    @fields.rule("off_reply", "read_reply")
    def _of_its_command(cls, reply: str | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        command = str(info.field_name).removesuffix("_reply")
        if command not in info.data:
            return
        if info.data[command] is None:
            if reply is not None:
                yield f"there is no `{command}` that it could answer; add it, or leave this out"
        elif command == "read" and (reply is None or "level" not in re.compile(reply.encode("latin-1")).groupindex):
            yield "expected a regular expression with a group (?P<level>...) for the intensity"


DISPLAY_DRIVERS = ("screen", "command")
MOST_SQUARE = 1.05  # ratio of a screen pixel's sides that is taken for a rounded size_mm

_Side = Annotated[int, Field(ge=1, le=16384)]
_Arguments = Annotated[tuple[fields.Text, ...], Field(strict=False, min_length=1, max_length=50)]
_Monitor = Annotated[int, Field(ge=1, le=16), expecting("the number of a monitor, from 1 to 16")]
_WITH_FILE = fields.that(
    lambda words: any("{file}" in word for word in words),
    'no entry has the field {file}, the path of the picture; add "{file}"',
)
_Program = Annotated[_Arguments, _WITH_FILE, expecting('a program and arguments: [show, "{file}"]')]


class PictureConfig(Frozen):
    """The screen of a display, for driver: screen and driver: command."""

    resolution_px: Annotated[tuple[_Side, _Side], LIST, expecting("[width, height], whole numbers up to 16384")]
    """Width and height of the screen as the computer has it, whose visible area is the light's size_mm [pixels]."""
    gamma: Annotated[float, Field(ge=0.5, le=5), expecting("a number from 0.5 to 5")] = 2.2
    """Response of the screen: its radiance is (level / 255)^gamma of the full one."""
    turn_deg: Annotated[Literal[0, 90, 180, 270], expecting("0, 90, 180 or 270")] = 0
    """How the screen is mounted, seen from the part: where its own upper edge is, turned clockwise from above [deg]."""
    mirrored: bool = False
    """Whether the part sees the screen's left and right swapped, as in a mirror or on a screen lit from behind."""
    settle_ms: Annotated[float, Field(ge=0, le=1000), expecting("milliseconds, from 0 to 1000")] = 50.0
    """From showing a picture until it is on the screen [ms]; timing.light_ms is waited for in addition."""

    @property
    def seen_px(self) -> tuple[int, int]:
        """Columns and rows as seen from the part, along u and v."""
        width, height = self.resolution_px
        return (height, width) if self.turn_deg % 180 else (width, height)


class ControllerConfig(Frozen):
    """A light controller."""

    variants = fields.Variants(
        "driver",
        {
            "ccs": (("port",), ("baud", "dialect")),
            "sa": (("port",), ("baud",)),
            "template": (("port", "template"), ("baud",)),
            "screen": (("monitor", "picture"), ()),
            "command": (("command", "picture"), ()),
        },
        usual={"port": "virtual", "dialect": "lan"},
    )

    driver: Annotated[
        Literal["ccs", "sa", "template", "screen", "command"],
        expecting("screen or command for displays, ccs, sa or template, which suits devices of other makers"),
    ]
    """Protocol: ccs (@ frames), sa (SA0255# family), or template. A display, each channel of which is a picture: screen
    (a monitor of this computer), or command (a program that shows the picture)."""
    port: fields.Text | None = Field(default=None, description=f"{_PORT} Of a display: virtual, or absent.")
    baud: _Baud | None = None
    """Baud rate; the protocol's usual one if absent."""
    channels: _Channel = 4
    """Number of channels."""
    top_level: _Level = 255
    """Highest intensity of the controller."""
    dialect: Literal["lan", "serial"] = "lan"
    """ccs: frames without (lan) or with (serial) a unit number."""
    template: TemplateConfig | None = None
    """Commands, for driver: template."""
    monitor: _Monitor | None = None
    """screen: number of the monitor as the desktop counts them, from 1."""
    command: _Program | None = None
    """command: a program and its arguments, run in this file's folder; {file} is the path of the picture, a PNG."""
    picture: PictureConfig | None = None
    """screen, command: the screen that pictures are made for."""
    timeout_s: fields.Positive = 1.0
    """Longest wait for a reply, or for a command to end [s]."""

    @classmethod
    def misfits(cls, raw: Mapping[str, Any]) -> Iterator[Complaint]:
        """As of every configuration; a display with a virtual port needs neither monitor nor command."""
        for loc, error in super().misfits(raw):
            if isinstance(error, str) or loc not in (("monitor",), ("command",)) or raw.get("port") != "virtual":
                yield loc, error

    @fields.rule("channels", "top_level")
    def _sayable(cls, number: int, info: ValidationInfo) -> Iterator[fields.Fault]:
        driver = str(info.data.get("driver"))
        most = _MOST.get(driver, {}).get(str(info.field_name))
        if most is not None and number > most:
            yield f"expected at most {most}, the most that {driver} can express, found {number}"


class ChannelConfig(Frozen):
    """Where a light of the rig is plugged in, and at which level it is lit."""

    controller: fields.FileName
    """Name of the controller."""
    channel: _Channel
    """Channel, counted from 1 as on the device."""
    level: _Level
    """Intensity at which the light has the brightness that the rig describes."""
    max_level: _Level | None = None
    """Intensity never exceeded; the controller's highest if absent."""
    max_on_s: fields.Positive | None = None
    """Maximum time that the light may be on without a break [s]; no limit if absent."""


_Seconds = Annotated[float, Field(ge=0, le=600), expecting("seconds, from 0 to 600")]
_Milliseconds = Annotated[float, Field(ge=0, le=60000), expecting("milliseconds, from 0 to 60000")]
_AXES = {
    "shot": ("[12]", "1 or 2"),
    "gsc": ("[12]", "1 or 2"),
    "grbl": ("[XYZ]", "X, Y or Z"),
    "zaber": ("([1-9][0-9]?/)?[1-9]", "a number, or device/axis such as 2/1"),
}
_NOT_ZERO = fields.that(bool, "expected a number other than 0, found 0")


class AxisConfig(Frozen):
    """One axis of the stage."""

    axis: Annotated[fields.Text, expecting('text in quotes, the axis as the device calls it: "1", "X"')]
    """The axis as the device calls it: "1", "2", "X", "Y"."""
    steps_per_deg: Annotated[
        float, Field(ge=-1e7, le=1e7), _NOT_ZERO, expecting("a number other than 0, from -1e7 to 1e7")
    ] = 1.0
    """Device units per degree; negative if the device counts against the rig's direction."""
    zero: Annotated[float, Field(ge=-1e9, le=1e9), expecting("a number")] = 0.0
    """Device units at which the rig's angle is 0."""
    home_sense: Annotated[int, Field(ge=-1, le=1), _NOT_ZERO, expecting("1 or -1")] = -1
    """gsc: direction of the device's count in which it searches its origin, 1 or -1."""
    speed_deg_per_s: fields.Positive = 20.0
    """Speed that is set in the device [deg/s]."""


class StageDeviceConfig(Frozen):
    """The device that turns the part."""

    driver: Literal["shot", "gsc", "grbl", "zaber"]
    """Protocol: shot or gsc (SIGMA KOKI / OptoSigma), grbl, zaber."""
    port: fields.Text = Field(description=_PORT)
    baud: _Baud | None = None
    """Baud rate; the protocol's usual one if absent."""
    elevation: AxisConfig | None = None
    """The tilt axis; none: fixed at 0."""
    rotation: AxisConfig | None = Field(default=None, validate_default=True)
    """The rotary axis; none: fixed at 0."""
    timeout_s: fields.Positive = 1.0
    """Longest wait for a reply [s]."""
    home_timeout_s: fields.Positive = 180.0
    """Longest time that homing may take [s]."""
    assume_referenced: bool = False
    """Whether a stage that cannot report whether it was homed may be moved without homing first."""

    @fields.rule("elevation", "rotation")
    def _known(cls, axis: AxisConfig | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        driver = str(info.data.get("driver"))
        pattern, words = _AXES.get(driver, ("", ""))
        if axis is not None and words and re.fullmatch(pattern, axis.axis) is None:
            yield f'expected an axis of {driver}, {words}, found axis "{axis.axis}"'

    @fields.rule("rotation")
    def _two(cls, axis: AxisConfig | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        if "elevation" not in info.data:
            return
        tilt = info.data["elevation"]
        if axis is None and tilt is None:
            missing = 'missing key "elevation" or "rotation": an axis that the stage has'
            yield fields.absent(missing, "elevation", "rotation")
        if axis is not None and tilt is not None and axis.axis == tilt.axis:
            yield f'axis "{axis.axis}" is already that of elevation; two axes have two names'


class TimingConfig(Frozen):
    """Waiting times before an exposure."""

    light_ms: _Milliseconds = 100.0
    """From light on to the exposure [ms]."""
    stage_ms: _Milliseconds = 200.0
    """From the end of a move to the exposure [ms]."""
    discard_frames: Annotated[int, Field(ge=0, le=20), expecting("a whole number from 0 to 20")] = 1
    """Frames discarded after a change, if the camera has no software trigger."""
    frame_timeout_s: _Seconds = 5.0
    """Longest wait for a frame beyond its exposure [s]."""


class HardwareConfig(Frozen):
    """The devices of a rig."""

    controllers: dict[fields.FileName, ControllerConfig]
    """The light controllers by name."""
    lights: dict[fields.FileName, ChannelConfig]
    """Controller and channel of each light of the rig."""
    stage: StageDeviceConfig | None = None
    """The stage; none: the part does not move."""
    camera: CameraDeviceConfig
    """The camera."""
    timing: TimingConfig = TimingConfig()
    """Waiting times."""


_REAL_CAMERAS = tuple({*get_args(CameraDeviceConfig.model_fields["driver"].annotation)} - {"virtual"})


def misfits(
    hardware: object, lights: tuple[LightConfig, ...] | None, camera: CameraConfig | None
) -> Iterator[Complaint]:
    """What does not fit together, by the path under ``hardware``; None and parts that are wrong are passed over."""
    section = fields.mapping(hardware)
    controllers, channels, stage, device = (
        fields.mapping(section.get(key)) for key in ("controllers", "lights", "stage", "camera")
    )
    if lights is not None and isinstance(section.get("lights"), Mapping):
        yield from _names(channels, [light.name for light in lights])
        yield from _display_misfits(controllers, channels, lights)
    if isinstance(section.get("controllers"), Mapping):
        for name, channel in channels.items():
            yield from _plug(name, fields.mapping(channel), controllers)
        yield from _same("channel", {("lights", name): (entry, _place(entry)) for name, entry in channels.items()})
    devices = {("controllers", name): entry for name, entry in controllers.items()} | {("stage",): stage}
    for key, of in (("port", _port), ("monitor", _monitor)):
        yield from _same(key, {path: (entry, of(entry)) for path, entry in devices.items()})
    if camera is not None and camera.exposure_us is None and device.get("driver") in _REAL_CAMERAS:
        yield ("camera",), "the rig's camera has no exposure_us; add the exposure time [µs] that counts as exposure 1"


def _display_misfits(
    controllers: Mapping[str, object], channels: Mapping[str, object], lights: Sequence[LightConfig]
) -> Iterator[Complaint]:
    """Lights that a display cannot show, and pixels of screens that are not square."""
    known = {light.name: light for light in lights}
    shown: dict[str, LightConfig] = {}
    for name, entry in channels.items():
        controller, light = fields.mapping(entry).get("controller"), known.get(name)
        if light is None or not isinstance(controller, str):
            continue
        config = fields.mapping(controllers.get(controller))
        if config.get("driver") not in DISPLAY_DRIVERS:
            continue
        where = ("lights", name, "controller")
        if light.kind != "display":
            yield where, f"{controller} is a display, and this light is a {light.kind}"
        elif shown.setdefault(controller, light).entry != light.entry:
            yield where, f"{controller} is the display {shown[controller].entry_name}; each display needs its own"
    for controller, light in shown.items():
        picture = fields.mapping(fields.mapping(controllers[controller]).get("picture"))
        width, height = (light.size_mm or (1.0, 1.0))[:: -1 if picture.get("turn_deg") in (90, 270) else 1]
        pixels = fields.entries(picture.get("resolution_px"))
        if len(pixels) != 2 or not all(isinstance(one, int) and one > 0 for one in pixels):
            continue
        sides = width / pixels[0], height / pixels[1]  # type: ignore[operator]
        if max(sides) > MOST_SQUARE * min(sides):
            pixel = f"{sides[0]:.4g} × {sides[1]:.4g} mm; expected square: correct this, turn_deg, or the size_mm"
            reason = f"on the {width:g} × {height:g} mm of {light.entry_name} a pixel would have {pixel}"
            yield ("controllers", controller, "picture", "resolution_px"), reason


def _names(channels: Mapping[str, object], lights: Sequence[str]) -> Iterator[Complaint]:
    for name in lights:
        if name not in channels:
            entry = f"{name}: {{controller: ..., channel: ..., level: ...}}"
            yield ("lights",), f'the light "{name}" of the rig has no channel; add {entry}'
    for name in channels:
        if name not in lights:
            meant = did_you_mean(name, lights) or f"; its lights are {', '.join(lights)}"
            yield ("lights", name), f'the rig has no light "{name}"{meant}'


def _plug(name: str, channel: Mapping[str, object], controllers: Mapping[str, object]) -> Iterator[Complaint]:
    number, level, most = (_whole(channel.get(key)) for key in ("channel", "level", "max_level"))
    if level is not None and most is not None and level > most:
        yield ("lights", name, "level"), f"expected at most max_level, {most}, found {level}"
    wanted = channel.get("controller")
    if not isinstance(wanted, str):
        return
    if wanted not in controllers:
        there = ", ".join(controllers) or "none"
        yield ("lights", name, "controller"), f'no controller is called "{wanted}"; there is {there}'
        return
    controller = fields.mapping(controllers[wanted])
    limited = (("channel", number, "channels"), ("level", level, "top_level"), ("max_level", most, "top_level"))
    for key, value, limit in limited:
        highest = _whole(controller.get(limit, ControllerConfig.model_fields[limit].default))
        if value is not None and highest is not None and value > highest:
            yield ("lights", name, key), f"expected at most {highest}, the {limit} of {wanted}, found {value}"


def _same(key: str, places: Mapping[tuple[str, ...], tuple[object, Hashable | None]]) -> Iterator[Complaint]:
    """Complaints about what has the same port, monitor or channel as something before it."""
    paths = list(places)
    for i, first in fields.repeated(what for _, what in places.values()):
        found = fields.mapping(places[paths[i]][0])[key]
        yield (*paths[i], key), f'{key} "{found}" is already that of {".".join(paths[first])}; each has its own'


def _place(entry: object) -> tuple[str, int] | None:
    controller, number = fields.mapping(entry).get("controller"), _whole(fields.mapping(entry).get("channel"))
    return (controller, number) if isinstance(controller, str) and number is not None else None


def _port(entry: object) -> str | None:
    # the same for names of the same port; None where it is none, or virtual
    port = fields.mapping(entry).get("port")
    if not isinstance(port, str) or port == "virtual":
        return None
    return port.upper() if re.fullmatch(r"COM\d+", port, re.IGNORECASE) else port


def _monitor(entry: object) -> int | None:
    return _whole(fields.mapping(entry).get("monitor"))


def _whole(value: object) -> int | None:
    return value if type(value) is int else None
