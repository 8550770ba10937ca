"""Faults of the simulated GigE camera, on the wire and in the camera."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lightopt.rig.simulated._faults import Trigger, trigger

if TYPE_CHECKING:
    from lightopt.rig.simulated._gige import GigeCamera

Image = NDArray[np.integer[Any]]

FAULTS = (
    "lost",  # no packet of a frame arrives
    "incomplete",  # some packets do not arrive
    "duplicate",  # the frame has the number of the one before
    "order",  # its number is lower than that of the one before
    "stale",  # its time is before that of the one before
    "old_image",  # its image is that of the one before
    "exposure",  # it is exposed half as long
    "format",  # the camera holds another pixel format from here on, as after a power cycle
    "hang",  # the camera neither sends nor answers any more
    "vanish",  # its cable is pulled
)

_UNSOUND = {"lost", "incomplete", "duplicate", "order", "stale", "hang", "vanish"}
_BACK = 3
_BACK_NS = 10**9
_INCOMPLETE = 0.5
_OTHER_FORMAT = 0x0108000B  # BayerBG8


class GigeFaults:
    """Decides at each frame which faults strike, and lets the camera suffer them."""

    def __init__(self, camera: GigeCamera) -> None:
        self._camera = camera
        self._triggers: dict[str, Trigger] = {}
        self._now: set[str] = set()
        self._image: Image | None = None
        self._stamp_ns = 0
        self._losing = False
        self._awake = threading.Event()

    def inject(self, fault: str, options: dict[str, Any]) -> None:
        """Set a fault; ``clear`` ends all. Raises a ValueError for a fault or an option that there is not."""
        if fault == "clear":
            self._triggers = {}
            return
        if fault not in FAULTS:
            raise ValueError(f'a camera has no fault "{fault}"; there is {", ".join(FAULTS)}')
        self._triggers = {**self._triggers, fault: trigger(fault, options)}

    def begin(self, buffer: int, number: int, exposure_us: int) -> float:
        """Apply the faults that strike at this frame; returns how long it is really exposed [µs]."""
        self._now = {fault for fault, one in self._triggers.items() if one.strikes()}
        if "lost" in self._now:
            self._lose(1.0)
        elif "incomplete" in self._now:
            self._lose(_INCOMPLETE)
        elif self._losing:
            self._lose(0.0)
        if "duplicate" in self._now:
            self._camera.stamp(buffer, number=number - 1)
        if "order" in self._now:
            self._camera.stamp(buffer, number=number - _BACK)
        if "exposure" in self._now:
            exposure_us = max(10, exposure_us // 2)
            self._camera.write("EXPOSURE_TIME_US", exposure_us)
        if "format" in self._now:
            self._camera.write("PIXEL_FORMAT", _OTHER_FORMAT)
        if "hang" in self._now:
            self._awake.wait()  # the camera's one thread, which also answers questions
        if "vanish" in self._now:
            self._lose(1.0)
            # the camera's own thread is here and cannot end itself
            threading.Thread(target=self._camera.unplug, daemon=True).start()
        return float(exposure_us)

    def wake(self) -> None:
        """Let a camera that hangs go on, so that it can end."""
        self._awake.set()

    @property
    def arrives(self) -> bool:
        """Whether the frame that was begun will be taken for what it is."""
        return not self._now & _UNSOUND

    def seen(self, image: Image) -> Image:
        """What the frame has of what is seen."""
        old, self._image = self._image, image
        return old if "old_image" in self._now and old is not None else image

    def end(self, buffer: int, timestamp_ns: int) -> None:
        """Stamp the frame."""
        if "stale" in self._now:
            self._camera.stamp(buffer, timestamp_ns=(self._stamp_ns or time.time_ns()) - _BACK_NS)
        else:
            self._stamp_ns = timestamp_ns

    def _lose(self, share: float) -> None:
        self._losing = share > 0
        self._camera.lose(share)
