"""What a wrong form of the lobe costs an inspection of parts that reflect by GGX: one Gaussian lobe, and GGX.

``python -m benchmarks.model_inspection [--parts cover-knob spout] [--width 320] [--good 2 5 15] [--tests 6]``. The
simulated rig captures parts whose truth is GGX. Each form is fitted to one good part, and inspects good parts and parts
with random defects that the fit has not seen: by the model alone, and calibrated on the first of the good parts.
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks._case import write_records
from benchmarks.inspection import FIRST, ROOT, replace_block
from benchmarks.loop import OFF_MM, files, run_command
from lightopt import load_part, load_rig
from lightopt.config import PartConfig, RigConfig
from lightopt.images import ImageSet, read_image_set
from lightopt.inspection import Calibration, InspectOptions, PredictionCache, calibrate, evaluate_set, inspect_set
from lightopt.inspection.calibration._calibration import least_rate
from lightopt.rig.capture import CaptureOptions, CapturePlan, Devices, capture, connect_devices, wiring_of
from lightopt.rig.capture._wiring import start_bench
from lightopt.rig.simulated import BenchTruth
from lightopt.scene import place_defects

MODELS = ("torrance-sparrow", "ggx")
TRUTH = {"R_d": "30", "R_s": "9000", "alpha": "0.08"}
EXPOSURES = (1.0, 1 / 16)


@dataclass(frozen=True)
class Row:
    """A part, inspected by a fitted form of the lobe, with a calibration on so many good parts."""

    part: str
    model: str
    good: int
    rms: float
    false_alarms: int
    good_tests: int
    found: int
    placed: int


def as_ggx(path: Path) -> None:
    """Give a part file the reflectance that the captured parts have."""
    text = path.read_text(encoding="utf-8")
    inside = ", ".join(f"{key}: {value}" for key, value in TRUTH.items())
    text = re.sub(r"reflectance:.*?(?=\n\S|\Z)", f"reflectance: {{model: ggx, {inside}}}", text, flags=re.DOTALL)
    path.write_text(text, encoding="utf-8")


def take(rig: RigConfig, part: PartConfig, folder: Path, seed: int) -> ImageSet:
    """Capture a part on the simulated rig, off its place, at two exposures, with three rays a side of a pixel."""
    truth = BenchTruth(seed=seed, part_offset_mm=OFF_MM, rays=3)
    with start_bench(rig, wiring_of(rig), part=part, truth=truth) as bench:

        def connect(plan: CapturePlan) -> Devices:
            return connect_devices(rig, plan.wiring, part=part, plan=plan, bench=bench)

        options = CaptureOptions(postures=(FIRST,), exposures=EXPOSURES)
        capture(rig, part, folder, options=options, connect=connect)
    return read_image_set(folder)


def compare(folder: Path, name: str, options: argparse.Namespace) -> Iterator[Row]:
    """Rows of one part."""
    rig_file, part_file = files(folder, name, width=options.width)
    guess_text = part_file.read_text(encoding="utf-8")
    as_ggx(part_file)
    rig, truth = load_rig(rig_file), load_part(part_file)
    bad_files = [folder / f"{name}-bad-{seed}.yaml" for seed in range(1, options.bad + 1)]
    for seed, bad in enumerate(bad_files, 1):
        run_command("defects", rig_file, part_file, "--seed", seed, "--count", options.count, "-o", bad, "-q")
    shown = take(rig, truth, folder / f"{name}-shown", 1)
    learned = [take(rig, truth, folder / f"{name}-good-{i}", 100 + i) for i in range(max(options.good))]
    tests = [take(rig, truth, folder / f"{name}-test-{i}", 200 + i) for i in range(options.tests)]
    bads = [take(rig, load_part(bad), folder / f"{name}-bad-{i}", 300 + i) for i, bad in enumerate(bad_files)]
    for model in MODELS:
        guess, fitted = folder / f"{name}-guess.yaml", folder / f"{name}-{model}"
        guess.write_text(guess_text, encoding="utf-8")
        run_command(
            "fit-specular", rig_file, guess, shown.folder, "-o", fitted, "--joint", "--register", "--model", model,
            "--points", "4", "--no-validate", "-q",
        )  # fmt: skip
        part = load_part(fitted / "part.fitted.yaml")
        rms = json.loads((fitted / "fit.json").read_text(encoding="utf-8"))["quality"]["rms"]
        plain = InspectOptions(fusion=None, false_alarms=options.false_alarms)
        sets = (tests, bads, bad_files)
        yield _row(rig, part, truth, sets, plain, None, name, model, rms)
        for good in options.good:
            learning = InspectOptions(fusion=None, false_alarms=max(options.false_alarms, least_rate(good)))
            calibration = calibrate(rig, part, learned[:good], options=learning)
            yield _row(rig, part, truth, sets, learning, calibration, name, model, rms)


def _row(
    rig: RigConfig,
    part: PartConfig,
    truth: PartConfig,
    sets: tuple[list[ImageSet], list[ImageSet], list[Path]],
    inspection: InspectOptions,
    calibration: Calibration | None,
    name: str,
    model: str,
    rms: float,
) -> Row:
    tests, bads, bad_files = sets
    cache, false_alarms, found, placed = PredictionCache(), 0, 0, 0
    how: dict[str, Any] = {"options": inspection, "cache": cache, "calibration": calibration}
    for one in tests:
        result = inspect_set(rig, part, one, **how)
        false_alarms += evaluate_set(one, result, known=()).false_alarms
    for one, file in zip(bads, bad_files, strict=True):
        result = inspect_set(rig, part, one, **how)
        with_defects = truth.model_copy(update={"defects": load_part(file).defects})
        known = evaluate_set(one, result, known=place_defects(result.nominal, rig, with_defects))
        found += sum(defect.found for defect in known.defects)
        placed += len(known.defects)
    row = Row(
        part=name,
        model=model,
        good=0 if calibration is None else len(calibration.sets),
        rms=rms,
        false_alarms=false_alarms,
        good_tests=len(tests),
        found=found,
        placed=placed,
    )
    print(row, flush=True)
    return row


def table(rows: list[Row]) -> str:
    """The rows for a page."""
    lines = [
        "| part | inspected by | calibrated on | false alarms on good parts | defects found |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        good = f"{row.good} good parts" if row.good else "none"
        alarms = f"{row.false_alarms} on {row.good_tests}"
        lines.append(f"| {row.part} | {row.model} | {good} | {alarms} | {row.found} of {row.placed} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--parts", nargs="+", default=["cover-knob", "spout"])
    parser.add_argument("--width", type=int, default=320)
    parser.add_argument("--good", type=int, nargs="+", default=[2, 5, 15])
    parser.add_argument("--tests", type=int, default=6)
    parser.add_argument("--bad", type=int, default=2)
    parser.add_argument("--count", type=int, default=14)
    parser.add_argument("--false-alarms", type=float, default=0.05)
    parser.add_argument("--page", action="store_true", help="put the table into the page")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = [row for name in options.parts for row in compare(Path(folder), name, options)]
    write_records(ROOT / "out" / "benchmarks" / "model-inspection.csv", rows)
    text = table(rows)
    print(text)
    if options.page:
        replace_block("model-inspection", text)


if __name__ == "__main__":
    main()
