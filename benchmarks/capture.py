"""What a capture adds to settling, exposing and getting frames over: its overhead, on a warm virtual bench."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import yaml

from benchmarks._case import CONFIGS, RIG, Size
from benchmarks._report import Report, Table
from lightopt.config import PartConfig, RigConfig, load_part, load_rig
from lightopt.core.transforms import Posture
from lightopt.rig.capture import CaptureOptions, CapturePlan, Devices, Timing, capture, connect_devices, wiring_of
from lightopt.rig.capture._wiring import start_bench
from lightopt.rig.simulated import BenchProcess

TARGET = 0.15
"""Of settling, exposing and transfer; of one posture, in which no move hides anything."""

CASES = {
    "one exposure": CaptureOptions(postures=(Posture(0.0, 0.0),)),
    "two exposures": CaptureOptions(postures=(Posture(0.0, 0.0),), exposures=(1.0, 1 / 16)),
    "two exposures of 4 frames, dark": CaptureOptions(
        postures=(Posture(0.0, 0.0),), exposures=(1.0, 1 / 16), average=4, dark=True
    ),
}


def run(size: Size) -> Report:
    """Capture the cover knob under the four panels, at default times, on a bench that has rendered it already."""
    rows: list[list[str]] = []
    numbers: dict[str, object] = {}
    with tempfile.TemporaryDirectory(prefix="lightopt-bench-") as name:
        rig, part = _files(Path(name), size)
        with start_bench(rig, wiring_of(rig), part=part) as bench:
            _take(rig, part, Path(name) / "warm", CASES["one exposure"], bench)
            for case, options in CASES.items():
                best = min(
                    (_take(rig, part, Path(name) / f"{case}-{i}", options, bench) for i in range(min(3, size.repeats))),
                    key=_overhead,
                )
                numbers[case] = {**vars(best), "overhead": _overhead(best)}
                rows.append([case, *_cells(best)])
    header = (
        "",
        "open [s]",
        "move [s]",
        "settle [s]",
        "expose [s]",
        "transfer [s]",
        "lights [s]",
        "wait for disk [s]",
        "other [s]",
        "close [s]",
        "overhead",
        f"≤ {TARGET:.0%}",
    )
    notes = (
        "overhead: lights, disk and other, as a share of settle + expose + transfer; the least of the rounds",
        "a light settles from when its controller has the level, and is read back meanwhile",
        "opening (mesh, plan, devices), closing (lights off, devices) and moves count in neither",
        "disk: an image is judged, written and listed before the next exposure; settling hides it, a bracket does not",
    )
    return Report("capture", [Table(f"capture, {size.width} px wide", header, rows)], numbers, notes)


def _files(folder: Path, size: Size) -> tuple[RigConfig, PartConfig]:
    document = yaml.safe_load(RIG.read_text(encoding="utf-8"))
    scale = document["camera"]["resolution_px"][0] / size.width
    document["camera"]["resolution_px"] = [size.width, size.width * 3 // 4]
    document["camera"]["pixel_size_um"] *= scale
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    for name in ("cover-knob.yaml", "cover-knob.step"):
        shutil.copyfile(CONFIGS / "parts" / name, folder / name)
    return load_rig(path), load_part(folder / "cover-knob.yaml")


def _take(rig: RigConfig, part: PartConfig, folder: Path, options: CaptureOptions, bench: BenchProcess) -> Timing:
    def connect(plan: CapturePlan) -> Devices:
        return connect_devices(rig, plan.wiring, part=part, plan=plan, bench=bench)

    return capture(rig, part, folder, options=options, connect=connect).timing


def _overhead(timing: Timing) -> float:
    """Time beyond settling, exposing and transfer, as a share of these; without opening, closing and moves."""
    needed = timing.settling_s + timing.exposing_s + timing.transfer_s
    spent = timing.whole_s - timing.opening_s - timing.closing_s - timing.moving_s
    return (spent - needed) / needed if needed else 0.0


def _cells(timing: Timing) -> list[str]:
    *parts, closing_s = (value for name, value in vars(timing).items() if name != "whole_s")
    seconds = (*parts, timing.whole_s - sum(parts) - closing_s, closing_s)
    overhead = _overhead(timing)
    return [*(f"{value:.2f}" for value in seconds), f"{overhead:.1%}", "yes" if overhead <= TARGET else "no"]
