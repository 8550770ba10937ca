"""What a capture was asked for."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture

MOST_FRAMES = 1000
"""Frames that one image is the mean of, at most."""


@dataclass(frozen=True, kw_only=True)
class CaptureOptions:
    """What to capture.

    Attributes
    ----------
    lights
        Names of the lights, one image each; None for all of the rig.
    postures
        Instead of the part's own.
    exposures
        Relative to the rig's ``camera.exposure_us``; all of them under one light before the next is lit.
    average
        Frames that each image is the mean of.
    dark
        Whether frames without light are taken in every posture at every exposure, and subtracted in the EXR.
    home
        Whether the stage seeks its origin first.
    check
        Whether each image is checked for being lit by the light that it should be lit by.
    come_back
        Whether the stage comes back to its first posture at the end, to see that it lost no steps.

    Raises
    ------
    InputError
        When a number is out of range or something is given twice.
    """

    lights: tuple[str, ...] | None = None
    postures: tuple[Posture, ...] | None = None
    exposures: tuple[float, ...] = (1.0,)
    average: int = 1
    dark: bool = False
    home: bool = False
    check: bool = True
    come_back: bool = False

    def __post_init__(self) -> None:
        if problems := tuple(self._problems()):
            raise InputError(*problems)

    def _problems(self) -> Iterator[str]:
        if not self.exposures:
            yield "exposures: expected at least one, such as 1 or 1/16"
        for exposure in self.exposures:
            if not (math.isfinite(exposure) and exposure > 0.0):
                yield f"exposures: expected numbers above 0, found {exposure:g}"
        for name, values in (
            ("exposures", self.exposures),
            ("light", self.lights or ()),
            ("posture", self.postures or ()),
        ):
            if len(set(values)) < len(values):
                yield f"{name}: the same one was given twice"
        if not 1 <= self.average <= MOST_FRAMES:
            yield f"average: expected 1 to {MOST_FRAMES} frames, found {self.average}"

    def as_dict(self) -> dict[str, Any]:
        """What changes the files of the set, in JSON form."""
        return {
            "exposures": list(self.exposures),
            "average": self.average,
            "dark": self.dark,
            "check": self.check,
        }
