"""What a batch costs beside its commands, and what a second process gains: ``python -m benchmarks.batch``.

``python -m benchmarks.batch --plan`` measures the tasks of one plan over workers instead: seconds, and octets sent and
returned. They run in this process, one after the other. ``--large-plan`` runs a plan of 2,002 postures and 961
positions of each light with two workers, for more than an hour; its passes and their times are shown as they begin.

Else there are three measurements:

- tasks that do nothing but write a file, in this process and by one and two workers: what a task costs by itself, and
  what starting the workers costs;
- check and render (1600 × 1200 px, one posture, two exposures) of variants of the cover knob, one thread each: the
  commands one after the other without a batch, then batches in this process, by one worker and by two. Results are
  compared byte for byte;
- the same batch once more, when all is there, as a command of its own.

Times are seconds from the call to its end, the start of the processes included, and processor seconds of all processes,
which a busy machine changes less. The ways take turns; medians of the rounds are printed.
"""

from __future__ import annotations

import argparse
import pickle
import re
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

from benchmarks._case import CONFIGS, RIG
from lightopt.batch import Workers, _cluster, run_batch
from lightopt.batch._expand import expand
from lightopt.cli._batch import command_form, run_captured
from lightopt.core.run_context import RunContext

HEAD = """\
format: lightopt-batch/1
rigs: [{rig}]
parts: [parts]
jobs:
"""
CHECK = "  - {name: check, command: check}\n"
RENDER = '  - {name: images, command: render, needs: [check], options: {posture: "0,0", exposure: [1, 1/16]}}\n'
OF_THE_RUN = {"task.json", "terminal.txt", "summary.csv", "report.html"}
RunCommand = Callable[[list[str]], tuple[int, str, str]]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.batch", description=__doc__.partition("\n")[0])
    parser.add_argument("--parts", type=int, default=12, help="number of parts that are checked and rendered")
    parser.add_argument("--tasks", type=int, default=400, help="number of tasks that do nothing")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--plan", action="store_true", help="the tasks of one plan, and nothing else")
    parser.add_argument("--large-plan", action="store_true", help="a large plan with two workers, and nothing else")
    parser.add_argument("--posture-step", type=float, help="of these plans [°]; 45, of the large one 3.6")
    options = parser.parse_args()
    if options.large_plan:
        run_large_plan(options.posture_step or 3.6)
        return
    if options.plan:
        measure_plan(options.posture_step or 45.0)
        return
    with tempfile.TemporaryDirectory(prefix="lightopt-bench-") as name:
        measure_nothing(Path(name) / "nothing", options.tasks, options.rounds)
        measure_commands(Path(name) / "commands", options.parts, options.rounds)


class CountingPool:
    """In the place of processes: runs their tasks here, and notes what each takes and what it sends and returns."""

    def __init__(self) -> None:
        self.tasks: dict[str, list[tuple[float, int, int]]] = {}
        self.shared: dict[str, int] = {}

    def spread(
        self,
        function: Callable[..., Any],
        items: Sequence[Any],
        keep: Callable[[int, Any], None],
        *shared: Any,
        report: Any,
    ) -> None:
        """As :class:`lightopt.core.parallel.ProcessPool` has it."""
        own = [pickle.loads(content) for content in map(pickle.dumps, shared)]
        self.shared |= {type(one).__name__: len(pickle.dumps(one)) for one in shared if not callable(one)}
        name = next((one.__name__ for one in shared if callable(one)), function.__name__)
        for place, item in enumerate(items):
            begun = time.process_time()
            found = function(item, *own)
            seconds = time.process_time() - begun
            self.tasks.setdefault(name, []).append((seconds, len(pickle.dumps(item)), len(pickle.dumps(found))))
            keep(place, found)


def measure_plan(posture_step: float) -> None:
    """The tasks of a plan of the cover knob."""
    pool = CountingPool()

    @contextmanager
    def counting(_workers: Workers, run: RunContext) -> Iterator[RunContext]:
        yield run.spread_over(pool)

    part = CONFIGS / "parts" / "cover-knob.yaml"
    with tempfile.TemporaryDirectory() as out, mock.patch("lightopt.batch.other_processes", counting):
        words = ["optimize", str(RIG), str(part), "-o", out, "--no-images", "--no-report", "--patches", "20000"]
        words += ["--step", "15", "--choose-postures", "2", "--posture-step", f"{posture_step:g}", "--workers", "2"]
        status, _, error = run_captured(words)
        assert status == 0, error
    print(f"{'task':24} {'count':>6} {'seconds, median':>16} {'most':>6} {'octets sent':>12} {'returned':>10}")
    for name, found in pool.tasks.items():
        seconds, sent, returned = zip(*found, strict=True)
        middle = [statistics.median(one) for one in (seconds, sent, returned)]
        print(f"{name:24} {len(found):6} {middle[0]:16.3f} {max(seconds):6.2f} {middle[1]:12,.0f} {middle[2]:10,.0f}")
    print(f"octets that tasks share: {', '.join(f'{name} {size:,}' for name, size in pool.shared.items())}")


def run_large_plan(posture_step: float) -> None:
    """A plan of the cover knob as a command of its own, with everything that it says, and its time."""
    text = RIG.read_text(encoding="utf-8")
    text = text.replace("1600, 1200", "800, 600").replace("pixel_size_um: 4.4 ", "pixel_size_um: 8.8 ")
    text = text.replace("elevation_range_deg: [-45, 45]", "elevation_range_deg: [-36, 32.4]")
    for azimuth in (45, 135, 225, 315):
        own = f"azimuth_deg: {azimuth}, azimuth_range_deg: [{azimuth - 15}, {azimuth + 15}],"
        text = re.sub(rf"azimuth_deg: {azimuth},", own, text)
    with tempfile.TemporaryDirectory(prefix="lightopt-bench-") as name:
        rig, part = Path(name) / "rig.yaml", CONFIGS / "parts" / "cover-knob.yaml"
        rig.write_text(text, encoding="utf-8")
        words = ["--step", "1", "--posture-step", f"{posture_step:g}", "--choose-postures", "4", "--patches", "600"]
        words += ["--no-images", "--no-report", "--workers", "2", "-v", "-o", str(Path(name) / "plan")]
        command = [sys.executable, "-m", "lightopt", "optimize", str(rig), str(part), *words]
        seconds, _ = timed(lambda: subprocess.run(command, check=True))
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = used.ru_utime + used.ru_stime
    print(f"{seconds:.0f} s, {processor:.0f} s of processors, at most {used.ru_maxrss / 1e6:.1f} GB in a process")


def nothing(_words: list[str]) -> tuple[int, str, str]:
    """A command that does nothing."""
    return 0, "done\n", ""


def measure_nothing(folder: Path, count: int, rounds: int) -> None:
    """What tasks cost by themselves."""
    jobs = write_jobs(folder, count, HEAD + CHECK)
    single = write_jobs(folder / "single", 1, HEAD + CHECK)
    found: dict[str, list[tuple[float, float]]] = {}
    for _ in range(rounds):
        for number in (0, 1, 2):
            way = f"{number} workers" if number else "this process"
            for what, path in (("one task", single), ("all tasks", jobs)):
                used = timed(lambda path=path, number=number: run(path, folder / "out", number, nothing))
                found.setdefault(f"{way}, {what}", []).append(used)
                shutil.rmtree(folder / "out")
    print(f"tasks that do nothing: {count}")
    show(found, None)
    sizes = [len(pickle.dumps(task)) for task in expand(jobs, command_form, folder / "out", threads=1)]
    print(f"bytes of a task on the wire: {statistics.median(sizes):.0f}\n")


def measure_commands(folder: Path, parts: int, rounds: int) -> None:
    """Commands with and without a batch."""
    jobs, out = write_jobs(folder, parts, HEAD + CHECK + RENDER), folder / "out"
    ways: dict[str, Callable[[], object]] = {
        "commands without a batch": lambda: commands_alone(jobs, out),
        "batch, this process": lambda: run(jobs, out, 0, run_captured),
        "batch, one worker": lambda: run(jobs, out, 1, run_captured),
        "batch, two workers": lambda: run(jobs, out, 2, run_captured),
    }
    commands_alone(jobs, out)  # compiles, and fills the caches of files
    reference = contents(out)
    shutil.rmtree(out)
    found: dict[str, list[tuple[float, float]]] = {}
    for _ in range(rounds):
        for way, work in ways.items():
            found.setdefault(way, []).append(timed(work))
            assert contents(out) == reference, f"{way}: other results"
            if way == "batch, two workers":
                command = [sys.executable, "-m", "lightopt", "batch", str(jobs), "-o", str(out), "--quiet"]
                again = timed(lambda command=command: subprocess.run(command, check=True))
                found.setdefault("the command again, all is there", []).append(again)
            shutil.rmtree(out)
    print(f"check and render of {parts} parts; equal results")
    show(found, "commands without a batch")


def show(found: dict[str, list[tuple[float, float]]], other: str | None) -> None:
    """Print medians, and their ratios to another's."""
    medians = {way: [statistics.median(column) for column in zip(*some, strict=True)] for way, some in found.items()}
    for way, (wall, processors) in medians.items():
        ratio = "" if other is None else f"  ×{wall / medians[other][0]:.3f}, ×{processors / medians[other][1]:.3f}"
        print(f"{way:32} {wall:7.2f} s, {processors:7.2f} s of processors{ratio}", flush=True)


def write_jobs(folder: Path, parts: int, text: str) -> Path:
    """Variants of the cover knob and the batch file."""
    (folder / "parts").mkdir(parents=True)
    part = (CONFIGS / "parts" / "cover-knob.yaml").read_text(encoding="utf-8")
    shutil.copy(CONFIGS / "parts" / "cover-knob.step", folder / "parts")
    for number in range(parts):
        own = part.replace("R_d: 45.0", f"R_d: {45.0 + 0.01 * number}")
        assert number == 0 or own != part
        (folder / "parts" / f"part{number}.yaml").write_text(own, encoding="utf-8")
    path = folder / "jobs.yaml"
    path.write_text(text.replace("{rig}", str(RIG)), encoding="utf-8")
    return path


def run(jobs: Path, out: Path, number: int, run_command: RunCommand) -> None:
    """Run the batch in this process (0), or by so many workers."""
    if number == 1:  # one worker on its own is nothing that a user gets without asking for a scheduler
        with _cluster.local_cluster(1) as cluster:
            result = run_batch(
                jobs, out, command_form, run_command, workers=Workers(scheduler=cluster.scheduler_address)
            )
            show_memory(cluster)
    else:
        result = run_batch(jobs, out, command_form, run_command, workers=Workers(number=max(1, number)))
    assert result.count("done") == len(result.tasks), [one.messages for one in result.outcomes.values()]


def show_memory(cluster: object) -> None:
    """Print what the workers of a cluster needed at most."""
    for nanny in cluster.workers.values():  # type: ignore[attr-defined]
        status = Path(f"/proc/{nanny.pid}/status")
        if status.is_file():
            peak = next(line.split()[1] for line in status.read_text().splitlines() if line.startswith("VmHWM"))
            print(f"peak memory of a worker: {int(peak) / 1e6:.2f} GB", flush=True)


def commands_alone(jobs: Path, out: Path) -> None:
    """Run the same commands one after the other, into the same folders."""
    for task in expand(jobs, command_form, out, threads=1):
        words = [*map(str, task.command), *task.tail]
        if task.writes_folder:
            task.folder.parent.mkdir(parents=True, exist_ok=True)
            words += ["-o", str(task.folder)]
        status, _, error = run_captured(words)
        assert status == 0, error


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of the results, but those that say when and where they were made."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name not in OF_THE_RUN)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Seconds of a call, and processor seconds of this process and of those that it started and that ended."""
    begun, before = time.perf_counter(), _processor_seconds()
    work()
    return time.perf_counter() - begun, _processor_seconds() - before


def _processor_seconds() -> float:
    uses = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(use.ru_utime + use.ru_stime for use in uses)


if __name__ == "__main__":
    main()
