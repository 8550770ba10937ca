"""The plan of a capture, as data: every move, every light and every exposure, checked before anything is opened."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import counted, refuse
from lightopt.core.transforms import Posture
from lightopt.rig.capture._wiring import VIRTUAL, Wiring, wiring_of
from lightopt.rig.simulated import EXPOSURE_RANGE_US
from lightopt.scene import angle_outside_range, part_postures, travel_order, travel_s

MOST_FRAMES = 1000  # frames that one image is the mean of, at most
StepKind = Literal["home", "move", "settle", "light on", "expose", "light off"]
_COMMAND_S = 0.03  # setting a light and reading it back: four short dialogues, measured with ccs
# from the end of an exposure to the frame being here: the virtual camera's noise, two bytes at 1 Gbit/s
_TRANSFER_S_PER_PIXEL = {"virtual": 80e-9, "folder": 10e-9, "aravis": 20e-9, "genicam": 20e-9}
_HOME = Posture(0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class CaptureOptions:
    """What to capture; InputError where a number is out of range or something is given twice."""

    lights: tuple[str, ...] | None = None  # instead of all lights of the rig
    postures: tuple[Posture, ...] | None = None  # instead of the part's own
    exposures: tuple[float, ...] = (1.0,)  # relative to the rig's camera.exposure_us; all under one light
    average: int = 1  # number of frames that each image is the mean of
    dark: bool = False  # whether frames without light are taken in every posture at every exposure, and subtracted
    home: bool = False  # whether the stage seeks its origin first
    check: bool = True  # whether each image is checked for being lit by the right light
    check_repeatability: bool = False  # whether the stage returns to its first posture, to detect lost steps
    seed: int | None = None  # of the virtual bench's noise, instead of the rig file's

    def __post_init__(self) -> None:
        refuse(self._problems())

    def _problems(self) -> Iterator[str]:
        if not self.exposures:
            yield "exposures: expected at least one, such as 1 or 1/16"
        for exposure in self.exposures:
            if not (math.isfinite(exposure) and exposure > 0.0):
                yield f"option 'exposures': expected numbers above 0, found {exposure:g}"
        for name in ("exposures", "lights", "postures"):
            values = getattr(self, name) or ()
            if len(set(values)) < len(values):
                yield f"option '{name}': the same one was given twice"
        if not 1 <= self.average <= MOST_FRAMES:
            yield f"option 'average': expected 1 to {MOST_FRAMES} frames, found {self.average}"

    def as_dict(self) -> dict[str, Any]:
        """What changes the files of the set, in JSON form."""
        numbers = {"exposures": list(self.exposures), "average": self.average}
        seed = {} if self.seed is None else {"seed": self.seed}
        return {**numbers, "dark": self.dark, "check": self.check, **seed}


@dataclass(frozen=True)
class PlanStep:
    kind: StepKind
    what: str  # its object: a posture, a light, an exposure
    seconds: float  # estimated duration [s]
    light: str | None = None  # which is on; None for none
    exposure: float | None = None  # relative

    def __str__(self) -> str:
        return f"{self.kind} {self.what}".rstrip()


@dataclass(frozen=True, kw_only=True)
class CapturePlan:
    wiring: Wiring
    options: CaptureOptions
    postures: tuple[Posture, ...]  # in the order of travel
    lights: tuple[str, ...]  # lit one after the other in each posture
    exposures: tuple[float, ...]  # relative, the longest first; of all images
    exposures_of: Mapping[str, tuple[float, ...]]  # those of each light, the longest first
    home: bool  # whether the stage seeks its origin first
    pixels: int  # number of pixels of a frame

    def exposure_us(self, exposure: float) -> float:
        return exposure * self.wiring.exposure_us

    @property
    def keys(self) -> tuple[tuple[str, Posture, float], ...]:
        """Light, posture and exposure of every image, in the order of capture."""
        images = [(light, exposure) for light in self.lights for exposure in self.exposures_of[light]]
        return tuple((light, posture, exposure) for posture in self.postures for light, exposure in images)

    @property
    def dark_exposures(self) -> tuple[float, ...]:
        """Exposures of the set's frames without light, the same in each posture."""
        return self.exposures if self.options.dark else ()

    @property
    def needs_dark_reference(self) -> bool:
        """Whether frames without light are taken first, only to check the others against."""
        return self.options.check and not self.options.dark

    def on_s(self, light: str) -> float:
        """How long a light is on at a stretch [s]: settling and all its exposures."""
        screens_s = sum(map(self.wiring.settle_s, self.wiring.levels(light)))
        return screens_s + self._light_settle_s + sum(map(self.frames_s, self.exposures_of[light]))

    @property
    def _light_settle_s(self) -> float:
        return self.wiring.hardware.timing.light_ms / 1e3

    def steps(self) -> Iterator[PlanStep]:
        """All steps in order, as if nothing had been taken yet."""
        yield from self._start()
        here = _HOME
        references = self.exposures if self.needs_dark_reference else ()
        for posture in self.postures:
            yield from self._arrive(here, posture)
            for exposure in (*self.dark_exposures, *references):
                yield self._expose(posture, None, exposure)
            for light in self.lights:
                yield from self._light(posture, light, self.exposures_of[light])
            if self.options.check:  # does one stay on?
                yield self._expose(posture, None, self.exposures[0])
            here, references = posture, ()
        if self.options.check_repeatability:
            yield from self._arrive(here, self.postures[0])
            yield from self._light(self.postures[0], self.lights[0], self.exposures_of[self.lights[0]][:1])

    def _start(self) -> Iterator[PlanStep]:
        for light in self.wiring.hardware.lights:
            yield PlanStep("light off", light, _COMMAND_S, light)
        if self.home:
            stage = self.wiring.hardware.stage
            axes = (stage.elevation, stage.rotation) if stage is not None else ()
            # how far the origin is, is unknown: at most one turn
            slowest = min((axis.speed_deg_per_s for axis in axes if axis is not None), default=1.0)
            yield PlanStep("home", "the stage, at most", 360.0 / slowest)

    def _arrive(self, here: Posture, posture: Posture) -> Iterator[PlanStep]:
        if self.wiring.hardware.stage is None:
            return
        yield PlanStep("move", f"to {posture}", _travel_s(self.wiring, here, posture))
        yield PlanStep("settle", "stage", self.wiring.hardware.timing.stage_ms / 1e3)

    def _light(self, posture: Posture, light: str, exposures: tuple[float, ...]) -> Iterator[PlanStep]:
        for name, level in self.wiring.levels(light).items():
            channel = self.wiring.light(name)
            what = f"{name} at level {level} ({channel.controller}, channel {channel.channel})"
            yield PlanStep("light on", what, _COMMAND_S + self.wiring.settle_s(name), light)
        yield PlanStep("settle", "light", self._light_settle_s, light)
        for exposure in exposures:
            yield self._expose(posture, light, exposure)
        for name in self.wiring.levels(light):
            yield PlanStep("light off", name, _COMMAND_S + self.wiring.settle_s(name), light)

    def _expose(self, posture: Posture, light: str | None, exposure: float) -> PlanStep:
        frames = f"{self.options.average} × " if self.options.average > 1 else ""
        what = f"{light or 'dark'} {posture} {frames}{self.exposure_us(exposure):g} µs (exposure {exposure:g})"
        return PlanStep("expose", what, self.frames_s(exposure), light, exposure)

    @property
    def relighting_s(self) -> float:
        """How long it takes to switch a light off and on again until it has settled [s]."""
        return 2 * _COMMAND_S + self._light_settle_s

    def frames_s(self, exposure: float) -> float:
        """How long the frames of an exposure take to be taken and transferred [s]."""
        transfer = self.pixels * _TRANSFER_S_PER_PIXEL[self.wiring.hardware.camera.driver]
        return self.options.average * (self.exposure_us(exposure) / 1e6 + transfer)

    def as_dict(self) -> dict[str, Any]:
        """What identifies this plan when a capture is resumed, in JSON form."""
        lights = self.wiring.hardware.lights
        return {
            **self.options.as_dict(),
            "lights": list(self.lights) if self.wiring.images else [light for light in lights if light in self.lights],
            "postures": sorted((posture.as_dict() for posture in self.postures), key=str),
            "levels": {name: channel.level for name, channel in lights.items()},
            "exposure_us": self.wiring.exposure_us,
            **({"images": self.wiring.images} if self.wiring.images else {}),
        }


def make_plan(rig: RigConfig, part: PartConfig, options: CaptureOptions | None = None) -> CapturePlan:
    """Plan a capture and check it against stage, lights and camera (InputError); nothing is opened."""
    options = options or CaptureOptions()
    wiring = wiring_of(rig)
    postures = options.postures or part_postures(part)
    known = [light.name for light in rig.lights]
    lights = options.lights or tuple(known)
    there = f"in {rig.source.path}; it has {', '.join(known)}"
    problems = [f'no light "{name}" {there}' for name in lights if name not in known]
    problems += _posture_problems(rig, part, wiring, options.postures)
    if options.check_repeatability and (wiring.hardware.stage is None or len(postures) < 2):
        problems.append("check of repeatability: expected a stage and two postures or more, to return from another")
    if options.seed is not None and not wiring.camera_is_virtual:
        problems.append("option 'seed': the rig's camera is a real one, whose noise has no seed; leave this out")
    exposures_of = {one: tuple(sorted(rig.exposures(one, options.exposures), reverse=True)) for one in known}
    exposures = tuple(sorted({e for name in lights for e in exposures_of.get(name, ())}, reverse=True))
    problems += exposure_problems(rig, wiring, exposures)
    refuse(problems)
    plan = CapturePlan(
        wiring=wiring,
        options=options,
        postures=tuple(travel_order(postures, start=_HOME, time=lambda a, b: _travel_s(wiring, a, b))),
        lights=tuple(name for name in known if name in lights),
        exposures=exposures,
        exposures_of=exposures_of,
        home=wiring.hardware.stage is not None and (options.home or wiring.stage_is_virtual),
        pixels=rig.camera.resolution_px[0] * rig.camera.resolution_px[1],
    )
    for image, name in [(one, name) for one in plan.lights for name in wiring.levels(one)]:
        longest_s, on_s = wiring.light(name).max_on_s, plan.on_s(image)
        taken = f"{counted(len(exposures_of[image]), 'exposure')} of {counted(options.average, 'frame')}"
        if longest_s is not None and on_s > longest_s:
            on = f"would be on for {on_s:.3g} s without a break (settling and {taken}), longer than max_on_s"
            where = rig.source.at("hardware", "lights", name)
            problems.append(f"{where}: {on} {longest_s:g}; take fewer or shorter exposures")
    refuse(problems)
    return plan


@dataclass(frozen=True, kw_only=True)
class CycleTime:
    """What capturing one part takes: images, and seconds from the first move to the last image."""

    images: int
    seconds: float
    virtual: bool  # times of the virtual bench, since the rig file has no hardware section

    def __str__(self) -> str:
        pace = ", at the speed of the virtual bench" * self.virtual
        return f"{counted(self.images, 'image')} in {self.seconds:.1f} s per part{pace}"


def cycle_time(rig: RigConfig, part: PartConfig, exposures: Mapping[Posture, tuple[float, ...]]) -> CycleTime:
    """What capturing one part takes, each posture at its relative exposures, in the order of least travel."""
    groups: dict[tuple[float, ...], list[Posture]] = {}
    for posture, own in exposures.items():
        groups.setdefault(own, []).append(posture)
    options = [CaptureOptions(postures=tuple(postures), exposures=own) for own, postures in groups.items()]
    plans = [make_plan(rig, part, one) for one in options]
    # lights are switched off and the stage is homed once, not for each part
    seconds = sum(step.seconds for plan in plans for step in plan.steps() if step.kind != "home")
    virtual = any(not plan.wiring.given for plan in plans)
    return CycleTime(images=sum(len(plan.keys) for plan in plans), seconds=seconds, virtual=virtual)


def _travel_s(wiring: Wiring, start: Posture, end: Posture) -> float:
    stage = wiring.hardware.stage
    return 0.0 if stage is None else travel_s(stage, start, end)


def _posture_problems(
    rig: RigConfig, part: PartConfig, wiring: Wiring, postures: Sequence[Posture] | None
) -> Iterator[str]:
    """Postures beyond the stage's range, or that a stage without one of the axes cannot take."""
    if postures is not None:
        named = [(posture, "option 'postures'") for posture in postures]
    else:
        named = [(posture, part.source.at("postures", i)) for i, posture in enumerate(part_postures(part))]
    stage = wiring.hardware.stage
    if stage is None and len(named) > 1:
        one = "one run captures one posture; place the part by hand and choose that one"
        yield f"{rig.source.at('hardware')}: this rig has no stage, so {one}; found {len(named)} postures"
    for posture, where in named:
        for name, angle in (("elevation", posture.elevation_deg), ("rotation", posture.rotation_deg)):
            if (problem := angle_outside_range(rig, name, angle)) is not None:
                yield f"{where}: {problem}"
            elif stage is not None and getattr(stage, name) is None and angle != 0.0:
                place = rig.source.at("hardware", "stage")
                yield f"{where}: {name} {angle:g}°, but the stage has no {name} axis, which is at 0° ({place})"


def exposure_problems(rig: RigConfig, wiring: Wiring, exposures: tuple[float, ...]) -> Iterator[str]:
    if wiring.hardware.camera.driver != VIRTUAL:
        return  # the exposures of a folder are checked when it is read, before anything is opened
    low, high = EXPOSURE_RANGE_US
    where = rig.source.at("camera", "exposure_us")
    for exposure in exposures:
        time_us = exposure * wiring.exposure_us
        if not low <= time_us <= high:
            yield f"exposure {exposure:g} is {time_us:g} µs ({where}), outside the camera's {low:g} to {high:g} µs"
