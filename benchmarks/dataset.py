"""Images per hour of ``lightopt dataset`` at 800 × 600 by two threads.

``python -m benchmarks.dataset [--parts cover-knob spout] [--per-pose 8] [--images 64] [--page]``. An image is one
light's, with noise, on disk as PNG; labels, masks and records are written, too. A row is a whole run from loaded rig
and part files, the set-up of the part and of its posture included.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks._case import write_records
from benchmarks.inspection import ROOT, replace_block
from benchmarks.loop import files
from lightopt import load_part, load_rig
from lightopt.config import RangesConfig
from lightopt.core.run_context import RunContext
from lightopt.dataset import DatasetOptions, make_dataset

THREADS = 2


@dataclass(frozen=True)
class Row:
    """One run."""

    part: str
    samples_per_pose: int
    fused: bool
    images: int
    seconds: float
    processor_seconds: float

    @property
    def per_hour(self) -> float:
        return 3600.0 * self.images / self.seconds

    @property
    def per_hour_alone(self) -> float:
        """With both processors to itself, by processor time."""
        return 3600.0 * self.images * THREADS / self.processor_seconds


def measure(folder: Path, name: str, *, samples: int, each: int, fused: bool, width: int) -> Row:
    rig_file, part_file = files(folder, name, width=width)
    rig, part = load_rig(rig_file), load_part(part_file)
    options = DatasetOptions(images=samples, seed=1, fusion="paper" if fused else None)
    ranges = RangesConfig(format="lightopt-ranges/1", samples_per_pose=each)
    begun, work = time.perf_counter(), time.process_time()
    out = folder / f"{name}-{each}-{fused}"
    done = make_dataset(rig, part, out, options=options, ranges=ranges, run=RunContext(threads=THREADS))
    row = Row(name, each, fused, done.images, time.perf_counter() - begun, time.process_time() - work)
    print(row, f"{row.per_hour:,.0f} images per hour", flush=True)
    return row


def table(rows: list[Row]) -> str:
    lines = [
        "| part | samples per pose | fused | images | seconds | processor seconds | images per hour | by processor |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        fused = "yes" if row.fused else "no"
        times = f"{row.seconds:.1f} | {row.processor_seconds:.1f} | {row.per_hour:,.0f} | {row.per_hour_alone:,.0f}"
        lines.append(f"| {row.part} | {row.samples_per_pose} | {fused} | {row.images} | {times} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--images", type=int, default=64, help="samples of each run")
    parser.add_argument("--parts", nargs="+", default=["cover-knob", "spout"])
    parser.add_argument("--per-pose", nargs="+", type=int, default=[8], help="samples of a pose")
    parser.add_argument("--width", type=int, default=800)
    parser.add_argument("--page", action="store_true", help="put the table into the page")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # what is compiled once is no work of a run
        measure(folder, given.parts[0], samples=1, each=1, fused=True, width=given.width)
        rows = [
            measure(folder, part, samples=given.images, each=each, fused=fused, width=given.width)
            for part in given.parts
            for each in given.per_pose
            for fused in (True, False)
        ]
    write_records(ROOT / "out" / "benchmarks" / "dataset.csv", rows)
    print(text := table(rows))
    if given.page:
        replace_block("dataset", text, page="performance.md")


if __name__ == "__main__":
    main()
