"""Expose: switch lights, let them settle, take frames that began after the change, record how; merge exposures."""

import math
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.errors import HardwareError, refuse
from lightopt.core.transforms import Posture
from lightopt.optics import Sensor
from lightopt.rig.capture._capture_plan import CapturePlan
from lightopt.rig.capture._safe_devices import Devices
from lightopt.rig.capture._software_cameras import FolderCamera
from lightopt.rig.devices import Event, Frame, Levels, now

LEAST_LEVEL = 1.5  # pixels count that should be at least so far above black in the shorter exposure [sensor level]
LEAST_PIXELS = 30
MOST_PIXELS = 200_000  # of larger images a grid of about so many pixels is compared: the next exposure waits for it
TOLERANCE = 0.1  # share by which the exposures may differ: exposure times of cameras are not exact
TOLERANCE_LEVELS = 0.4  # levels by which they may differ in addition: clipping at level 0, an inexact black level
Dark = Mapping[float, Float32]  # frames without light of a posture by relative exposure [sensor level], each (H, W)


@dataclass(frozen=True)
class ExposureImage:
    """An image at one exposure; arrays of shape (H, W)."""

    exposure: float  # relative exposure, as the camera held it
    mean: Float32  # mean of the frames [sensor level]
    saturated: Bool  # where any frame reached the saturation level, so that the mean is too low
    # [sensor level] the frame as delivered; of several the mean, rounded half to even (half up would add 1/(2N) on
    # average), and the highest level of all where any was saturated
    png: Levels


class FrameMean:
    """Mean of frames that come in one by one, each of shape (H, W) [sensor level]."""

    def __init__(self, sensor: Sensor) -> None:
        self._sensor = sensor
        self._number = 0
        self._highest: NDArray[Any] | None = None
        self._sum: Float64 | None = None

    def add(self, levels: Levels) -> None:
        self._number += 1
        if self._highest is None:
            self._highest = levels
            return
        if self._sum is None:
            self._sum = self._highest.astype(np.float64)
        self._sum += levels
        self._highest = np.maximum(self._highest, levels)

    def image(self, exposure: float) -> ExposureImage:
        """The image of the frames so far, at least one, at the relative exposure that the camera held."""
        highest = self._highest
        assert highest is not None
        saturated = highest >= self._sensor.saturated_from
        if self._sum is None:
            return ExposureImage(exposure, highest.astype(np.float32), saturated, png=highest)
        mean = self._sum / self._number
        png = np.where(saturated, highest, np.rint(mean).astype(highest.dtype))
        return ExposureImage(exposure, mean.astype(np.float32), saturated, png)


def exposure_mismatch(
    light: str, one: ExposureImage, other: ExposureImage, *, darks: Sequence[Float32 | float], sensor: Sensor
) -> str | None:
    """Message about how the brightness of a light differs between two exposures (H, W); None where it does not.

    Pixels that are saturated in the longer exposure must be at least that bright in the shorter one.
    `darks` are what each shows without the light [sensor level], (H, W) or one level.
    """
    pairs = [(image, np.asarray(dark, np.float32)) for image, dark in zip((one, other), darks, strict=True)]
    (long, long_dark), (short, short_dark) = pairs if one.exposure >= other.exposure else pairs[::-1]
    ratio = short.exposure / long.exposure
    step = max(1, round(math.sqrt(long.mean.size / MOST_PIXELS)))
    some = (slice(step // 2, None, step), slice(step // 2, None, step))
    long_dark, short_dark = (dark[some] if dark.ndim else dark for dark in (long_dark, short_dark))
    long_full, short_full = long.saturated[some], short.saturated[some]
    expected = np.minimum(long.mean[some], sensor.saturated_from) - long_dark
    expected = expected * np.float32(ratio)
    seen = short.mean[some] - short_dark
    bright = expected >= LEAST_LEVEL
    both = bright & ~long_full & ~short_full
    only_long = bright & long_full & ~short_full
    for where, least in ((both, False), (only_long, True)):
        count = int(np.count_nonzero(where))
        if count < LEAST_PIXELS:
            continue
        should, found = (float(a[where].mean(dtype=np.float64)) for a in (expected, seen))
        off = found - should
        noise = sensor.noise_variance(should)
        allowed = TOLERANCE * should + TOLERANCE_LEVELS + 6.0 * float(np.sqrt(2.0 * noise / count))
        if off < -allowed or (off > allowed and not least):
            share = max(found, 0.0) / should if one is short else should / max(found, 1e-3)
            cause = "it failed, changed, or another light was switched on between the exposures"
            return f"{light} is {share:.0%} as bright as at exposure {other.exposure:g}: {cause}"
    return None


def merge_exposures(
    images: Sequence[ExposureImage], *, sensor: Sensor, full_scale: float, dark: Sequence[Float32] | None = None
) -> dict[str, Float32]:
    """The linear image of a light: every pixel from the longest exposure in which it is not saturated.

    Level at exposure 1 = (sensor level − dark) · full scale / ((2^b − 1) · exposure).

    images: The exposures, of one shape (H, W), the longest first.
    full_scale: Grey level of a full-scale sensor level at exposure 1.
    dark: Mean frame without light of each exposure [sensor level], shape (H, W); else the black level is removed.
    Returns dict: EXR channels, float32 (H, W): ``Y`` [grey level at exposure 1]; ``valid``, 0 where every exposure was
        saturated and `Y` is only a lower bound; ``exposure``, the relative exposure that the pixel came from.
    """
    level = np.zeros(images[0].mean.shape, np.float32)
    exposure = np.zeros(level.shape, np.float32)
    missing = np.ones(level.shape, np.bool_)
    for i, image in enumerate(images):
        last = i == len(images) - 1
        take = missing if last else missing & ~image.saturated
        black = sensor.black_level if dark is None else dark[i]
        scale = full_scale / (sensor.max_level * image.exposure)
        np.copyto(level, ((image.mean - black) * scale).astype(np.float32), where=take)
        exposure[take] = image.exposure
        missing = missing & image.saturated
    return {"Y": level, "valid": (~missing).astype(np.float32), "exposure": exposure}


# a camera whose exposure time differs from the requested one by more than this share is refused
EXPOSURE_TOLERANCE = 0.005


@dataclass(frozen=True, kw_only=True)
class AcquiredImage:
    light: str | None  # None for a frame without light
    posture: Posture
    exposure: float  # requested relative exposure
    future: Future[ExposureImage]  # the image of the frames, which is computed while the light goes out
    facts: dict[str, Any]  # how it was taken, in JSON form, for the manifest

    @property
    def image(self) -> ExposureImage:
        return self.future.result()


class AcquisitionEngine:
    """Takes the images of a plan; InputError, with nothing lit or moved, where the camera lacks an exposure time."""

    def __init__(self, devices: Devices, plan: CapturePlan, *, sensor: Sensor) -> None:
        devices.step = "querying the identity of the devices"
        self._identities = devices.identities()
        # refuse a plan whose exposures the camera cannot hold; each that is in its range is set once
        low, high = devices.camera.exposure_range_us
        problems: list[str] = []
        for exposure in plan.exposures:
            wanted = plan.exposure_us(exposure)
            if not low * (1 - EXPOSURE_TOLERANCE) <= wanted <= high * (1 + EXPOSURE_TOLERANCE):
                problems.append(f"an exposure of {wanted:g} µs is outside the camera's {low:g} to {high:g} µs")
            elif not _holds(held := devices.camera.set_exposure(wanted), wanted):
                instead = f"holds {held:g} µs instead, which is exposure {held / plan.wiring.exposure_us:.6g}"
                problems.append(f"exposure {exposure:g} ({wanted:g} µs): the camera {instead}")
        refuse(f"{problem}; choose others, or another camera.exposure_us in the rig" for problem in problems)
        self.devices = devices
        self._plan = plan
        self._sensor = sensor
        self._stage: dict[str, Any] | None = None
        self._stage_settled = 0.0
        self._lit: tuple[str, dict[str, Any]] | None = None
        self._light_settled = 0.0
        self._held_us: float | None = None
        self._changed = True
        self._reported_events: dict[int, Event] = {}
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="frames")

    def close(self) -> None:
        """Wait for the images whose frames have come."""
        self._worker.shutdown(wait=True)

    def home(self) -> None:
        self.devices.step = "homing the stage"
        self.devices.home()

    def move(self, posture: Posture) -> None:
        if self.devices.stage is None:
            return
        self.devices.step = f"moving the stage to {posture}"
        state = self.devices.move_to(posture)
        self._stage_settled = time.monotonic() + self._plan.wiring.hardware.timing.stage_ms / 1e3
        self._stage = {"requested": posture.as_dict(), "read": state.posture.as_dict()}
        self._changed = True

    def confirm_stage(self) -> None:
        """Check that the stage stands where it was left; moves nothing."""
        if self.devices.stage is None:
            return
        self.devices.step = "checking that the stage has not moved"
        self.devices.stage.confirm()

    def light_on(self, name: str) -> None:
        """Light an image, once the stage needs no longer to settle than the lights; they settle while read back."""
        self.devices.step = f"lighting {name}"
        light_s = self._plan.wiring.hardware.timing.light_ms / 1e3
        self._wait_until(self._stage_settled - light_s)
        sent = 0.0
        facts: list[dict[str, Any]] = []
        for light, level in self._plan.wiring.levels(name).items():
            channel = self._plan.wiring.light(light)
            held = self.devices.light_on(light, level)
            sent = self.devices.controllers[channel.controller].level_set_s
            of_device = {"controller": channel.controller, "channel": channel.channel}
            facts.append({**of_device, "level": {"requested": level, "read": held}})
        self._light_settled = sent + light_s
        self._lit = (name, facts[0] if len(facts) == 1 else {"lights": facts})
        self._changed = True

    def light_off(self) -> None:
        assert self._lit is not None
        self.devices.step = f"switching {self._lit[0]} off"
        self.devices.light_off(self._lit[0])
        self._light_settled = time.monotonic() + self._plan.wiring.hardware.timing.light_ms / 1e3
        self._lit = None
        self._changed = True

    def set_exposure(self, exposure: float) -> None:
        """Set the camera's exposure time, while stage and light settle."""
        wanted = self._plan.exposure_us(exposure)
        self.devices.step = f"setting the exposure to {wanted:g} µs"
        held = self.devices.camera.set_exposure(wanted)
        if not _holds(held, wanted):
            raise HardwareError(f"the camera holds an exposure of {held:g} µs instead of {wanted:g} µs as before")
        self._changed = self._changed or held != self._held_us
        self._held_us = held

    def settle(self) -> None:
        self.devices.step = "letting stage and light settle"
        self._wait_until(max(self._stage_settled, self._light_settled))

    def max_wait_s(self, exposures: Sequence[float]) -> float:
        """How long a settled light may stay lit unused before its exposures [s].

        As long as lighting it again would take: then it is lit at most twice as long as needed, and at least half of
        the possible time is saved. Never so long that it could not stay lit for all of the exposures.
        """
        anew_s = self._plan.relighting_s
        if (left_s := self._remaining_on_s()) is None:
            return anew_s
        return max(0.0, min(anew_s, left_s - sum(map(self._plan.frames_s, exposures))))

    def expose(self, posture: Posture, exposure: float) -> AcquiredImage:
        """Take an image under the light that is lit, or in the dark."""
        light = self._lit[0] if self._lit else None
        self.devices.step = f"exposing {light or 'dark'} {posture} at exposure {exposure:g}"
        if light is not None:
            self.devices.check_watchdog(light)
        camera = self.devices.camera
        if isinstance(camera, FolderCamera):
            camera.show(light, posture, exposure)
        if self._changed and not camera.triggered:
            for _ in range(self._plan.wiring.hardware.timing.discard_frames):
                self._grab()  # it may have begun before the change
        self._changed = False
        begun = now()
        mean = FrameMean(self._sensor)
        first = last = self._grab()
        counted = [self._worker.submit(mean.add, first.levels)]  # while the next is exposed
        for _ in range(self._plan.options.average - 1):
            last = self._grab()
            counted.append(self._worker.submit(mean.add, last.levels))
        held = first.exposure_us
        facts: dict[str, Any] = {
            "time": begun,
            "exposure_us": {"requested": self._plan.exposure_us(exposure), "read": held},
            "frames": len(counted),
            "frame_numbers": [first.number, last.number],
            "light": None if self._lit is None else self._lit[1],
            "stage": self._stage,
            "devices": self._identities,
        }
        if self._lit is not None:  # what happened at frames without light belongs to the image that follows
            events = self.events_since()
            facts["retries"] = sum(event.retry for event in events)
            if events:
                facts["events"] = [asdict(event) for event in events]
        if first.timestamp_ns is not None:
            facts["camera_time_ns"] = first.timestamp_ns
        if first.details:
            facts["camera"] = first.details

        def finish() -> ExposureImage:
            for frame in counted:
                frame.result()
            return mean.image(held / self._plan.wiring.exposure_us)

        future = self._worker.submit(finish)
        return AcquiredImage(light=light, posture=posture, exposure=exposure, future=future, facts=facts)

    def events_since(self) -> tuple[Event, ...]:
        """Irregularities on the links since the previous image."""
        new = tuple(event for event in self.devices.events() if id(event) not in self._reported_events)
        self._reported_events.update((id(event), event) for event in new)
        return new

    def _grab(self) -> Frame:
        assert self._held_us is not None
        light = self._lit[0] if self._lit else None
        if (left_s := self._remaining_on_s()) is not None and left_s <= self._held_us / 1e6:
            longer = "and the exposure takes longer: frames came later than planned; take fewer or shorter exposures"
            raise HardwareError(f"{light} may be on for {max(0.0, left_s):.3g} s more (max_on_s) {longer}")
        frame = self.devices.grab(self._held_us, light)
        (width, height), most = self.devices.camera.resolution_px, self._sensor.max_level
        rows, columns = frame.levels.shape
        if (rows, columns) != (height, width) or int(frame.levels.max()) > most:
            found = f"{columns} × {rows} pixels with levels up to {frame.levels.max()}"
            raise HardwareError(f"the camera delivered {found}; expected {width} × {height} and at most {most}")
        if abs(frame.exposure_us - self._held_us) > 1e-3 * self._held_us:
            raise HardwareError(f"the camera took a frame at {frame.exposure_us:g} µs, but held {self._held_us:g} µs")
        return frame

    def _remaining_on_s(self) -> float | None:
        return None if self._lit is None else self.devices.remaining_on_s(self._lit[0])

    def _wait_until(self, moment: float) -> None:
        while (left := moment - time.monotonic()) > 0:
            time.sleep(left)


def _holds(held_us: float, wanted_us: float) -> bool:
    return abs(held_us - wanted_us) <= EXPOSURE_TOLERANCE * wanted_us
