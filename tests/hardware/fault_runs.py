"""One capture that suffers one fault: how it ends, whether the lights are off, and what resuming makes of it."""

from __future__ import annotations

import random
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fault_cases import Case
from faulty_bench import set_fault, with_faults

from lightopt.config import load_part, load_rig
from lightopt.core.errors import HardwareError
from lightopt.images import ImageEntry, ImageSet, read_exr, read_image_set, read_png
from lightopt.rig.capture import CaptureOptions, CapturePlan, Devices, capture, connect_devices
from lightopt.rig.capture._wiring import start_bench
from lightopt.rig.simulated import BenchProcess

__all__ = ["OPTIONS", "Outcome", "Steps", "alike", "differences", "kill_sometime", "suffer", "undisturbed"]

STATES = ("dark", "lit", "deaf", "alarm")
"""Faults that hold from the moment when they are set."""

OPTIONS = CaptureOptions(exposures=(1.0, 1 / 16), dark=True)


@dataclass(frozen=True)
class Outcome:
    """How a run with a fault ended.

    Attributes
    ----------
    case
        The fault.
    struck
        Whether the fault came to bear, as the bench says; a run without is not counted.
    finished
        Whether the run took all images.
    retries
        Commands sent again.
    message
        The error otherwise.
    lights
        ``off``, ``told`` (may be lit, and the message says so) or ``LIT``.
    wrong
        What is not as it must be; empty for a run that ended well.
    """

    case: Case
    struck: bool
    finished: bool
    retries: int
    message: str
    lights: str
    wrong: tuple[str, ...]


class Steps:
    """Counts the steps that devices are at, and does something at one of them."""

    def __init__(self, at: int | None, action: Callable[[], None]) -> None:
        self.count = 0
        self._at = at
        self._action = action

    def watch(self, devices: Devices) -> None:
        steps = self

        class Watched(type(devices)):
            @property
            def step(self) -> str:
                return self.__dict__["_step"]

            @step.setter
            def step(self, text: str) -> None:
                self.__dict__["_step"] = text
                if steps.count == steps._at:
                    steps._action()
                steps.count += 1

        text = devices.__dict__.pop("step")
        devices.__class__ = Watched
        devices.step = text


def undisturbed(rig: Path, part: Path, folder: Path) -> tuple[dict[str, int], int]:
    """Capture without a fault; returns messages by device and the number of steps."""
    loaded_rig, loaded_part = load_rig(rig), load_part(part)
    found: dict[str, int] = {}
    counted: list[Steps] = []

    def connect(plan: CapturePlan) -> Devices:
        with with_faults():
            bench = start_bench(loaded_rig, plan.wiring, part=loaded_part)
        devices = connect_devices(loaded_rig, plan.wiring, part=loaded_part, plan=plan, bench=bench)
        counted.append(Steps(None, bench.kill))
        counted[0].watch(devices)

        def close() -> None:
            found.update(bench.state()["deliveries"])
            bench.close()

        devices._closing = (close,)
        return devices

    capture(loaded_rig, loaded_part, folder, options=OPTIONS, connect=connect)
    return found, counted[0].count


def suffer(case: Case, rig: Path, part: Path, folder: Path, truth: Path) -> Outcome:
    """Capture with a fault, resume without, and compare with an undisturbed set."""
    loaded_rig, loaded_part = load_rig(rig), load_part(part)
    benches: list[BenchProcess] = []

    def connect(plan: CapturePlan) -> Devices:
        with with_faults():
            bench = start_bench(loaded_rig, plan.wiring, part=loaded_part)
        benches.append(bench)
        bench.request("camera")  # the scene is built, so that steps take the same time in every run
        devices = connect_devices(loaded_rig, plan.wiring, part=loaded_part, plan=plan, bench=bench)
        if case.device is not None:
            set_fault(bench, case.device, case.fault, **case.options)
        else:
            Steps(case.step, bench.kill).watch(devices)
        return devices

    message, retries, finished = "", 0, False
    wrong: list[str] = []
    try:
        done = capture(loaded_rig, loaded_part, folder, options=OPTIONS, connect=connect)
        retries, finished = done.retries, True
    except HardwareError as error:
        message = str(error)
    lights = _lights(benches[0], case, message)
    struck = _struck(benches[0], case)
    benches[0].close()
    if lights == "LIT":
        wrong.append("a light is on and not reported")
    if not finished and "while " not in message:
        wrong.append("the message names no step")
    if (folder / "manifest.json").exists():
        read_image_set(folder)  # raises where the set is not valid
    if finished:
        wrong += [f"finished, but {difference}" for difference in differences(folder, truth)]
    else:
        capture(loaded_rig, loaded_part, folder, options=OPTIONS, resume=True)
        wrong += [f"resumed, but {difference}" for difference in differences(folder, truth)]
    return Outcome(case, struck, finished, retries, message, lights, tuple(wrong))


def kill_sometime(command: list[str], out: Path, moments: random.Random) -> bool:
    """Start a command and kill -9 it at a random moment: while it starts, or once it has written so many PNG files.

    Returns
    -------
    bool
        Whether it was still running.
    """
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    files = moments.randrange(-2, 13)
    end = time.monotonic() + (moments.uniform(0.0, 2.0) if files < 0 else 60.0)
    while time.monotonic() < end and process.poll() is None:
        if files >= 0 and (out / "manifest.json").exists() and len(list(out.rglob("*.png"))) >= files:
            time.sleep(moments.uniform(0.0, 0.05))
            break
        time.sleep(0.001)
    running = process.poll() is None
    process.kill()
    process.wait()
    return running


def _struck(bench: BenchProcess, case: Case) -> bool:
    if case.fault in STATES:
        return True
    try:
        return bool(bench.state()["struck"])
    except HardwareError:
        return case.device is None  # killed, as it should be


def _lights(bench: BenchProcess, case: Case, message: str) -> str:
    reported = "may still be lit" in message
    try:
        levels = bench.levels("lights")
    except HardwareError:
        return "told" if reported else "off"  # nothing burns on a bench that is not there
    # a lamp that burns whatever its controller says can only be found, not helped
    burning = [channel for channel, level in levels.items() if level and case.fault != "lit"]
    if not burning:
        return "off"
    return "told" if reported else "LIT"


def differences(folder: Path, truth: Path) -> list[str]:
    """Say where the images of two sets differ; times and devices may."""
    new, old = read_image_set(folder), read_image_set(truth)
    if [entry.key for entry in new.images] != [entry.key for entry in old.images]:
        return [f"the images are {[str(e.key) for e in new.images]}"]
    found: list[str] = []
    for a, b in zip(new.images, old.images, strict=True):
        found += _differing(new, a, old, b)
    dark = (name for name in old.manifest.files if name.endswith(".png"))
    return found + [
        f"{name} differs" for name in dark if not np.array_equal(read_png(new.path(name)), read_png(old.path(name)))
    ]


def alike(folder: Path, truth: Path) -> int:
    """Count the images of a set that are the same in another."""
    new, old = read_image_set(folder), read_image_set(truth)
    known = {entry.key: entry for entry in old.images}
    return sum(a.key in known and not _differing(new, a, old, known[a.key]) for a in new.images)


def _differing(new: ImageSet, a: ImageEntry, old: ImageSet, b: ImageEntry) -> list[str]:
    found: list[str] = []
    if not np.array_equal(read_png(new.path(a.png or "")), read_png(old.path(b.png or ""))):
        found.append(f"{a.png} differs")
    one, other = read_exr(new.path(a.exr or "")), read_exr(old.path(b.exr or ""))
    if any(not np.array_equal(one[name], other[name]) for name in ("Y", "valid", "exposure")):
        found.append(f"{a.exr} differs")
    return found
