"""Captures that suffer one fault each: ``python tests/hardware/faults.py``; renews docs/validation/reliability.md.

Every run is a capture of 8 images and 4 frames without light on the virtual bench, with the drivers and wires of a real
one. A run passes when it finishes with the images of an undisturbed run, or stops with an error that names the step,
with all lights off or the lights named that may burn, leaves a valid set, and `--resume` makes of it the images of an
undisturbed run.
"""

from __future__ import annotations

import argparse
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from itertools import zip_longest
from multiprocessing import get_context
from pathlib import Path

from fault_cases import BEDS, Case, driver_cases, line_cases, make_rig, other_cases, pulled_cases
from fault_runs import Outcome, differences, kill_sometime, suffer, undisturbed

from lightopt.core.errors import LightoptError
from lightopt.images import read_image_set

__all__ = ["Row", "main", "rows_of", "table"]

PAGE = Path(__file__).resolve().parents[2] / "docs" / "validation" / "reliability.md"
BEGIN, END = "<!-- faults: begin -->", "<!-- faults: end -->"
KILLED = "kill -9 at a random moment"


@dataclass
class Row:
    """Counts of one kind of fault: runs that it struck and missed, how the former ended, commands sent again."""

    runs: int = 0
    missed: int = 0
    finished: int = 0
    stopped: int = 0
    reported: int = 0
    retries: int = 0
    wrong: int = 0


def rows_of(outcomes: Iterable[Outcome]) -> dict[str, Row]:
    """Counts by kind of fault."""
    rows: dict[str, Row] = {}
    for outcome in outcomes:
        row = rows.setdefault(outcome.case.kind, Row())
        if not outcome.struck and not outcome.wrong:
            row.missed += 1
            continue
        row.runs += 1
        row.finished += outcome.finished
        row.stopped += not outcome.finished
        row.reported += outcome.lights == "told"
        row.retries += outcome.retries
        row.wrong += bool(outcome.wrong)
    return rows


def table(rows: dict[str, Row]) -> str:
    """Counts as Markdown."""
    lines = [
        (
            "| fault | runs | finished, same images | stopped, same after `--resume` "
            "| lights that may be on, named | commands sent again in finished runs "
            "| wrong | did not occur, not counted |"
        ),
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    total = Row(*(sum(getattr(row, name) for row in rows.values()) for name in vars(Row())))
    for name, row in {**rows, "**all**": total}.items():
        values = (row.runs, row.finished, row.stopped, row.reported, row.retries, row.wrong, row.missed)
        lines.append(f"| {name} | " + " | ".join(map(str, values)) + " |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Run the campaign and write the table."""
    parser = argparse.ArgumentParser(prog="python tests/hardware/faults.py", description=__doc__)
    parser.add_argument("--every", type=int, default=1, help="hit every so many-th message only")
    parser.add_argument("--most", type=int, help="so many faults at most, of every kind about as many")
    parser.add_argument("--kills", type=int, default=50, help="runs that are killed")
    parser.add_argument("--jobs", type=int, default=1, help="so many captures at a time: most of one is waiting")
    parser.add_argument("--page", type=Path, default=PAGE, help="Markdown page whose table is renewed")
    options = parser.parse_args(arguments)
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        outcomes = list(_campaign(Path(name), options.every, options.most, options.jobs))
        rows = rows_of(outcomes)
        rows[KILLED] = _kills(Path(name), options.kills)
    for outcome in outcomes:
        if outcome.wrong:
            print(outcome)
    text = table(rows)
    print(text)
    minutes = (time.monotonic() - begun) / 60
    most = "" if options.most is None else f" --most {options.most}"
    jobs = "" if options.jobs == 1 else f" --jobs {options.jobs}"
    command = f"python tests/hardware/faults.py --every {options.every}{most} --kills {options.kills}{jobs}"
    about = f"`{command}`, {minutes:.0f} minutes."
    page = options.page.read_text(encoding="utf-8")
    before, _, rest = page.partition(BEGIN)
    after = rest.partition(END)[2]
    options.page.write_text(f"{before}{BEGIN}\n{text}\n\n{about}\n{END}{after}", encoding="utf-8", newline="\n")
    return int(any(row.wrong for row in rows.values()))


def _spread(cases: list[Case], most: int) -> list[Case]:
    """At most so many cases, of every kind about as many."""
    kinds: dict[str, list[Case]] = {}
    for case in cases:
        kinds.setdefault(case.kind, []).append(case)
    rounds = zip_longest(*kinds.values())
    chosen = [case for turn in rounds for case in turn if case is not None][:most]
    return sorted(chosen, key=lambda case: list(kinds).index(case.kind))


def _campaign(folder: Path, every: int, most: int | None, jobs: int) -> Iterator[Outcome]:
    rigs = {stage: make_rig(folder / stage, stage) for stage in BEDS}
    counts = {stage: undisturbed(*rig, folder / f"truth-{stage}") for stage, rig in rigs.items()}
    deliveries, steps = counts["shot"]
    cases = [
        *line_cases(deliveries, every=every),
        *pulled_cases(deliveries, steps, every=every),
        *other_cases(),
        *driver_cases({stage: count for stage, (count, _) in counts.items()}),
    ]
    random.Random(2026).shuffle(cases)  # so that few of a kind are not all early ones
    if most is not None:
        cases = _spread(cases, most)
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        runs = [
            pool.submit(_one, case, *rigs[case.stage], folder / str(number), folder / f"truth-{case.stage}")
            for number, case in enumerate(cases)
        ]
        for number, _ in enumerate(as_completed(runs)):
            print(f"\r{number + 1} of {len(cases)}", end="", file=sys.stderr, flush=True)
        print(file=sys.stderr)
        yield from (run.result() for run in runs)


def _one(case: Case, rig: Path, part: Path, out: Path, truth: Path) -> Outcome:
    """One run, whose images are removed once they are compared."""
    try:
        outcome = suffer(case, rig, part, out, truth)
    except LightoptError as error:
        return Outcome(case, True, False, 0, str(error), "", (f"{type(error).__name__}: {error}",))
    shutil.rmtree(out, ignore_errors=True)
    return outcome


def _kills(folder: Path, count: int) -> Row:
    rig, part = make_rig(folder / "killed")
    command = [sys.executable, "-m", "lightopt", "capture", rig, part, "-q", "--exposure", "1,1/16", "--dark", "-o"]
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
