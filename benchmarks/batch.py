"""What a batch costs beside its commands, and what more processes gain: ``python -m benchmarks.batch``.

The commands check, render (1600 × 1200 px, one posture, two exposures) and optimize (5° steps, one posture) on variants
of the cover knob, each with one thread:

- one after the other in one process, without a batch;
- as a batch in one process;
- as a batch by an embedded Dask cluster of one worker and of two;
- once more, when all is there.

All results are compared byte for byte. Printed are medians over rounds in which the ways take turns: seconds from the
call to its end, the start of the processes included, and processor seconds of all processes, which a busy machine
changes less.
"""

from __future__ import annotations

import argparse
import pickle
import resource
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks._case import CONFIGS, RIG
from lightopt.batch import BatchResult, Workers, _schedule, run_batch
from lightopt.batch._expand import expand
from lightopt.cli._batch import command_form, run_captured
from lightopt.config import load_batch

JOBS = """\
format: lightopt-batch/1
rigs: [{rig}]
parts: [parts]
jobs:
  - {{name: check, command: check}}
  - {{name: images, command: render, needs: [check], options: {{posture: "0,0", exposures: [1, 1/16]}}}}
  - {{name: best, command: optimize, needs: [check], options: {{posture: "0,0", step: 5, images: false}}}}
"""
OF_THE_RUN = {"task.json", "terminal.txt", "summary.csv", "report.html"}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.batch", description=__doc__.partition("\n")[0])
    parser.add_argument("--parts", type=int, default=12, help="number of parts")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="lightopt-bench-") as name:
        measure(Path(name), options.parts, options.rounds)


def measure(folder: Path, parts: int, rounds: int) -> None:
    """Run all ways in turn, and print what they took."""
    jobs = write_jobs(folder, parts)
    ways: dict[str, Callable[[Path], object]] = {
        "commands without a batch": lambda out: commands_alone(jobs, out),
        "batch, this process": lambda out: run(jobs, out, Workers()),
        "batch, one worker": lambda out: by_workers(jobs, out, 1),
        "batch, two workers": lambda out: by_workers(jobs, out, 2),
    }
    run(jobs, folder / "warm", Workers())
    taken: dict[str, list[tuple[float, float]]] = {way: [] for way in [*ways, "batch, all is there"]}
    reference = contents(folder / "warm")
    for _ in range(rounds):
        for way, work in ways.items():
            out = folder / "out"
            taken[way].append(timed(lambda work=work, out=out: work(out)))
            assert contents(out) == reference, f"{way}: other results"
            if way == "batch, two workers":
                taken["batch, all is there"].append(timed(lambda out=out: run(jobs, out, Workers(number=2))))
            shutil.rmtree(out)
    print(f"{parts} parts, {3 * parts} tasks, {rounds} rounds")
    ways_alone = [statistics.median(column) for column in zip(*taken["commands without a batch"], strict=True)]
    for way, found in taken.items():
        own = [statistics.median(column) for column in zip(*found, strict=True)]
        wall, cpu = (f"{one:7.2f} s (×{one / other:.3f})" for one, other in zip(own, ways_alone, strict=True))
        print(f"{way:28} {wall}, processors {cpu}")
    tasks = expand(load_batch(jobs), command_form, folder / "out", threads=1)
    sizes = [len(pickle.dumps(task)) for task in tasks]
    print(f"bytes of a task on the wire: {statistics.median(sizes):.0f}")


def write_jobs(folder: Path, parts: int) -> Path:
    """Variants of the cover knob and the batch file."""
    (folder / "parts").mkdir()
    text = (CONFIGS / "parts" / "cover-knob.yaml").read_text(encoding="utf-8")
    shutil.copy(CONFIGS / "parts" / "cover-knob.step", folder / "parts")
    for number in range(parts):
        own = text.replace("R_d: 45.0", f"R_d: {45.0 + 0.1 * number}")
        assert number == 0 or own != text
        (folder / "parts" / f"part{number}.yaml").write_text(own, encoding="utf-8")
    path = folder / "jobs.yaml"
    path.write_text(JOBS.format(rig=RIG), encoding="utf-8")
    return path


def run(jobs: Path, out: Path, workers: Workers) -> BatchResult:
    """Run the batch."""
    result = run_batch(load_batch(jobs), out, command_form, run_captured, workers=workers)
    assert result.count("done", "kept") == len(result.tasks), [one.messages for one in result.outcomes.values()]
    return result


def by_workers(jobs: Path, out: Path, number: int) -> None:
    """Run the batch by an embedded cluster, of one worker as well, and print what its workers needed."""
    if number > 1:
        run(jobs, out, Workers(number=number))
        return
    with _schedule._local_cluster(number) as cluster:
        run(jobs, out, Workers(scheduler=cluster.scheduler_address))
        for nanny in cluster.workers.values():
            status = Path(f"/proc/{nanny.pid}/status")
            if status.is_file():
                peak = next(line.split()[1] for line in status.read_text().splitlines() if line.startswith("VmHWM"))
                print(f"peak memory of a worker: {int(peak) / 1e6:.2f} GB", flush=True)


def commands_alone(jobs: Path, out: Path) -> None:
    """Run the same commands one after the other, into the same folders."""
    for task in expand(load_batch(jobs), command_form, out, threads=1):
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
