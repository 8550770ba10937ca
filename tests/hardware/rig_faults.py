"""What a capture notices of a rig that fails, and how; renews a table of docs/validation/reliability.md.

``python tests/hardware/rig_faults.py``. Every run is a capture of 8 images and 4 frames without light with the GigE
camera of the virtual bench, behind its real driver, and one fault: of the camera, of a lamp, of the stage, of the
room, of the computer. A run is *wrong* when a light burns afterwards and nobody says so, when the error names no
step, when the set is not valid, or when `--resume` without the fault does not make of it the images of an undisturbed
run.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest import mock

from fault_cases import make_rig
from fault_runs import OPTIONS, Steps, differences
from faulty_bench import set_fault, with_faults

from lightopt.config import load_part, load_rig
from lightopt.core.errors import HardwareError, InputError, LightoptError
from lightopt.images import read_image_set
from lightopt.rig.capture import CapturePlan, Devices, capture, connect_devices
from lightopt.rig.capture._wiring import start_bench
from lightopt.rig.simulated import BenchProcess, BenchTruth

__all__ = ["RigCase", "Seen", "gige_rig", "main", "rig_cases", "table", "undergo"]

PAGE = Path(__file__).resolve().parents[2] / "docs" / "validation" / "reliability.md"
BEGIN, END = "<!-- rig faults: begin -->", "<!-- rig faults: end -->"

HOW = (
    "taken again, same images",
    "stopped, by reply",
    "stopped, by image",
    "with a warning",
    "harmless, same images",
    "not noticed",
)
BY_IMAGE = ("The image was not kept", "the frame without light looks like")


@dataclass(frozen=True)
class RigCase:
    """One fault: of a device, at a step of the plan or at once; of the room; or of this computer."""

    kind: str
    device: str | None = None
    fault: str = ""
    options: dict[str, Any] = field(default_factory=dict)
    step: int | None = None
    truth: BenchTruth | None = None
    dark: bool = True
    returns: bool = False
    here: Callable[[], contextlib.AbstractContextManager[object]] = contextlib.nullcontext


@dataclass(frozen=True)
class Seen:
    """How a run ended: one of `HOW`, frames and commands that were requested again, the message, and what is wrong."""

    case: RigCase
    how: str
    retries: int
    message: str
    wrong: tuple[str, ...]


def gige_rig(folder: Path) -> tuple[Path, Path]:
    """The small rig with the GigE camera, and its part."""
    rig, part = make_rig(folder)
    text = rig.read_text(encoding="utf-8")
    text = text.replace("camera: {driver: virtual}", "camera: {driver: aravis, port: virtual}")
    text = text.replace("stage_ms: 5}", "stage_ms: 5, frame_timeout_s: 3}")
    rig.write_text(text, encoding="utf-8", newline="\n")
    return rig, part


def rig_cases(moments: int) -> Iterator[RigCase]:
    """Each fault at so many moments of the run, evenly; what holds from the start once for each lamp.

    Parameters
    ----------
    moments
        How many.
    """
    frames = [round((i + 0.5) * 12 / moments) for i in range(moments)]  # of 12 frames and more
    camera = (
        ("camera: no frame comes, once", "lost", {}),
        ("camera: no frame comes, permanently", "lost", {"count": None}),
        ("camera: packets of a frame lost, once", "incomplete", {}),
        ("camera: packets of a frame lost, permanently", "incomplete", {"count": None}),
        ("camera: a frame has the number of the one before", "duplicate", {}),
        ("camera: a frame has a lower number than the one before", "order", {}),
        ("camera: a frame has an older time stamp", "stale", {}),
        ("camera: a frame has the image of the one before, and a new stamp", "old_image", {}),
        ("camera: hangs, and answers nothing", "hang", {}),
        ("camera: unplugged", "vanish", {}),
        ("camera: exposure halves by itself", "exposure", {"count": None}),
        ("camera: another pixel format, as after a power cycle", "format", {}),
    )
    for kind, fault, options in camera:
        for after in frames:
            yield RigCase(kind, "camera", fault, {**options, "after": after})
    for channel in (1, 2):
        yield RigCase("lamp stays dark", "lights", "dark", {"channel": channel})
        yield RigCase("lamp stays on", "lights", "lit", {"channel": channel})
        yield RigCase("lamp gives 80 % of its light", "lights", "aged", {"channel": channel, "share": 0.8})
    yield RigCase("plugs of two lamps swapped", "lights", "swapped", {"channel": 1, "other": 2})
    for level in (0.2, 2.0, 20.0):
        yield RigCase(
            f"ambient light of {level:g} grey levels, without --dark", truth=BenchTruth(ambient_level=level), dark=False
        )
    for returns in (False, True):
        with_it = ", with --check-repeatability" if returns else ""
        for when, step in (("first", 3), ("second", 39)):
            for kind, axis in (("tilted", "1"), ("turned", "2")):
                yield RigCase(
                    f"stage {kind} by 1° more than it says, from its {when} move on{with_it}",
                    "stage",
                    "lost_step",
                    {"axis": axis, "steps": 100},
                    step,
                    returns=returns,
                )
    for step in (round((i + 0.5) * 76 / moments) for i in range(moments)):  # of 76 of a run
        yield RigCase("power cycle of the light controller", "lights", "power_cycle", {}, step=step)
        yield RigCase("power cycle of the stage", "stage", "power_cycle", {}, step=step)
    for files in frames:
        yield RigCase("disk full", here=lambda files=files: _full_disk(files))
    for calls in frames:
        yield RigCase("clock set back by an hour", here=lambda calls=calls: _clock_back(calls))


def undergo(case: RigCase, rig: Path, part: Path, folder: Path, truth: Path) -> Seen:
    """Capture with a fault, resume without, and compare with an undisturbed set."""
    loaded_rig, loaded_part = load_rig(rig), load_part(part)
    benches: list[BenchProcess] = []

    def connect(plan: CapturePlan) -> Devices:
        with with_faults():
            bench = start_bench(loaded_rig, plan.wiring, part=loaded_part, truth=case.truth)
        benches.append(bench)
        devices = connect_devices(loaded_rig, plan.wiring, part=loaded_part, plan=plan, bench=bench)

        def strike() -> None:
            if case.device is not None:
                set_fault(bench, case.device, case.fault, **case.options)

        if case.step is None:
            strike()
        else:
            Steps(case.step, strike).watch(devices)
        return devices

    message, retries, reported, finished = "", 0, (), False
    wrong: list[str] = []
    options = replace(OPTIONS, dark=case.dark, check_repeatability=case.returns)
    with case.here():
        try:
            done = capture(loaded_rig, loaded_part, folder, options=options, connect=connect)
            retries, reported, finished = done.retries, done.warnings, True
        except (HardwareError, InputError) as error:
            message = str(error)
    burning = [channel for channel, level in benches[0].levels("lights").items() if level]
    benches[0].close()
    if burning and case.fault != "lit" and "may still" not in message:  # nobody can switch off a lamp that is stuck
        wrong.append(f"lights {burning} are on and not reported")
    if not finished and "while " not in message and not message.startswith(str(folder)):
        wrong.append("the message names no step")
    if (folder / "manifest.json").exists():
        read_image_set(folder)  # raises where the set is not valid
    differ = differences(folder, truth) if finished else []
    if not finished:
        capture(loaded_rig, loaded_part, folder, options=options, resume=True)
        wrong += [f"resumed, but {difference}" for difference in differences(folder, truth)]
    if finished and retries and differ:
        wrong.append(f"taken again, but {differ}")
    return Seen(
        case, _how(finished, message, retries, reported, differ), retries, message or "; ".join(reported), tuple(wrong)
    )


def _how(finished: bool, message: str, retries: int, reported: tuple[str, ...], differ: list[str]) -> str:
    if not finished:
        return HOW[2] if any(words in message for words in BY_IMAGE) else HOW[1]
    if retries:
        return HOW[0]
    if reported:
        return HOW[3]
    return HOW[5] if differ else HOW[4]


@contextlib.contextmanager
def _full_disk(after: int) -> Iterator[None]:
    """After so many files the disk takes no more."""
    real, left = os.fsync, [after]

    def fsync(descriptor: int) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(descriptor)

    with mock.patch("os.fsync", fsync):
        yield


@contextlib.contextmanager
def _clock_back(after: int) -> Iterator[None]:
    """After so many looks at the clock it is an hour earlier; the clock that only counts is what it was."""
    real, looks = time.time, [0]

    def now() -> float:
        looks[0] += 1
        return real() - (3600.0 if looks[0] > after else 0.0)

    with mock.patch("time.time", now):
        yield


def table(found: list[Seen]) -> str:
    """Counts as Markdown."""
    lines = ["| fault | runs | " + " | ".join(HOW) + " | repeats | wrong |", "|---|" + "---:|" * (len(HOW) + 3)]
    kinds = list(dict.fromkeys(seen.case.kind for seen in found))
    for kind in [*kinds, "**all**"]:
        some = [seen for seen in found if kind in ("**all**", seen.case.kind)]
        counts = [sum(seen.how == how for seen in some) for how in HOW]
        numbers = [len(some), *counts, sum(seen.retries for seen in some), sum(bool(seen.wrong) for seen in some)]
        lines.append(f"| {kind} | " + " | ".join(map(str, numbers)) + " |")
    return "\n".join(lines)


def renewed(old: str, new: str, kinds: list[str]) -> str:
    """The old table with the rows of the new one, in the order of `kinds`, and sums over all of them."""
    rows = {
        line.split(" | ")[0].removeprefix("| "): line
        for text in (old, new)
        for line in text.splitlines()
        if line.startswith("| ") and not line.startswith(("| fault", "| **all**"))
    }
    kept = [rows[kind] for kind in dict.fromkeys(kinds) if kind in rows]
    counts = [[int(n) for n in row.removesuffix(" |").split(" | ")[1:]] for row in kept]
    total = " | ".join(map(str, map(sum, zip(*counts, strict=True))))
    return "\n".join([*new.splitlines()[:2], *kept, f"| **all** | {total} |"])


def main(arguments: list[str] | None = None) -> int:
    """Run the campaign and write the table."""
    parser = argparse.ArgumentParser(prog="python tests/hardware/rig_faults.py", description=__doc__)
    parser.add_argument("--moments", type=int, default=3, help="how many moments of a run each fault strikes at")
    parser.add_argument("--only", help="regular expression: only faults of which the name has it; other rows stay")
    parser.add_argument("--page", type=Path, default=PAGE, help="Markdown page whose table is renewed")
    chosen = parser.parse_args(arguments)
    begun = time.monotonic()
    found: list[Seen] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rig, part = gige_rig(folder)
        for dark in (True, False):
            options = replace(OPTIONS, dark=dark)
            capture(load_rig(rig), load_part(part), folder / f"truth-{dark}", options=options)
        every = list(rig_cases(chosen.moments))
        cases = [case for case in every if chosen.only is None or re.search(chosen.only, case.kind)]
        for number, case in enumerate(cases):
            print(f"\r{number + 1} of {len(cases)}", end="", file=sys.stderr, flush=True)
            try:
                found.append(undergo(case, rig, part, folder / str(number), folder / f"truth-{case.dark}"))
            except LightoptError as error:
                found.append(Seen(case, HOW[1], 0, str(error), (f"{type(error).__name__}: {error}",)))
    print(file=sys.stderr)
    for seen in found:
        print(f"{seen.case.kind}: {seen.how}: {seen.message.splitlines()[0][:200] if seen.message else ''}")
        for wrong in seen.wrong:
            print(f"  WRONG: {wrong}")
    minutes = (time.monotonic() - begun) / 60
    only = "" if chosen.only is None else f' --only "{chosen.only}"'
    about = f"`python tests/hardware/rig_faults.py --moments {chosen.moments}{only}`, {minutes:.0f} minutes."
    page = chosen.page.read_text(encoding="utf-8")
    before, _, rest = page.partition(BEGIN)
    there, _, after = rest.partition(END)
    text = table(found)
    if chosen.only is not None:
        text = renewed(there, text, [case.kind for case in every])
        ran = [line for line in there.splitlines() if line.startswith("`python -m") and f"{only}`" not in line]
        about = "\n".join([*ran, about])
    print(text)
    chosen.page.write_text(f"{before}{BEGIN}\n{text}\n\n{about}\n{END}{after}", encoding="utf-8", newline="\n")
    return int(any(seen.wrong for seen in found))


if __name__ == "__main__":
    sys.exit(main())
