"""Cameras without hardware: one replays the images of a set, one takes frames from the virtual bench."""

import math
from pathlib import Path

import numpy as np

from lightopt.core.errors import HardwareError, InputError
from lightopt.core.transforms import Posture
from lightopt.images import dark_name, read_image_set, read_png
from lightopt.rig.devices import Frame
from lightopt.rig.simulated import EXPOSURE_RANGE_US, BenchProcess


class FolderCamera:
    """A camera that delivers the PNG of what is shown from an image set; InputError for a damaged set."""

    triggered = True

    def __init__(self, folder: Path, *, resolution_px: tuple[int, int], exposure_us: float) -> None:
        self._set = read_image_set(folder)
        self._entries = {entry.key: entry for entry in self._set.images if entry.png is not None}
        self.bit_depth = self._set.manifest.bit_depth
        self.resolution_px = resolution_px
        self._exposure_us = exposure_us
        self._held_us = exposure_us
        self._now: tuple[str | None, Posture, float] | None = None
        self._number = 0

    @property
    def exposure_range_us(self) -> tuple[float, float]:
        """From the shortest to the longest exposure of the set [µs]."""
        times = [entry.exposure * self._exposure_us for entry in self._entries.values()]
        return (min(times, default=0.0), max(times, default=0.0))

    def missing(self, light: str | None, posture: Posture, exposure: float) -> str | None:
        """Message about an image of a plan that cannot be replayed; None where it can."""
        if light is None:
            name = dark_name(posture, exposure)
            there = name in self._set.manifest.files
            return None if there else f"{self._set.folder}: no dark frame {name} to replay"
        if (light, posture, exposure) in self._entries:
            return None
        there = f"it has {len(self._entries)} images"
        return f"{self._set.folder}: no PNG of {light} {posture} at exposure {exposure:g} to replay; {there}"

    def show(self, light: str | None, posture: Posture, exposure: float) -> None:
        """Select what the next frames show; None is the dark."""
        self._now = (light, posture, exposure)

    def identify(self) -> dict[str, str]:
        return {"driver": "folder", "port": str(self._set.folder), "kind": self._set.manifest.kind}

    def set_exposure(self, exposure_us: float) -> float:
        same = (e for e in self._entries.values() if math.isclose(e.exposure * self._exposure_us, exposure_us))
        entry = next(same, None)
        self._held_us = exposure_us if entry is None else entry.held_exposure * self._exposure_us
        return self._held_us

    def grab(self, *, timeout_s: float) -> Frame:
        """Read the image; HardwareError when the set does not have it."""
        del timeout_s
        if self._now is None:
            raise HardwareError("no image was selected for the folder camera to replay")
        light, posture, exposure = self._now
        if problem := self.missing(light, posture, exposure):
            if light is not None:
                raise HardwareError(problem)
            # the set's black level, to check lit images against where it has no dark frames
            black = np.full(self.resolution_px[::-1], round(self._set.manifest.black_level))
            levels = black.astype(np.uint8) if self.bit_depth <= 8 else black.astype(np.uint16)
        else:
            name = dark_name(posture, exposure) if light is None else self._entries[light, posture, exposure].png
            try:
                levels = read_png(self._set.path(name or ""))
            except InputError as error:
                raise HardwareError(*error.messages) from error
        self._number += 1
        return Frame(levels=levels, exposure_us=self._held_us, number=self._number)

    def close(self) -> None:
        """Nothing is held open."""


class VirtualCamera:
    """A camera that takes its frames from the virtual bench, which stays open when the camera is closed."""

    exposure_range_us = EXPOSURE_RANGE_US

    def __init__(self, bench: BenchProcess) -> None:
        self._bench = bench
        self._exposure_us = EXPOSURE_RANGE_US[0]
        try:
            answer, _ = bench.request("camera")
        except ValueError as error:
            raise HardwareError(f"virtual camera: {error}") from error
        width, height = answer["resolution_px"]
        self.resolution_px: tuple[int, int] = (width, height)
        self.bit_depth = int(answer["bit_depth"])
        self.triggered = bool(answer["triggered"])

    def identify(self) -> dict[str, str]:
        return {"driver": "virtual", "port": "virtual", "model": "lightopt virtual camera"}

    def set_exposure(self, exposure_us: float) -> float:
        low, high = EXPOSURE_RANGE_US
        if not low <= exposure_us <= high:
            raise InputError(f"camera: expected an exposure of {low:g} to {high:g} µs, found {exposure_us:g} µs")
        self._exposure_us = float(round(exposure_us))
        return self._exposure_us

    def grab(self, *, timeout_s: float) -> Frame:
        """Take a frame; rendering is waited for first, as long as the bench answers: that is not the camera's time."""
        try:
            self._bench.prepare(self._exposure_us)
            head, data = self._bench.request("frame", timeout_s=timeout_s, exposure_us=self._exposure_us)
        except ValueError as error:
            raise HardwareError(f"virtual camera: {error}") from error
        levels = np.frombuffer(data, dtype=head["dtype"]).reshape(head["shape"])
        return Frame(levels, head["exposure_us"], head["number"], head["timestamp_ns"])

    def close(self) -> None:
        """Nothing is held open."""
