"""What a rig file says of the devices behind its camera, lights and stage."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from lightopt.config._fields import FileName, Frozen, Positive, Text, expecting

__all__ = [
    "AxisConfig",
    "CameraDeviceConfig",
    "ChannelConfig",
    "ControllerConfig",
    "HardwareConfig",
    "StageDeviceConfig",
    "TemplateConfig",
    "TimingConfig",
]

_Channel = Annotated[int, Field(ge=1, le=64), expecting("a channel number as on the device, from 1 to 64")]
_Level = Annotated[int, Field(ge=1, le=65535), expecting("a whole intensity of the controller, from 1")]
_Seconds = Annotated[float, Field(ge=0, le=600, allow_inf_nan=False), expecting("seconds, from 0 to 600")]
_Milliseconds = Annotated[
    float, Field(ge=0, le=60000, allow_inf_nan=False), expecting("milliseconds, from 0 to 60000")
]
_Baud = Annotated[int, Field(ge=300, le=4000000), expecting("a baud rate, from 300 to 4000000")]
_PORT = (
    "Serial port (/dev/serial/by-id/…, COM3), pyserial URL (socket://host:port, rfc2217://…), or virtual: "
    "simulated firmware on this computer."
)


class TemplateConfig(Frozen):
    """Commands of a controller in its own words, for driver: template.

    Fields in braces are put in: {channel} counted from 1, {channel0} from 0, {letter} A, B, …; {level}. Python's format
    specifications apply: {level:03d}. \\r, \\n and \\xNN in double quotes are bytes.
    """

    set: Text = Field(description="Command that sets an intensity and lights the channel.")
    set_reply: Text | None = Field(
        default=None, description="Regular expression that the whole reply matches; none: no reply."
    )
    off: Text | None = Field(default=None, description="Command that darkens; `set` with level 0 if absent.")
    off_reply: Text | None = Field(default=None, description="Regular expression of the reply to `off`.")
    read: Text | None = Field(default=None, description="Command that asks for the intensity.")
    read_reply: Text | None = Field(
        default=None, description="Regular expression of the reply to `read`, with a group named level."
    )
    end: Text | None = Field(default=None, description="Bytes that end a reply; silence ends it if absent.")


class ControllerConfig(Frozen):
    """A light controller."""

    driver: Annotated[Literal["ccs", "sa", "template"], expecting("ccs, sa or template")] = Field(
        description="Protocol: ccs (@ frames), sa (SA0255# family), or template."
    )
    port: Text = Field(description=_PORT)
    baud: _Baud | None = Field(default=None, description="Baud rate; the protocol's usual one if absent.")
    channels: _Channel = Field(default=4, description="Number of channels.")
    top_level: _Level = Field(default=255, description="Highest intensity of the controller.")
    dialect: Annotated[Literal["lan", "serial"], expecting("lan or serial")] = Field(
        default="lan", description="ccs: frames without (lan) or with (serial) a unit number."
    )
    template: TemplateConfig | None = Field(default=None, description="Commands, for driver: template.")
    timeout_s: Positive = Field(default=1.0, description="Longest wait for a reply [s].")


class ChannelConfig(Frozen):
    """Where a light of the rig is plugged in, and how bright it burns."""

    controller: FileName = Field(description="Name of the controller.")
    channel: _Channel = Field(description="Channel, counted from 1 as on the device.")
    level: _Level = Field(
        description="Intensity at which the light has the brightness that the rig describes."
    )
    max_level: _Level | None = Field(
        default=None, description="Intensity never exceeded; the controller's highest if absent."
    )
    max_on_s: Positive | None = Field(
        default=None, description="Longest time that the light may burn at a stretch [s]; any if absent."
    )


class AxisConfig(Frozen):
    """One axis of the stage."""

    axis: Text = Field(description="The axis as the device calls it: 1, 2, X, Y.")
    steps_per_deg: Annotated[
        float, Field(ge=-1e7, le=1e7, allow_inf_nan=False), expecting("a number other than 0")
    ] = Field(
        default=1.0,
        description="Device units per degree; negative where the device counts against the rig's sense.",
    )
    zero: Annotated[float, Field(ge=-1e9, le=1e9, allow_inf_nan=False), expecting("a number")] = Field(
        default=0.0, description="Device units at which the rig's angle is 0."
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
    rotation: AxisConfig | None = Field(default=None, description="The rotary axis; none: fixed at 0.")
    timeout_s: Positive = Field(default=1.0, description="Longest wait for a reply [s].")


class CameraDeviceConfig(Frozen):
    """The device that takes the images."""

    driver: Annotated[Literal["virtual", "folder"], expecting("virtual or folder")] = Field(
        default="virtual",
        description="virtual: frames rendered by the virtual bench; folder: frames replayed.",
    )
    folder: Text | None = Field(
        default=None, description="folder: an image set whose PNG files are replayed; relative to this file."
    )


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
