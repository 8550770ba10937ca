"""Captures that suffer faults, one each; renews the table of docs/reliability.md: ``python -m benchmarks.faults``.

Every run is a capture of 8 images and 4 frames without light on the virtual bench, with the drivers and wires of a real
one. A run passes when it finishes with the images of an undisturbed run, or stops with an error that names the step,
with all lights off or the lights named that may burn, leaves a valid set, and `--resume` makes of it the images of an
undisturbed run.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks._fault_cases import line_cases, make_rig, other_cases, pulled_cases
from benchmarks._fault_runs import Outcome, differences, kill_sometime, suffer, undisturbed
from lightopt.errors import LightoptError
from lightopt.images import read_image_set

__all__ = ["Row", "main", "rows_of", "table"]

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reliability.md"
BEGIN, END = "<!-- faults: begin -->", "<!-- faults: end -->"
KILLED = "kill -9 at a random moment"


@dataclass
class Row:
    """Counts of one kind of fault: runs, how they ended, and commands sent again."""

    runs: int = 0
    finished: int = 0
    stopped: int = 0
    told: int = 0
    retries: int = 0
    wrong: int = 0


def rows_of(outcomes: Iterable[Outcome]) -> dict[str, Row]:
    """Counts by kind of fault."""
    rows: dict[str, Row] = {}
    for outcome in outcomes:
        row = rows.setdefault(outcome.case.kind, Row())
        row.runs += 1
        row.finished += outcome.finished
        row.stopped += not outcome.finished
        row.told += outcome.lights == "told"
        row.retries += outcome.retries
        row.wrong += bool(outcome.wrong)
    return rows


def table(rows: dict[str, Row]) -> str:
    """Counts as Markdown."""
    lines = [
        (
            "| fault | runs | finished, same images | stopped, same after `--resume` "
            "| lights that may burn, named | commands sent again in finished runs | wrong |"
        ),
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    total = Row(*(sum(getattr(row, name) for row in rows.values()) for name in vars(Row())))
    for name, row in {**rows, "**all**": total}.items():
        values = (row.runs, row.finished, row.stopped, row.told, row.retries, row.wrong)
        lines.append(f"| {name} | " + " | ".join(map(str, values)) + " |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Run the campaign and write the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults", description=__doc__)
    parser.add_argument("--every", type=int, default=1, help="hit every so many-th message only")
    parser.add_argument("--kills", type=int, default=50, help="runs that are killed")
    parser.add_argument("--page", type=Path, default=PAGE, help="Markdown page whose table is renewed")
    options = parser.parse_args(arguments)
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        outcomes = list(_campaign(Path(name), options.every))
        rows = rows_of(outcomes)
        rows[KILLED] = _kills(Path(name), options.kills)
    for outcome in outcomes:
        if outcome.wrong:
            print(outcome)
    text = table(rows)
    print(text)
    minutes = (time.monotonic() - begun) / 60
    about = f"`python -m benchmarks.faults --every {options.every} --kills {options.kills}`, {minutes:.0f} minutes."
    page = options.page.read_text(encoding="utf-8")
    before, _, rest = page.partition(BEGIN)
    after = rest.partition(END)[2]
    options.page.write_text(
        f"{before}{BEGIN}\n{text}\n\n{about}\n{END}{after}", encoding="utf-8", newline="\n"
    )
    return int(any(row.wrong for row in rows.values()))


def _campaign(folder: Path, every: int) -> Iterator[Outcome]:
    rigs = {stage: make_rig(folder / stage, stage) for stage in ("shot", "grbl")}
    counts = {stage: undisturbed(*rig, folder / f"truth-{stage}") for stage, rig in rigs.items()}
    deliveries, steps = counts["shot"]
    cases = [
        *line_cases(deliveries, every=every),
        *pulled_cases(deliveries, steps, every=every),
        *other_cases(),
    ]
    for number, case in enumerate(cases):
        print(f"\r{number + 1} of {len(cases)}", end="", file=sys.stderr, flush=True)
        out, truth = folder / str(number), folder / f"truth-{case.stage}"
        try:
            yield suffer(case, *rigs[case.stage], out, truth)
        except LightoptError as error:
            yield Outcome(case, True, False, 0, str(error), "", (f"{type(error).__name__}: {error}",))
    print(file=sys.stderr)


def _kills(folder: Path, count: int) -> Row:
    rig, part = make_rig(folder / "killed")
    command = [
        sys.executable,
        "-m",
        "lightopt",
        "capture",
        rig,
        part,
        "-q",
        "--exposures",
        "1,1/16",
        "--dark",
        "-o",
    ]
    subprocess.run([*command, folder / "whole"], check=True)
    moments, row = random.Random(1), Row()
    for number in range(count):
        out = folder / f"kill-{number}"
        killed = kill_sometime([*map(str, command), str(out)], out, moments)
        row.runs += 1
        row.finished += not killed
        row.stopped += killed
        try:
            if (out / "manifest.json").exists():
                read_image_set(out)
            subprocess.run([*command, out, "--resume"], check=True)
            row.wrong += bool(differences(out, folder / "whole"))
        except (LightoptError, subprocess.CalledProcessError) as error:
            print(error)
            row.wrong += 1
    return row


if __name__ == "__main__":
    sys.exit(main())
