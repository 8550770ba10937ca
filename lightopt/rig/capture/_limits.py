"""Options of a capture, and checks against what stage, camera and channels can do."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.rig.capture._wiring import VIRTUAL, Wiring
from lightopt.rig.simulated import EXPOSURE_RANGE_US
from lightopt.scene import part_postures

MOST_FRAMES = 1000
"""Frames that one image is the mean of, at most."""


@dataclass(frozen=True, kw_only=True)
class CaptureOptions:
    """What to capture.

    Attributes
    ----------
    lights, postures: Instead of all lights of the rig and the part's own postures.
    exposures: Relative to the rig's ``camera.exposure_us``; all of them under one light before the next is lit.
    average: Number of frames that each image is the mean of.
    dark: Whether frames without light are taken in every posture at every exposure, and subtracted in the EXR.
    home: Whether the stage seeks its origin first.
    check: Whether each image is checked for being lit by the right light.
    check_repeatability: Whether the stage returns to its first posture at the end, to see that it lost no steps.

    Raises
    ------
    InputError: A number is out of range or something is given twice.
    """

    lights: tuple[str, ...] | None = None
    postures: tuple[Posture, ...] | None = None
    exposures: tuple[float, ...] = (1.0,)
    average: int = 1
    dark: bool = False
    home: bool = False
    check: bool = True
    check_repeatability: bool = False

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
        numbers = {"exposures": list(self.exposures), "average": self.average}
        return {**numbers, "dark": self.dark, "check": self.check}


def posture_problems(
    rig: RigConfig, part: PartConfig, wiring: Wiring, options: CaptureOptions
) -> Iterator[str]:
    """Postures beyond the stage's range, or that a stage without one of the axes cannot take."""
    if options.postures is not None:
        named = [(posture, "--posture") for posture in options.postures]
    else:
        named = [(posture, part.source.at("postures", i)) for i, posture in enumerate(part_postures(part))]
    stage = wiring.hardware.stage
    if stage is None and len(named) > 1:
        yield (
            f"{rig.source.at('hardware')}: this rig has no stage, so that one run takes one posture; place the part by "
            f"hand and name it with --posture; found {len(named)} postures"
        )
    for posture, where in named:
        for name, angle in (("elevation", posture.elevation_deg), ("rotation", posture.rotation_deg)):
            if (problem := outside_range(rig, name, angle)) is not None:
                yield f"{where}: {problem}"
            elif stage is not None and getattr(stage, name) is None and angle != 0.0:
                yield (
                    f"{where}: {name} {angle:g}°, but the stage has no {name} axis, which stands at 0° "
                    f"({rig.source.at('hardware', 'stage')})"
                )


def outside_range(rig: RigConfig, name: str, angle: float) -> str | None:
    """Message where an angle [°] is outside the range of a stage's axis, else None."""
    ranges = {"elevation": rig.stage.elevation_range_deg, "rotation": rig.stage.rotation_range_deg}
    low, high = ranges[name]
    if low <= angle <= high:
        return None
    where = rig.source.at("stage", f"{name}_range_deg")
    return f"{name} {angle:g}° is outside the stage's range {low:g}° to {high:g}° ({where})"


def exposure_problems(rig: RigConfig, wiring: Wiring, exposures: tuple[float, ...]) -> Iterator[str]:
    """Exposures that the virtual camera cannot hold."""
    if wiring.hardware.camera.driver != VIRTUAL:
        return  # a folder has the exposures that it has, which is looked up before anything is opened
    low, high = EXPOSURE_RANGE_US
    for exposure in exposures:
        time_us = exposure * wiring.exposure_us
        if not low <= time_us <= high:
            yield (
                f"exposure {exposure:g} is {time_us:g} µs ({rig.source.at('camera', 'exposure_us')}), outside the "
                f"camera's {low:g} to {high:g} µs"
            )


def light_problems(
    rig: RigConfig, wiring: Wiring, lights: Iterable[str], *, on_s: float, taken: str
) -> Iterator[str]:
    """Lights above their highest level, or that would be on longer at a stretch [s] than they may for what is taken."""
    for name in lights:
        channel, top = wiring.light(name), wiring.top_level(name)
        where = rig.source.at("hardware", "lights", name)
        if channel.level > top:
            yield f"{where}: level {channel.level} is above the highest allowed, {top}"
        if channel.max_on_s is not None and on_s > channel.max_on_s:
            yield (
                f"{where}: would burn {on_s:.3g} s at a stretch (settling and {taken}), longer than max_on_s "
                f"{channel.max_on_s:g}; take fewer or shorter exposures"
            )
