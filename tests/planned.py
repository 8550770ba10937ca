"""A small plan of postures, lights and exposures, which takes long enough to be made once for all workers."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from lightopt.cli._main import run

LIGHTS = """\
lights:
  - {name: light1, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45, elevation_range_deg: [50, 60]}
  - {name: light2, distance_mm: 330, elevation_deg: 50, azimuth_deg: 225, elevation_range_deg: [40, 50]}
"""
CATALOGUE = """\
defect_catalogue:
  - {name: dent, kind: dent, size_mm: 0.6, slope_deg: 4}
  - {name: stain, kind: stain, size_mm: 1.5, R_d_factor: 0.7}
"""
FEW = ("--patches", "100", "--step", "10", "--no-images")
PLAN = (
    *FEW,
    *("--choose-postures", "2", "--posture-step", "90", "--exposure", "1,1/16"),
    *("--light-tolerance", "4", "--pose-tolerance", "1"),
    *("--objective", "detectability", "--objective", "coverage"),
)
LONGEST_S = 600.0


def prepared(bench):
    """A bench whose lights move, and a part with a catalogue of defects."""
    head, rest = bench.rig.read_text(encoding="utf-8").split("lights:\n", 1)
    text = head + LIGHTS + rest[rest.index("stage:") :]
    bench.rig.write_text(text, encoding="utf-8", newline="\n")
    with bench.part.open("a", encoding="utf-8") as file:
        file.write(CATALOGUE)
    # tests want to see that comments stay, and what the two old postures become
    bench.edit("part.yaml", "postures: [", "# as before\npostures: [")
    return bench


def made_once(tmp_path_factory: pytest.TempPathFactory, bench_type):
    """The bench with its plan in `out`; one worker makes it, the others wait. Tests may add folders to it."""
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent
    folder, ended = shared / "planned", shared / "planned.status"
    try:
        folder.mkdir()
    except FileExistsError:
        _await(ended)
        bench = bench_type(folder)
    else:
        bench = prepared(bench_type.make(folder))
        status = 1
        try:
            status = run(["optimize", str(bench.rig), str(bench.part), "-o", str(bench.out), *PLAN])
        finally:
            ended.with_suffix(".writing").write_text(f"{status}")
            ended.with_suffix(".writing").replace(ended)
    assert ended.read_text() == "0"
    return bench


def _await(file: Path) -> None:
    until = time.monotonic() + LONGEST_S
    while not file.exists():
        assert time.monotonic() < until, f"no {file.name} after {LONGEST_S:g} s"
        time.sleep(0.1)
