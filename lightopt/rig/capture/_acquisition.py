"""Expose: switch lights, let them settle, take frames that began after the change, record how each was taken."""

import time
from collections.abc import Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

from lightopt.core.errors import HardwareError, InputError, refuse
from lightopt.core.transforms import Posture
from lightopt.optics import Sensor
from lightopt.rig.capture._capture_plan import CapturePlan
from lightopt.rig.capture._merged_exposures import ExposureImage, FrameMean
from lightopt.rig.capture._safe_devices import Devices
from lightopt.rig.capture._software_cameras import FolderCamera
from lightopt.rig.devices import Event, Frame, now

# a camera whose exposure time differs from the requested one by more than this share is refused
EXPOSURE_TOLERANCE = 0.005


@dataclass
class Timing:
    """Time spent on each part of a capture [s]."""

    whole_s: float = 0.0
    opening_s: float = 0.0  # reading the mesh, planning, and opening the devices
    moving_s: float = 0.0
    settling_s: float = 0.0
    exposing_s: float = 0.0
    transfer_s: float = 0.0
    lights_s: float = 0.0
    writing_s: float = 0.0
    closing_s: float = 0.0  # switching all lights off once more at the end, and closing the devices

    @contextmanager
    def spent(self, name: str) -> Generator[None]:
        """Count the time of the block as `name`."""
        begun = time.monotonic()
        try:
            yield
        finally:
            setattr(self, name, getattr(self, name) + time.monotonic() - begun)


@dataclass(frozen=True, kw_only=True)
class AcquiredImage:
    """An image as it came from the camera."""

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

    def __init__(self, devices: Devices, plan: CapturePlan, *, sensor: Sensor, timing: Timing) -> None:
        devices.step = "querying the identity of the devices"
        self._identities = devices.identities()
        _check_exposures(devices, plan)
        self.devices = devices
        self._plan = plan
        self._sensor = sensor
        self._timing = timing
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
        with self._timing.spent("moving_s"):
            self.devices.home()

    def move(self, posture: Posture) -> None:
        if self.devices.stage is None:
            return
        self.devices.step = f"moving the stage to {posture}"
        with self._timing.spent("moving_s"):
            state = self.devices.move_to(posture)
        self._stage_settled = time.monotonic() + self._plan.wiring.hardware.timing.stage_ms / 1e3
        self._stage = {"requested": posture.as_dict(), "read": state.posture.as_dict()}
        self._changed = True

    def confirm_stage(self) -> None:
        """Check that the stage stands where it was left; moves nothing."""
        if self.devices.stage is None:
            return
        self.devices.step = "checking that the stage has not moved"
        with self._timing.spent("moving_s"):
            self.devices.stage.confirm()

    def light_on(self, name: str) -> None:
        """Light an image, once the stage needs no longer to settle than the lights; they settle while read back."""
        self.devices.step = f"lighting {name}"
        light_s = self._plan.wiring.hardware.timing.light_ms / 1e3
        self._wait_until(self._stage_settled - light_s)
        begun, sent = time.monotonic(), 0.0
        facts: list[dict[str, Any]] = []
        for light, level in self._plan.wiring.levels(name).items():
            channel = self._plan.wiring.light(light)
            held = self.devices.light_on(light, level)
            sent = self.devices.controllers[channel.controller].level_set_s
            of_device = {"controller": channel.controller, "channel": channel.channel}
            facts.append({**of_device, "level": {"requested": level, "read": held}})
        read_s = time.monotonic() - sent
        self._timing.settling_s += min(read_s, light_s)
        self._timing.lights_s += sent - begun + max(0.0, read_s - light_s)
        self._light_settled = sent + light_s
        self._lit = (name, facts[0] if len(facts) == 1 else {"lights": facts})
        self._changed = True

    def light_off(self) -> None:
        assert self._lit is not None
        self.devices.step = f"switching {self._lit[0]} off"
        with self._timing.spent("lights_s"):
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

    def settle(self, *, counted: str = "settling_s") -> None:
        """Wait until stage and light have settled; `counted` names the entry of the timing."""
        self.devices.step = "letting stage and light settle"
        self._wait_until(max(self._stage_settled, self._light_settled), counted)

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
        exposure_s = self._held_us / 1e6
        light = self._lit[0] if self._lit else None
        left_s = self._remaining_on_s()
        if left_s is not None and left_s <= exposure_s:
            raise HardwareError(
                f"{light} may be on for {max(0.0, left_s):.3g} s more (max_on_s) and the exposure "
                "takes longer: frames came later than planned; take fewer or shorter exposures"
            )
        begun = time.monotonic()
        frame = self.devices.grab(self._held_us, light)
        taken_s = time.monotonic() - begun
        self._timing.exposing_s += min(exposure_s, taken_s)
        self._timing.transfer_s += max(0.0, taken_s - exposure_s)
        width, height = self.devices.camera.resolution_px
        if frame.levels.shape != (height, width) or int(frame.levels.max()) > self._sensor.max_level:
            raise HardwareError(
                f"the camera delivered a frame of {frame.levels.shape[1]} × {frame.levels.shape[0]} pixels with levels "
                f"up to {frame.levels.max()}; expected {width} × {height} and at most {self._sensor.max_level}"
            )
        if abs(frame.exposure_us - self._held_us) > 1e-3 * self._held_us:
            name = "a frame" if frame.number is None else f"frame {frame.number}"
            raise HardwareError(f"the camera took {name} at {frame.exposure_us:g} µs, but held {self._held_us:g} µs")
        return frame

    def _remaining_on_s(self) -> float | None:
        """How long the light may stay lit [s]; None where nothing limits it."""
        return None if self._lit is None else self.devices.remaining_on_s(self._lit[0])

    def _wait_until(self, moment: float, counted: str = "settling_s") -> None:
        with self._timing.spent(counted):
            while (left := moment - time.monotonic()) > 0:
                time.sleep(left)


def _holds(held_us: float, wanted_us: float) -> bool:
    return abs(held_us - wanted_us) <= EXPOSURE_TOLERANCE * wanted_us


def _check_exposures(devices: Devices, plan: CapturePlan) -> None:
    """Refuse a plan whose exposures the camera cannot hold; each that is in its range is set once."""
    low, high = devices.camera.exposure_range_us
    for time_us in map(plan.exposure_us, plan.exposures):
        if not low * (1 - EXPOSURE_TOLERANCE) <= time_us <= high * (1 + EXPOSURE_TOLERANCE):
            raise InputError(
                f"an exposure of {time_us:g} µs is outside the camera's {low:g} to {high:g} µs; choose others, "
                "or another camera.exposure_us in the rig"
            )
    problems: list[str] = []
    for exposure in plan.exposures:
        wanted = plan.exposure_us(exposure)
        held = devices.camera.set_exposure(wanted)
        if not _holds(held, wanted):
            problems.append(
                f"exposure {exposure:g} ({wanted:g} µs): the camera holds {held:g} µs instead, which is exposure "
                f"{held / plan.wiring.exposure_us:.6g}; choose exposures that it can hold, or another "
                "camera.exposure_us in the rig"
            )
    refuse(problems)
