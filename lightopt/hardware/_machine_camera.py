"""A camera of an inspection machine: set as the rig wants it, triggered, and asked again when a frame is not sound."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress

from lightopt.errors import HardwareError, InputError, LightoptError
from lightopt.hardware._camera_sdk import CameraSdk, first_of
from lightopt.hardware._camera_settings import CameraSettings, offset_of
from lightopt.hardware._errors import ReplyError
from lightopt.hardware._frame_order import FrameOrder, RawFrame
from lightopt.hardware._log import Event, now
from lightopt.hardware._pixels import PixelFormat, choose_format, levels_of
from lightopt.hardware._retry import ATTEMPTS, Persistence
from lightopt.hardware._roles import Frame, Identity

__all__ = ["MachineCamera"]

_AUTOMATIC = ("ExposureAuto", "GainAuto", "BlackLevelAuto", "BalanceWhiteAuto", "TargetBrightnessAuto")
_ENABLED = ("GammaEnable", "LUTEnable", "ReverseX", "ReverseY")
_JOINED = ("BinningHorizontal", "BinningVertical", "DecimationHorizontal", "DecimationVertical")
_PATTERNS = ("TestPattern", "TestImageSelector")
_EXPOSURE = ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw")
_GAIN = ("Gain", "GainAbs", "GainRaw")
_TOLERANCE = 1e-6


class MachineCamera:
    """A camera of which the levels are to be a measure of light.

    What would make them something else is switched off: automatic exposure, gain and black level, gamma and look-up
    table, mirrored, binned and left-out pixels, test patterns, and exposure by the width of a trigger. Frames are
    checked for being whole, new and in order; what is not is taken again, a bounded number of times, each told.

    Parameters
    ----------
    driver
        Name of the driver, as in the rig file.
    sdk
        The opened camera; closed with this one.
    settings
        How it is to be.
    tell
        Called with what is out of the ordinary, as it happens.
    ready
        Called before each frame is asked for; returns when one can be: a simulated camera has to render first.

    Attributes
    ----------
    events
        What was out of the ordinary.

    Raises
    ------
    InputError
        When the camera cannot be as the rig wants it.
    HardwareError
        When it does not answer, or holds something else than it was told.
    """

    def __init__(
        self,
        driver: str,
        sdk: CameraSdk,
        settings: CameraSettings,
        *,
        tell: Callable[[Event], None] | None = None,
        ready: Callable[[], object] | None = None,
    ) -> None:
        self.events: list[Event] = []
        self._driver = driver
        self._sdk = sdk
        self._settings = settings
        self._tell = tell
        self._ready = ready
        self._order = FrameOrder()
        self._persistence = Persistence(self, verb="taken")
        self._running = False
        try:
            self._switch_off()
            self._format = self._set_image()
            self._gain = self._set_gain()
            self._exposure = first_of(sdk, *_EXPOSURE)
            self._held_us = self._first_exposure()
            self._triggered = self._set_trigger()
        except BaseException:
            sdk.close()
            raise

    @property
    def triggered(self) -> bool:
        """Whether a frame begins at the call of `grab`."""
        return self._triggered

    @property
    def resolution_px(self) -> tuple[int, int]:
        """Width and height [pixels]."""
        return self._settings.resolution_px

    @property
    def bit_depth(self) -> int:
        """Bits of a level."""
        return self._format.bits

    @property
    def exposure_range_us(self) -> tuple[float, float]:
        """Shortest and longest exposure time [µs]."""
        if self._exposure is None:
            return self._held_us, self._held_us
        low, high, _ = self._sdk.bounds(self._exposure)
        return low, high

    def identify(self) -> Identity:
        """What the camera said of itself when it was opened, and how it was set."""
        says = {**self._sdk.says, "pixel_format": self._format.name}
        says["trigger"] = "software" if self._triggered else "none"
        if self._gain is not None:
            says["gain"] = f"{self._sdk.number(self._gain):g}"
        return Identity(driver=self._driver, port=self._settings.port or "the only one", says=says)

    def set_exposure(self, exposure_us: float) -> float:
        """Set the exposure time [µs] and return what the camera holds.

        Raises
        ------
        InputError
            When it lies outside the camera's range.
        """
        low, high = self.exposure_range_us
        if not low * (1 - _TOLERANCE) <= exposure_us <= high * (1 + _TOLERANCE):
            raise InputError(
                f"{self._settings.where}: expected an exposure of {low:g} to {high:g} µs, found {exposure_us:g} µs"
            )
        if self._exposure is not None:
            self._sdk.set_number(self._exposure, min(max(exposure_us, low), high))
            self._held_us = self._sdk.number(self._exposure)
        return self._held_us

    def grab(self, *, timeout_s: float) -> Frame:
        """Take one frame, or the next that is completed where there is no trigger.

        All attempts together take no longer than `timeout_s`, of which each has an equal part, and no less than the
        exposure time: fewer attempts where there is no time for as many exposures.

        Raises
        ------
        HardwareError
            When no sound frame came in time or in the attempts that there are.
        """
        if self._ready is not None:
            self._ready()
        end = time.monotonic() + timeout_s
        fit = int(timeout_s / max(1e-6, self._held_us / 1e6))
        each_s = timeout_s / min(max(1, fit), ATTEMPTS)  # an attempt without time for its exposure is none
        raw = self._persistence.ask(lambda: self._take(min(end, time.monotonic() + each_s)))
        levels = levels_of(raw.data, self._format, width=raw.width, height=raw.height)
        held = self._held_us if self._exposure is None else self._sdk.number(self._exposure)
        return Frame(
            levels=levels,
            exposure_us=held,
            number=raw.number,
            timestamp_ns=raw.timestamp_ns,
            says={"pixel_format": self._format.name, "frames_lost": self._order.lost},
        )

    def close(self) -> None:
        """Stop and give up the camera; never raises."""
        with suppress(LightoptError):  # it is given up in any case
            self._stop()
        self._sdk.close()

    def drain(self) -> None:
        """End the acquisition, so that frames that are under way are not taken for those asked for later."""
        self._stop()

    def note(self, what: str, *, retry: bool = False) -> None:
        """Tell of something out of the ordinary."""
        event = Event(now(), f"camera {self._settings.port or self._driver}", what, retry)
        self.events.append(event)
        if self._tell is not None:
            self._tell(event)

    def _take(self, end: float) -> RawFrame:
        if not self._running:
            self._order.begin()
            self._sdk.start()
            self._running = True
        self._pass_by(end)
        begun = time.monotonic()
        if self._triggered:
            self._sdk.do("TriggerSoftware")
        raw = self._sdk.pop(max(0.0, end - time.monotonic()))
        if raw is None:
            raise ReplyError(
                f"{self._settings.where}: no frame came within {time.monotonic() - begun:.3g} s at an exposure of "
                f"{self._held_us:g} µs"
            )
        lost = self._order.lost
        try:
            self._order.check(raw)
        except ReplyError as error:
            raise ReplyError(f"{self._settings.where}: {error}") from None
        if self._triggered and self._order.lost > lost:
            self.note(f"{raw.name} came, and {self._order.lost - lost} before it never did")
        self._check_form(raw)
        return raw

    def _pass_by(self, end: float) -> None:
        """Frames that are there before one is asked for: a camera that runs freely makes them, a triggered one not."""
        while (raw := self._sdk.pop(0.0)) is not None:
            self._order.passed(raw)
            if self._triggered:
                self.note(f"{raw.name} came without being asked for and was thrown away")
            if time.monotonic() > end:
                raise ReplyError(
                    f"{self._settings.where}: frames come faster than they can be thrown away; lower the camera's "
                    "frame rate"
                )

    def _check_form(self, raw: RawFrame) -> None:
        width, height = self._settings.resolution_px
        if (raw.width, raw.height) != (width, height):
            raise HardwareError(
                f"{self._settings.where}: the camera was set to {width} × {height} pixels, and {raw.name} has "
                f"{raw.width} × {raw.height}"
            )
        if raw.code is not None and raw.code != self._format.code:
            raise HardwareError(
                f"{self._settings.where}: the camera was set to {self._format.name} ({self._format.code:#x}), and "
                f"{raw.name} is in another pixel format ({raw.code:#x})"
            )

    def _stop(self) -> None:
        if self._running:
            self._running = False
            self._sdk.stop()

    def _set_image(self) -> PixelFormat:
        """Pixel format, and where the image lies on the sensor."""
        sdk, settings = self._sdk, self._settings
        chosen = choose_format(
            sdk.words("PixelFormat"),
            bit_depth=settings.bit_depth,
            wanted=settings.pixel_format,
            where=settings.where,
        )
        self._choose("PixelFormat", chosen.name)
        moves = sdk.has("OffsetX") and sdk.has("OffsetY")
        if moves:  # the image could not be as large as the sensor otherwise
            sdk.set_number("OffsetX", 0)
            sdk.set_number("OffsetY", 0)
        sensor = int(sdk.bounds("Width")[1]), int(sdk.bounds("Height")[1])
        x, y = (max(1, int(sdk.bounds(name)[2])) if moves else 1 for name in ("OffsetX", "OffsetY"))
        offset = offset_of(settings, sensor_px=sensor, steps_px=(x, y))
        for name, size in zip(("Width", "Height"), settings.resolution_px, strict=True):
            low, _, step = sdk.bounds(name)
            if size < low or (step > 1 and (size - low) % step):
                raise InputError(
                    f"{settings.where}: the rig's image is {size} pixels in {name}, and this camera can do {low:g} "
                    f"and more in steps of {max(1, step):g}; change camera.resolution_px"
                )
            sdk.set_number(name, size)
            self._verify(name, size, sdk.number(name))
        if moves:
            for name, at in zip(("OffsetX", "OffsetY"), offset, strict=True):
                sdk.set_number(name, at)
                self._verify(name, at, sdk.number(name))
        elif settings.offset_px is not None:
            raise InputError(
                f"{settings.where}: this camera cannot move its image on the sensor; leave out offset_px"
            )
        return chosen

    def _switch_off(self) -> None:
        """What stands between light and level; before the size is set, which binned pixels would bound."""
        sdk = self._sdk
        for name in _AUTOMATIC:
            if sdk.has(name):
                self._choose(name, "Off")
        for name in _PATTERNS:
            if sdk.has(name) and "Off" in sdk.words(name):
                self._choose(name, "Off")
        if sdk.has("ExposureMode"):
            self._choose("ExposureMode", "Timed")
        for name in _ENABLED:
            if sdk.has(name) and sdk.is_on(name):
                sdk.switch_off(name)
                self._verify(name, False, sdk.is_on(name))
        for name in _JOINED:
            if sdk.has(name) and sdk.number(name) != 1:
                sdk.set_number(name, 1)
                self._verify(name, 1, sdk.number(name))
        if self._sdk.has("Gamma"):
            if self._sdk.number("Gamma") != 1.0:
                self._sdk.set_number("Gamma", 1.0)
            self._verify("Gamma", 1.0, self._sdk.number("Gamma"))

    def _set_gain(self) -> str | None:
        feature, gain = first_of(self._sdk, *_GAIN), self._settings.gain
        if gain is None:
            return feature
        if feature is None:
            raise InputError(f"{self._settings.where}: this camera has no gain to be set; leave out gain")
        low, high, step = self._sdk.bounds(feature)
        if not low <= gain <= high:
            raise InputError(
                f"{self._settings.where}: expected a gain of {low:g} to {high:g} ({feature}), found {gain:g}"
            )
        self._sdk.set_number(feature, gain)
        held = self._sdk.number(feature)
        if abs(held - gain) > max(step, 0.01 * abs(gain), 0.1):
            self._verify(feature, gain, held)
        return feature

    def _first_exposure(self) -> float:
        fixed, where = self._settings.fixed_exposure_us, self._settings.where
        if self._exposure is None:
            if fixed is None:
                raise InputError(
                    f"{where}: this camera cannot be told an exposure time; write fixed_exposure_us, the time that it "
                    "is set to otherwise"
                )
            return fixed
        if fixed is not None:
            raise InputError(
                f"{where}: this camera is told its exposure time ({self._exposure}); leave out fixed_exposure_us"
            )
        return self._sdk.number(self._exposure)

    def _set_trigger(self) -> bool:
        sdk, wanted = self._sdk, self._settings.trigger
        if sdk.has("AcquisitionMode"):
            self._choose("AcquisitionMode", "Continuous")
        can = sdk.has("TriggerMode") and sdk.has("TriggerSource") and "Software" in sdk.words("TriggerSource")
        if wanted == "software" and not can:
            raise InputError(
                f"{self._settings.where}: this camera has no software trigger; write trigger: none"
            )
        if sdk.has("TriggerSelector") and "FrameStart" in (kinds := sdk.words("TriggerSelector")):
            for kind in kinds:
                if kind != "FrameStart":  # a frame would wait for it
                    self._choose("TriggerSelector", kind)
                    if sdk.has("TriggerMode"):
                        self._choose("TriggerMode", "Off")
            self._choose("TriggerSelector", "FrameStart")
        software = can and wanted != "none"
        if software:
            self._choose("TriggerSource", "Software")
        if sdk.has("TriggerMode"):
            self._choose("TriggerMode", "On" if software else "Off")
        return software

    def _choose(self, feature: str, word: str) -> None:
        """Choose an entry and verify; what is there already is not written: it may be fixed."""
        if self._sdk.word(feature) == word:
            return
        self._sdk.set_word(feature, word)
        self._verify(feature, word, self._sdk.word(feature))

    def _verify(self, feature: str, told: object, held: object) -> None:
        if told != held:
            raise HardwareError(
                f"{self._settings.where}: {feature} was set to {told}, and the camera holds {held}"
            )
