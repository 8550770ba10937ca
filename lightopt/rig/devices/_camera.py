"""The role of a camera, and a machine-vision camera on any SDK: set to measure, triggered, its frames checked."""

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Protocol

from lightopt.core.errors import HardwareError, LightoptError
from lightopt.rig.devices import _camera_features as features
from lightopt.rig.devices._camera_sdk import CameraSdk, CameraSettings, RawFrame
from lightopt.rig.devices._device import ATTEMPTS, Event, ReplyError, Retry, now

_LAST_ID = 0xFFFF
_NEAR = 0x1000  # numbers so near to the end and the beginning of the count are a wrap, not a step back


@dataclass(frozen=True)
class Frame:
    levels: features.Levels  # right-aligned sensor levels (H, W), uint8 up to 8 bits and uint16 above
    exposure_us: float  # exposure time [µs] as read back for this frame
    number: int | None  # the camera's own; None where it has none
    timestamp_ns: int | None = None  # the camera's own [ns]
    details: dict[str, Any] = field(default_factory=dict[str, Any])


class Camera(Protocol):
    """A monochrome camera; every method raises a HardwareError when it does not deliver."""

    @property
    def triggered(self) -> bool: ...  # a frame begins at the call of grab (software trigger): none need be thrown away
    @property
    def resolution_px(self) -> tuple[int, int]: ...  # width and height
    @property
    def bit_depth(self) -> int: ...
    @property
    def exposure_range_us(self) -> tuple[float, float]: ...  # shortest and longest exposure time [µs]
    def identify(self) -> dict[str, str]: ...  # driver, port, and what it reports about itself, by name
    def set_exposure(self, exposure_us: float) -> float: ...  # what the camera then holds; InputError out of range
    def grab(self, *, timeout_s: float) -> Frame: ...  # one that begins now, or without a trigger the next completed
    def close(self) -> None: ...  # never raises


@dataclass
class FrameOrder:
    """Compares each frame with the one before; `lost` counts frames that the camera numbered and that never came."""

    lost: int = 0
    last: RawFrame | None = None

    def check(self, frame: RawFrame) -> None:
        """Raise a ReplyError for a frame that is incomplete, came before, or is older than the one before."""
        if frame.problem is not None:
            raise ReplyError(f"{frame.name} is incomplete: {frame.problem}")
        last = self.last
        if last is not None:
            step = _step(last.number, frame.number)
            if step == 0:
                raise ReplyError(f"{frame.name} came a second time")
            if step < 0:
                raise ReplyError(f"{frame.name} came after {last.name}")
            if frame.timestamp_ns and last.timestamp_ns and frame.timestamp_ns <= last.timestamp_ns:
                early_ms = (last.timestamp_ns - frame.timestamp_ns) / 1e6
                raise ReplyError(f"{frame.name} is stale: it was taken {early_ms:.3g} ms before {last.name}")
            self.lost += step - 1
        self.last = frame


def _step(last: int | None, number: int | None) -> int:
    """Step from one frame number to the next; 1 where frames are not numbered."""
    if last is None or number is None or last == number == 0:  # a count that stays at its beginning is none
        return 1
    step = number - last
    if step < 0 and last > _LAST_ID - _NEAR and number < _NEAR:
        return 1  # the count of GigE Vision 1 ends at 65535
    return step


class MachineCamera:
    """A camera whose levels measure light, as a :class:`~lightopt.rig.devices.Camera`.

    What would falsify them is switched off: automatic exposure, gain and black level, gamma and look-up table,
    mirrored, binned and left-out pixels, test patterns, and exposure by the width of a trigger. Frames are checked for
    being whole, new and in order; others are taken again, a bounded number of times, each with an event.
    """

    def __init__(
        self,
        driver: str,
        sdk: CameraSdk,
        settings: CameraSettings,
        *,
        on_event: Callable[[Event], None] | None = None,
        # returns when a frame of an exposure time [µs] can be taken
        wait_ready: Callable[[float], object] | None = None,
    ) -> None:
        self.events: list[Event] = []
        self.resolution_px = settings.resolution_px
        self.bit_depth = settings.bit_depth
        self._driver = driver
        self._sdk = sdk
        self._where = settings.where
        self._port = settings.port
        self._on_event = on_event
        self._wait_ready = wait_ready
        self._order = FrameOrder()
        self._retry = Retry(self, verb="taken")
        self._running = False
        try:
            features.switch_off_corrections(sdk, settings)
            self._format = features.set_image(sdk, settings)
            self._gain = features.set_gain(sdk, settings)
            self._exposure = features.ExposureTime(sdk, settings)
            self.triggered = features.set_trigger(sdk, settings)
        except BaseException:
            sdk.close()
            raise

    @property
    def exposure_range_us(self) -> tuple[float, float]:
        return self._exposure.range_us

    def identify(self) -> dict[str, str]:
        details = {"driver": self._driver, "port": self._port or "the only one", **self._sdk.details}
        details |= {"pixel_format": self._format.name, "trigger": "software" if self.triggered else "none"}
        if self._gain is not None:
            details["gain"] = f"{self._sdk.read(self._gain, float):g}"
        return details

    def set_exposure(self, exposure_us: float) -> float:
        return self._exposure.set_us(exposure_us)

    def grab(self, *, timeout_s: float) -> Frame:
        """Take one frame, or the next that is completed where there is no trigger.

        All attempts together take no longer than `timeout_s`, of which each has an equal part, and no less than the
        exposure time: fewer attempts where there is no time for as many exposures.
        """
        if self._wait_ready is not None:
            self._wait_ready(self._exposure.held_us)
        end = time.monotonic() + timeout_s
        fit = int(timeout_s / max(1e-6, self._exposure.held_us / 1e6))
        each_s = timeout_s / min(max(1, fit), ATTEMPTS)  # an attempt without time for its exposure is none
        raw = self._retry.run(lambda: self._take(min(end, time.monotonic() + each_s)))
        levels = features.levels_of(raw.data, self._format, width=raw.width, height=raw.height)
        details = {"pixel_format": self._format.name, "frames_lost": self._order.lost}
        return Frame(levels, self._exposure.read_us(), raw.number, raw.timestamp_ns, details)

    def close(self) -> None:
        with suppress(LightoptError):  # it is given up in any case
            self.drain()
        self._sdk.close()

    def drain(self) -> None:
        """End the acquisition, so that frames under way are not taken for those requested later."""
        if self._running:
            self._running = False
            self._sdk.stop()

    def note(self, what: str, *, retry: bool = False) -> None:
        event = Event(now(), f"camera {self._port or self._driver}", what, retry)
        self.events.append(event)
        if self._on_event is not None:
            self._on_event(event)

    def _take(self, end: float) -> RawFrame:
        if not self._running:
            self._order.last = None  # cameras may count from the beginning again
            self._sdk.start()
            self._running = True
        self._discard_pending_frames(end)
        begun = time.monotonic()
        if self.triggered:
            self._sdk.execute("TriggerSoftware")
        raw = self._sdk.pop(max(0.0, end - time.monotonic()))
        if raw is None:
            waited = f"no frame came within {time.monotonic() - begun:.3g} s"
            raise ReplyError(f"{self._where}: {waited} at an exposure of {self._exposure.held_us:g} µs")
        lost = self._order.lost
        try:
            self._order.check(raw)
        except ReplyError as error:
            raise ReplyError(f"{self._where}: {error}") from None
        if self.triggered and self._order.lost > lost:
            self.note(f"{raw.name} came, and {self._order.lost - lost} before it never did")
        self._check_form(raw)
        return raw

    def _discard_pending_frames(self, end: float) -> None:
        """Discard frames that came before the request; only a freely running camera should deliver any."""
        while (raw := self._sdk.pop(0.0)) is not None:
            self._order.last = raw
            if self.triggered:
                self.note(f"{raw.name} came without a trigger and was discarded")
            if time.monotonic() > end:
                fast = "frames come faster than they can be thrown away; lower the camera's frame rate"
                raise ReplyError(f"{self._where}: {fast}")

    def _check_form(self, raw: RawFrame) -> None:
        (width, height), wanted = self.resolution_px, self._format
        if (raw.width, raw.height) != (width, height):
            found = f"{width} × {height} pixels, and {raw.name} has {raw.width} × {raw.height}"
        elif raw.code is not None and raw.code != wanted.code:
            found = f"{wanted.name} ({wanted.code:#x}), and {raw.name} is in another pixel format ({raw.code:#x})"
        else:
            return
        raise HardwareError(f"{self._where}: the camera was set to {found}")
