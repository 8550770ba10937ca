"""A camera that replays the images of a set, for trying everything behind the camera again."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import HardwareError, InputError
from lightopt.core.transforms import Posture
from lightopt.images import ImageEntry, ImageSet, dark_name, read_image_set, read_png
from lightopt.rig.devices import Frame, Identity


class FolderCamera:
    """Delivers the PNG of the light, posture and exposure that the capture is at.

    Parameters
    ----------
    folder
        An image set; its files are verified by the manifest's hashes.
    resolution_px
        Width and height that its images must have.
    exposure_us
        Exposure time [µs] of exposure 1.

    Raises
    ------
    InputError
        When it is no image set or damaged.
    """

    triggered = True

    def __init__(self, folder: Path, *, resolution_px: tuple[int, int], exposure_us: float) -> None:
        self._set: ImageSet = read_image_set(folder)
        self._entries: dict[tuple[str, Posture, float], ImageEntry] = {
            entry.key: entry for entry in self._set.images if entry.png is not None
        }
        self._resolution_px = resolution_px
        self._exposure_us = exposure_us
        self._held_us = exposure_us
        self._now: tuple[str | None, Posture, float] | None = None
        self._number = 0

    @property
    def resolution_px(self) -> tuple[int, int]:
        """Width and height [pixels]."""
        return self._resolution_px

    @property
    def bit_depth(self) -> int:
        """Bits of a level."""
        return self._set.manifest.bit_depth

    @property
    def exposure_range_us(self) -> tuple[float, float]:
        """From the shortest to the longest exposure of the set [µs]."""
        times = [entry.exposure * self._exposure_us for entry in self._entries.values()]
        return (min(times, default=0.0), max(times, default=0.0))

    def missing(self, light: str | None, posture: Posture, exposure: float) -> str | None:
        """Say which image of a plan the set lacks; None where it has it."""
        if light is None:
            name = dark_name(posture, exposure)
            return (
                None
                if name in self._set.manifest.files
                else f"{self._set.folder}: no dark frame {name} to replay"
            )
        if (light, posture, exposure) in self._entries:
            return None
        return (
            f"{self._set.folder}: no PNG of {light} {posture} at exposure {exposure:g} to replay; it has "
            f"{len(self._entries)} images"
        )

    def show(self, light: str | None, posture: Posture, exposure: float) -> None:
        """Say what the next frames are of; the dark has no light."""
        self._now = (light, posture, exposure)

    def identify(self) -> Identity:
        """The folder, and what its manifest says."""
        return Identity(driver="folder", port=str(self._set.folder), details={"kind": self._set.manifest.kind})

    def set_exposure(self, exposure_us: float) -> float:
        """Hold what the set's camera held of it, or any other; whether the set has it is known at the frame."""
        self._held_us = next(
            (
                entry.held_exposure * self._exposure_us
                for entry in self._entries.values()
                if math.isclose(entry.exposure * self._exposure_us, exposure_us)
            ),
            exposure_us,
        )
        return self._held_us

    def grab(self, *, timeout_s: float) -> Frame:
        """Read the image.

        Raises
        ------
        HardwareError
            When the set does not have it.
        """
        del timeout_s
        if self._now is None:
            raise HardwareError("the folder camera was not told what to replay")
        light, posture, exposure = self._now
        if problem := self.missing(light, posture, exposure):
            if light is not None:
                raise HardwareError(problem)
            levels = self._black()
        else:
            name = (
                dark_name(posture, exposure) if light is None else self._entries[light, posture, exposure].png
            )
            try:
                levels = read_png(self._set.path(name or ""))
            except InputError as error:
                raise HardwareError(*error.messages) from error
        self._number += 1
        return Frame(levels=levels, exposure_us=self._held_us, number=self._number)

    def close(self) -> None:
        """Nothing is held open."""

    def _black(self) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """The set's black level, to check lit images against where it has no dark frames."""
        shape, level = self._resolution_px[::-1], round(self._set.manifest.black_level)
        return np.full(shape, level, np.uint8) if self.bit_depth <= 8 else np.full(shape, level, np.uint16)
