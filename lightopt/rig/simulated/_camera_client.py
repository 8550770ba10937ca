"""The virtual bench's camera as the capture sees it."""

from __future__ import annotations

import numpy as np

from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices import Frame, Identity
from lightopt.rig.simulated._camera_setup import EXPOSURE_RANGE_US
from lightopt.rig.simulated._process import BenchProcess


class VirtualCamera:
    """A camera that takes its frames from the virtual bench, which stays open when the camera is closed."""

    def __init__(self, bench: BenchProcess) -> None:
        self._bench = bench
        self._exposure_us = EXPOSURE_RANGE_US[0]
        try:
            self._says, _ = bench.request("camera")
        except ValueError as error:
            raise HardwareError(f"virtual camera: {error}") from error

    @property
    def triggered(self) -> bool:
        return bool(self._says["triggered"])

    @property
    def resolution_px(self) -> tuple[int, int]:
        width, height = self._says["resolution_px"]
        return width, height

    @property
    def bit_depth(self) -> int:
        return int(self._says["bit_depth"])

    @property
    def exposure_range_us(self) -> tuple[float, float]:
        return EXPOSURE_RANGE_US

    def identify(self) -> Identity:
        return Identity(driver="virtual", port="virtual", details={"model": "lightopt virtual camera"})

    def set_exposure(self, exposure_us: float) -> float:
        low, high = EXPOSURE_RANGE_US
        if not low <= exposure_us <= high:
            raise InputError(
                f"camera: expected an exposure of {low:g} to {high:g} µs, found {exposure_us:g} µs"
            )
        self._exposure_us = float(round(exposure_us))
        return self._exposure_us

    def grab(self, *, timeout_s: float) -> Frame:
        """Take a frame; rendering is waited for first, as long as the bench answers: that is not the camera's time."""
        try:
            self._bench.prepare()
            head, data = self._bench.request("frame", timeout_s=timeout_s, exposure_us=self._exposure_us)
        except ValueError as error:
            raise HardwareError(f"virtual camera: {error}") from error
        return Frame(
            levels=np.frombuffer(data, dtype=head["dtype"]).reshape(head["shape"]),
            exposure_us=float(head["exposure_us"]),
            number=int(head["number"]),
            timestamp_ns=int(head["timestamp_ns"]),
        )

    def close(self) -> None:
        """Nothing is held open."""
