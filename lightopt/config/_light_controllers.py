"""Light controllers in a rig file: protocol, port, channels, and commands of controllers that have no driver."""

import re
import string
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, StringConstraints, ValidationInfo, field_validator

from lightopt.config._fields import FileName, Frozen, Positive, Text, complaint, expecting, only_of_driver

Baud = Annotated[int, Field(ge=300, le=4000000), expecting("a baud rate, from 300 to 4000000")]
_Channel = Annotated[int, Field(ge=1, le=64), expecting("a channel number as on the device, from 1 to 64")]
_Level = Annotated[int, Field(ge=1, le=65535), expecting("a whole intensity of the controller, from 1")]
_MOST = {"ccs": {"top_level": 9999}, "sa": {"channels": 6, "top_level": 9999}}

# description of the ports of controllers and stages
PORT = (
    "Serial port (/dev/serial/by-id/…, COM3), pyserial URL (socket://host:port, rfc2217://…), or virtual: "
    "simulated firmware on this computer."
)

FIELDS = ("channel", "channel0", "letter", "level")
_WIDTH = re.compile(r"(0?[1-9]\d?)?d?")


def _bytes(text: str) -> str:
    wide = next((c for c in text if ord(c) > 255), None)
    if wide is not None:
        raise complaint(f'"{wide}" is no single byte; expected characters up to \\xff')
    return text


def _escaped(text: str) -> str:
    found = re.search(r"\\(?:[rnt0]|x[0-9a-fA-F]{2})", text)
    if found is not None:
        raise complaint(
            f"the characters {found[0]} would be sent as they stand; for the byte that they mean put the text in "
            "double quotes"
        )
    return text


def _filled_in(text: str) -> str:
    try:
        pieces = list(string.Formatter().parse(text))
    except ValueError as error:
        raise complaint(f"not a template: {error}; a brace that is meant is written twice") from None
    for _, name, form, conversion in pieces:
        if name is None:
            continue
        if name not in FIELDS or conversion:
            raise complaint(
                f"no field {{{name}}}; there are {', '.join(f'{{{f}}}' for f in FIELDS)}; a brace that is meant is "
                "written twice"
            )
        if _WIDTH.fullmatch(form or "") is None or (form and name == "letter"):
            raise complaint(f"{{{name}:{form}}}: expected a width such as {{level:03d}}, or none")
    return text


def _needs_level(text: str) -> str:
    if not any(name == "level" for _, name, _, _ in string.Formatter().parse(text)):
        raise complaint("the field {level} is missing: the command would set no intensity")
    return text


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

    set: Annotated[Command, AfterValidator(_needs_level)] = Field(
        description="Command that sets an intensity and lights the channel; has the field {level}."
    )
    set_reply: Pattern | None = Field(
        default=None,
        description="Regular expression that the whole reply matches, without its end; none: there is no reply.",
    )
    off: Command | None = Field(default=None, description="Command that darkens; `set` with level 0 if absent.")
    off_reply: Pattern | None = Field(
        default=None, description="Regular expression of the reply to `off`; none: there is no reply."
    )
    read: Command | None = Field(
        default=None,
        description="Command that queries the intensity, which is 0 when dark; none: it cannot be queried.",
    )
    read_reply: Pattern | None = Field(
        default=None,
        description="Regular expression of the reply to `read`, with the digits of the intensity in a group named "
        "level: L1(?P<level>[0-9]+).",
        validate_default=True,
    )
    end: End | None = Field(default=None, description="Bytes that end a reply; silence ends it if absent.")

    @field_validator("off_reply", "read_reply")
    @classmethod
    def _of_its_command(cls, reply: str | None, info: ValidationInfo) -> str | None:
        command = str(info.field_name).removesuffix("_reply")
        if command not in info.data:
            return reply
        if info.data[command] is None:
            if reply is not None:
                raise complaint(f"there is no `{command}` that it could answer; add it, or leave this out")
        elif command == "read" and (reply is None or "level" not in re.compile(reply.encode("latin-1")).groupindex):
            raise complaint("expected a regular expression with a group (?P<level>...) for the intensity")
        return reply


class ControllerConfig(Frozen):
    """A light controller."""

    driver: Annotated[
        Literal["ccs", "sa", "template"], expecting("ccs, sa or template, which suits devices of other makers")
    ] = Field(description="Protocol: ccs (@ frames), sa (SA0255# family), or template.")
    port: Text = Field(description=PORT)
    baud: Baud | None = Field(default=None, description="Baud rate; the protocol's usual one if absent.")
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
            raise complaint(f"expected at most {most}, the most that {driver} can express, found {number}")
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
        return only_of_driver("template", template, info, missing=missing)


class ChannelConfig(Frozen):
    """Where a light of the rig is plugged in, and at which level it is lit."""

    controller: FileName = Field(description="Name of the controller.")
    channel: _Channel = Field(description="Channel, counted from 1 as on the device.")
    level: _Level = Field(description="Intensity at which the light has the brightness that the rig describes.")
    max_level: _Level | None = Field(
        default=None, description="Intensity never exceeded; the controller's highest if absent."
    )
    max_on_s: Positive | None = Field(
        default=None, description="Longest time that the light may be on at a stretch [s]; any if absent."
    )
