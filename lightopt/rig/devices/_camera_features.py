"""Setting a camera's features so that its levels measure light, and the levels in the bytes of a frame.

What is set is read back. Names and layouts of pixel formats are those of the GenICam Pixel Format Naming Convention
(PFNC 2.4) and, for the formats that end in ``Packed``, of GigE Vision 1.2, which came before it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import UInt8
from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices._camera_sdk import CameraSdk, CameraSettings

Levels = UInt8 | NDArray[np.uint16]


@dataclass(frozen=True, kw_only=True)
class PixelFormat:
    name: str
    code: int  # number in the naming convention
    bits: int  # of a level
    stored: int  # bits that a pixel takes in the frame
    unpack: Callable[[UInt8, int], Levels]  # levels of n pixels from the frame's bytes

    def size(self, pixels: int) -> int:
        return -(-pixels * self.stored // 8)


def levels_of(data: UInt8, pixel_format: PixelFormat, *, width: int, height: int) -> Levels:
    """Right-aligned levels (H, W) of a frame's bytes, uint8 up to 8 bits and uint16 above; padding is ignored."""
    pixels = width * height
    needed = pixel_format.size(pixels)
    if len(data) < needed:
        frame = f"a frame of {width} × {height} pixels in {pixel_format.name}"
        raise HardwareError(f"{frame} takes {needed} bytes, and the camera delivered {len(data)}")
    return pixel_format.unpack(data[:needed], pixels).reshape(height, width)


def choose_format(available: Sequence[str], *, bit_depth: int, wanted: str | None, where: str) -> PixelFormat:
    """Pixel format of a bit depth: `wanted` by the rig file, else the first that the camera has, unpacked first."""
    has = f"it has {', '.join(available) or 'none'}"
    if wanted is not None:
        found = PIXEL_FORMATS.get(wanted)
        if wanted not in available:
            raise InputError(f"{where}: no pixel format {wanted}; {has}")
        if found is None:
            raise InputError(f"{where}: {wanted} is no format of grey levels; choose of {', '.join(PIXEL_FORMATS)}")
        if found.bits != bit_depth:
            both = f"{wanted} has {found.bits} bits and the rig's sensor has bit_depth {bit_depth}"
            raise InputError(f"{where}: {both}; change pixel_format or bit_depth")
        return found
    for name, found in PIXEL_FORMATS.items():
        if name in available and found.bits == bit_depth:
            return found
    grey = [name for name in available if name in PIXEL_FORMATS]
    if not grey:
        advice = "colours are no measure of light: use the monochrome model"
        raise InputError(f"{where}: this is a camera of colour, {has}; {advice}")
    depths = " or ".join(str(bits) for bits in sorted({PIXEL_FORMATS[name].bits for name in grey}))
    missing = f"no pixel format of {bit_depth} bits, the rig's sensor.bit_depth"
    raise InputError(f"{where}: {missing}; {has}: write bit_depth: {depths}")


def _bytes(data: UInt8, pixels: int) -> Levels:
    return data[:pixels].copy()


def _words(data: UInt8, pixels: int) -> Levels:
    return data.view("<u2")[:pixels].astype(np.uint16)


def _dense(bits: int, data: UInt8, pixels: int) -> Levels:
    """The lowest bit first, nothing between pixels: four of 10 bits in five bytes, two of 12 bits in three."""
    together = 8 // math.gcd(8, bits)
    groups = _groups(data, together * bits // 8)
    levels = np.empty((len(groups), together), np.uint16)
    for i in range(together):
        first, shift = divmod(i * bits, 8)
        levels[:, i] = (groups[:, first] | groups[:, first + 1] << 8) >> shift & (1 << bits) - 1
    return levels.reshape(-1)[:pixels]


def _packed(low_bits: int, data: UInt8, pixels: int) -> Levels:
    """Two pixels in three bytes: the upper eight bits of each outside, the lower ones of both in the middle."""
    three = _groups(data, 3)
    mask = (1 << low_bits) - 1
    levels = np.empty((len(three), 2), np.uint16)
    levels[:, 0] = three[:, 0] << low_bits | three[:, 1] & mask
    levels[:, 1] = three[:, 2] << low_bits | three[:, 1] >> 4 & mask
    return levels.reshape(-1)[:pixels]


def _groups(data: UInt8, size: int) -> NDArray[np.uint16]:
    """UInt8 in groups of a size, shape (n, size), zeros after the last."""
    groups = np.zeros((-(-len(data) // size), size), np.uint16)
    groups.reshape(-1)[: len(data)] = data
    return groups


# Formats of grey levels by name, unpacked before packed. The third byte of a code is what a pixel takes.
PIXEL_FORMATS: dict[str, PixelFormat] = {
    name: PixelFormat(name=name, code=code, bits=bits, stored=code >> 16 & 0xFF, unpack=unpack)
    for name, code, bits, unpack in (
        ("Mono8", 0x01080001, 8, _bytes),
        ("Mono10", 0x01100003, 10, _words),
        ("Mono12", 0x01100005, 12, _words),
        ("Mono14", 0x01100025, 14, _words),
        ("Mono16", 0x01100007, 16, _words),
        ("Mono10p", 0x010A0046, 10, partial(_dense, 10)),
        ("Mono12p", 0x010C0047, 12, partial(_dense, 12)),
        ("Mono10Packed", 0x010C0004, 10, partial(_packed, 2)),
        ("Mono12Packed", 0x010C0006, 12, partial(_packed, 4)),
    )
}


_WITHOUT_CORRECTIONS: dict[str, str | bool | float] = {
    **dict.fromkeys(("ExposureAuto", "GainAuto", "BlackLevelAuto", "BalanceWhiteAuto", "TargetBrightnessAuto"), "Off"),
    "ExposureMode": "Timed",
    **dict.fromkeys(("GammaEnable", "LUTEnable", "ReverseX", "ReverseY"), False),
    **dict.fromkeys(("BinningHorizontal", "BinningVertical", "DecimationHorizontal", "DecimationVertical"), 1),
    "Gamma": 1.0,
}
_OTHER_SIZE = "change camera.resolution_px"


def switch_off_corrections(sdk: CameraSdk, settings: CameraSettings) -> None:
    """Switch off what falsifies levels; before the size is set, which binned pixels would limit."""
    where = settings.where
    for name, value in _WITHOUT_CORRECTIONS.items():
        if sdk.has(name):
            _choose(sdk, where, name, value)
    for name in ("TestPattern", "TestImageSelector"):
        if sdk.has(name) and "Off" in sdk.entries(name):
            _choose(sdk, where, name, "Off")


def set_image(sdk: CameraSdk, settings: CameraSettings) -> PixelFormat:
    """Set the pixel format, and size and place of the image on the sensor; returns the format."""
    where, available = settings.where, sdk.entries("PixelFormat")
    chosen = choose_format(available, bit_depth=settings.bit_depth, wanted=settings.pixel_format, where=where)
    _choose(sdk, where, "PixelFormat", chosen.name)
    moves = sdk.has("OffsetX") and sdk.has("OffsetY")
    if moves:  # the image could not be as large as the sensor otherwise
        sdk.write("OffsetX", 0)
        sdk.write("OffsetY", 0)
    sensor = int(sdk.bounds("Width")[1]), int(sdk.bounds("Height")[1])
    x, y = (max(1, int(sdk.bounds(name)[2])) if moves else 1 for name in ("OffsetX", "OffsetY"))
    offset = _offset_of(settings, sensor_px=sensor, steps_px=(x, y))
    for name, size in zip(("Width", "Height"), settings.resolution_px, strict=True):
        low, _, step = sdk.bounds(name)
        if size < low or (step > 1 and (size - low) % step):
            can = f"this camera can do {low:g} and more in steps of {max(1, step):g}"
            raise InputError(f"{where}: the rig's image is {size} pixels in {name}, and {can}; {_OTHER_SIZE}")
        _choose(sdk, where, name, size)
    if moves:
        for name, at in zip(("OffsetX", "OffsetY"), offset, strict=True):
            _choose(sdk, where, name, at)
    elif settings.offset_px is not None:
        raise InputError(f"{where}: this camera cannot move its image on the sensor; leave out offset_px")
    return chosen


def _offset_of(settings: CameraSettings, *, sensor_px: tuple[int, int], steps_px: tuple[int, int]) -> tuple[int, int]:
    """Corner of the rig's image on the sensor [pixels], from the left and from the top, in multiples of `steps_px`."""
    size, where = settings.resolution_px, settings.where
    if size[0] > sensor_px[0] or size[1] > sensor_px[1]:
        image, sensor = ("{} × {}".format(*one) for one in (size, sensor_px))
        larger = f"the rig's image of {image} pixels is larger than the camera's sensor of {sensor}"
        raise InputError(f"{where}: {larger}; {_OTHER_SIZE}")
    if settings.offset_px is None:
        x, y = ((sensor_px[i] - size[i]) // 2 // steps_px[i] * steps_px[i] for i in (0, 1))
        return x, y
    sides = zip(("left", "top"), settings.offset_px, size, sensor_px, steps_px, strict=True)
    for name, offset, length, whole, step in sides:
        begins = f"{where}: the image begins {offset} pixels from the {name}"
        if offset + length > whole:
            raise InputError(f"{begins} and has {length}, which are more than the sensor's {whole}")
        if offset % step:
            raise InputError(f"{begins}, and this camera can do multiples of {step} only")
    return settings.offset_px


def set_gain(sdk: CameraSdk, settings: CameraSettings) -> str | None:
    """Set the gain where the rig gives one; returns the feature that has it."""
    feature, gain = _first_of(sdk, "Gain", "GainAbs", "GainRaw"), settings.gain
    if gain is None:
        return feature
    if feature is None:
        raise InputError(f"{settings.where}: this camera has no gain to be set; leave out gain")
    low, high, step = sdk.bounds(feature)
    if not low <= gain <= high:
        raise InputError(f"{settings.where}: expected a gain of {low:g} to {high:g} ({feature}), found {gain:g}")
    sdk.write(feature, gain)
    held = sdk.read(feature, float)
    if abs(held - gain) > max(step, 0.01 * abs(gain), 0.1):
        _verify(settings.where, feature, gain, held)
    return feature


def set_trigger(sdk: CameraSdk, settings: CameraSettings) -> bool:
    """Let frames begin at a software trigger, or follow one another; returns whether they are triggered."""
    where, wanted = settings.where, settings.trigger
    if sdk.has("AcquisitionMode"):
        _choose(sdk, where, "AcquisitionMode", "Continuous")
    can = sdk.has("TriggerMode") and sdk.has("TriggerSource") and "Software" in sdk.entries("TriggerSource")
    if wanted == "software" and not can:
        raise InputError(f"{where}: this camera has no software trigger; write trigger: none")
    if sdk.has("TriggerSelector") and "FrameStart" in (kinds := sdk.entries("TriggerSelector")):
        for kind in kinds:
            if kind != "FrameStart":  # a frame would wait for it
                _choose(sdk, where, "TriggerSelector", kind)
                if sdk.has("TriggerMode"):
                    _choose(sdk, where, "TriggerMode", "Off")
        _choose(sdk, where, "TriggerSelector", "FrameStart")
    software = can and wanted != "none"
    if software:
        _choose(sdk, where, "TriggerSource", "Software")
    if sdk.has("TriggerMode"):
        _choose(sdk, where, "TriggerMode", "On" if software else "Off")
    return software


def _choose(sdk: CameraSdk, where: str, feature: str, value: str | bool | float) -> None:
    """Set a feature and verify it; one that has the value already is not written: it may be fixed."""
    if sdk.read(feature, type(value)) != value:
        sdk.write(feature, value)
        _verify(where, feature, value, sdk.read(feature, type(value)))


def _verify(where: str, feature: str, wanted: object, held: object) -> None:
    if wanted != held:
        raise HardwareError(f"{where}: {feature} was set to {wanted}, and the camera holds {held}")


_RAW = "ExposureTimeRaw"
_BASE = "ExposureTimeBaseAbs"
_MICROSECONDS = {"us": 1.0, "µs": 1.0, "\u03bcs": 1.0, "usec": 1.0, "ns": 1e-3, "ms": 1e3, "s": 1e6}
_TOLERANCE = 1e-6


class ExposureTime:
    """The exposure time of a camera, set and read back in microseconds.

    ``ExposureTime`` and ``ExposureTimeAbs`` are microseconds unless the camera names another unit. ``ExposureTimeRaw``
    counts units that only the camera knows: it names them, or ``ExposureTimeBaseAbs`` is their length [µs]. On a camera
    that gives neither it cannot be set, and is `fixed_exposure_us`.
    """

    def __init__(self, sdk: CameraSdk, settings: CameraSettings) -> None:
        self._sdk = sdk
        self._where = settings.where
        feature = _first_of(sdk, "ExposureTime", "ExposureTimeAbs", _RAW)
        unit_us = None if feature is None else _unit_us(sdk, feature)
        self._feature = None if unit_us is None else feature
        self._unit_us = unit_us or 1.0
        fixed = settings.fixed_exposure_us
        if self._feature is None and fixed is None:
            why = "has no exposure time that can be set"
            if feature is not None:
                why = f"counts its exposure time ({feature}) in units of unknown length"
            raise InputError(f"{self._where}: this camera {why}; write fixed_exposure_us, the time it is set to")
        if self._feature is not None and fixed is not None:
            can = f"this camera's exposure time can be set ({self._feature})"
            raise InputError(f"{self._where}: {can}; leave out fixed_exposure_us")
        self.held_us = fixed if fixed is not None else self.read_us()
        """What the camera held when it was last set or read [µs]."""

    @property
    def range_us(self) -> tuple[float, float]:
        if self._feature is None:
            return self.held_us, self.held_us
        low, high, _ = self._sdk.bounds(self._feature)
        return low * self._unit_us, high * self._unit_us

    def read_us(self) -> float:
        if self._feature is None:
            return self.held_us
        return self._sdk.read(self._feature, float) * self._unit_us

    def set_us(self, exposure_us: float) -> float:
        """Set the exposure time [µs] and return what the camera then holds; out of range is an InputError."""
        low, high = self.range_us
        if not low * (1 - _TOLERANCE) <= exposure_us <= high * (1 + _TOLERANCE):
            raise InputError(f"{self._where}: expected an exposure of {low:g} to {high:g} µs, found {exposure_us:g} µs")
        if self._feature is not None:
            self._sdk.write(self._feature, min(max(exposure_us, low), high) / self._unit_us)
            self.held_us = self.read_us()
        return self.held_us


def _unit_us(sdk: CameraSdk, feature: str) -> float | None:
    """How many microseconds a camera's number stands for; None where that is unknown."""
    unit = sdk.unit(feature)
    if unit:
        return _MICROSECONDS.get(unit.lower())
    if feature != _RAW:
        return 1.0
    # https://www.easymanua.ls/basler/scout-gige/manual?p=152
    return sdk.read(_BASE, float) if sdk.has(_BASE) else None


def _first_of(sdk: CameraSdk, *names: str) -> str | None:
    return next((name for name in names if sdk.has(name)), None)
