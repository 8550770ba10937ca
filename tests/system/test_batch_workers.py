"""``lightopt batch`` by real workers: what they compute is what one process computes, whoever is killed.

Rationale: a batch runs for hours on machines that fail; what is expected of each failure is that it costs the tasks
that were running, and that the rest, and the next run, are the same byte for byte.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import ClassVar

import dask.config
import pytest
from clusters import Cluster, kill_some
from distributed import LocalCluster
from distributed.core import Status

from lightopt.batch import Workers, _cluster, run_batch
from lightopt.cli._batch import command_form, run_captured
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and sessions of POSIX")

JOBS = """\
format: lightopt-batch/1
rigs: [rig.yaml]
parts: [parts]
jobs:
  - {name: check, command: check}
  - {name: images, command: render, needs: [check], options: {posture: "0,0", exposure: [1, 1/16], noise: 1}}
  - {name: fit, command: fit-diffuse, images_from: images, options: {pixels: 2000}}
  - {name: again, command: render, part_from: fit, options: {posture: "0,0"}}
"""
TASKS = 8
OF_THE_RUN = {"task.json", "terminal.txt", "summary.csv", "report.html"}


@pytest.fixture(scope="module")
def jobs(shared_bench) -> Path:
    parts = shared_bench.folder / "parts"
    parts.mkdir()
    shutil.copy(shared_bench.mesh, parts)
    text = shared_bench.part.read_text(encoding="utf-8")
    for number in range(2):
        own = text.replace("R_d: 45.0", f"R_d: {40.0 + number}")
        (parts / f"part{number}.yaml").write_text(own, encoding="utf-8")
    path = shared_bench.folder / "jobs.yaml"
    path.write_text(JOBS, encoding="utf-8")
    return path


def run(jobs: Path, name: str, **options):
    return run_batch(jobs, jobs.parent / name, command_form, run_captured, **options)


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file() and path.name not in OF_THE_RUN)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def reference(jobs) -> dict[str, bytes]:
    """What one process computes."""
    assert run(jobs, "alone").count("done") == TASKS
    return contents(jobs.parent / "alone")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory) -> Iterator[Cluster]:
    own = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        yield own
    finally:
        own.close()


@pytest.mark.slow
def test_killed_workers_lose_nothing(jobs, reference, cluster):
    workers = Workers(scheduler=cluster.address)
    result = run(jobs, "killed", workers=workers, run=kill_some(cluster, 1, seed=1))
    assert result.count("done", "kept") == TASKS
    assert contents(jobs.parent / "killed") == reference
    left = [path for path in (jobs.parent / "killed").rglob(".*") if path.is_dir()]
    assert not left
    begun = time.process_time()
    assert run(jobs, "killed", workers=workers).count("kept") == TASKS
    assert time.process_time() - begun < 2.0


@pytest.mark.slow
def test_workers_of_another_version_are_refused(jobs, cluster, monkeypatch):
    monkeypatch.setattr(_cluster, "computed_by", lambda: {"lightopt": "9.9"})
    with pytest.raises(InputError) as caught:
        run(jobs, "refused", workers=Workers(scheduler=cluster.address))
    assert 'lightopt: previously "9.9", now "0' in caught.value.messages[0]
    assert "install the same versions" in caught.value.messages[-1]
    assert not contents(jobs.parent / "refused")


def nobody_left(group: int) -> bool:
    """Whether all processes of a group end, if need be within a minute."""
    for _ in range(1200):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


@pytest.mark.slow
def test_ctrl_c_ends_the_processes_of_this_machine_and_the_same_command_continues(jobs, reference, cli):
    out = jobs.parent / "interrupted"
    command = [sys.executable, "-m", "lightopt", "batch", str(jobs), "-o", str(out), "--workers", "2"]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    while not list(out.rglob("task.json")):
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    said, error = process.communicate(timeout=300)
    assert process.returncode == 130, error
    assert "not run" in said
    assert error.splitlines()[0] == "the same command continues the batch"
    assert nobody_left(process.pid)
    assert not list(out.rglob(".*"))
    # the rest in this process, which saves the start of others
    done = cli("batch", jobs, "-o", out, "--workers", "1")
    assert (done.status, done.err) == (0, "")
    assert contents(out) == reference


# Slurm copies the script before sbatch ends, and Dask removes it then
SBATCH = """\
#!/bin/sh
cp "$1" "$0.job"
sh "$0.job" >"$0.log" 2>&1 &
echo "Submitted batch job $!"
"""
SCANCEL = """\
#!/bin/sh
kill "$1"
"""


@pytest.mark.slow
def test_workers_that_slurm_starts(jobs, tmp_path, monkeypatch):
    """A Slurm of this machine: its commands are doubles, and the job scripts are those that Slurm would get."""
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (tmp_path / name).write_text(text, encoding="utf-8")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    alone = jobs.with_name("check.yaml")
    lines = [line for line in JOBS.splitlines() if "name:" not in line or "check," in line]
    alone.write_text("\n".join(lines), encoding="utf-8")
    with dask.config.set({"jobqueue.slurm.cores": 1, "jobqueue.slurm.memory": "2GB"}):
        assert run(alone, "slurm", workers=Workers(system="slurm")).count("done") == 2


class LocalPods(LocalCluster):
    """Stand in for ``dask_kubernetes.operator.KubeCluster``: its pods are processes of this machine."""

    made: ClassVar[list[LocalPods]] = []

    def __init__(self, *, quiet: bool) -> None:
        assert quiet
        self.scaled = list[int]()
        super().__init__(
            n_workers=0,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address=None,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
            memory_limit=0,
        )
        self.made.append(self)

    def scale(self, n: int) -> None:
        self.scaled = [*self.scaled, n]
        super().scale(n)


@pytest.fixture
def kubernetes(monkeypatch) -> Workers:
    operator = ModuleType("dask_kubernetes.operator")
    operator.KubeCluster = LocalPods  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, operator.__name__, operator)
    monkeypatch.setattr(LocalPods, "made", [])
    return Workers(system="kubernetes", number=2)


@pytest.mark.slow
def test_workers_that_kubernetes_starts(jobs, reference, kubernetes):
    """Ctrl-C removes the pods and what they were writing, and the same call continues with others."""
    name = "kubernetes"

    def interrupted(_stage: str, _share: float) -> None:
        raise KeyboardInterrupt

    result = run(jobs, name, workers=kubernetes, run=RunContext(progress=interrupted))
    assert result.interrupted
    assert result.count("done") == 1
    result = run(jobs, name, workers=kubernetes)
    assert (result.count("done", "kept"), result.interrupted) == (TASKS, False)
    assert contents(jobs.parent / name) == reference
    assert not [path for path in (jobs.parent / name).rglob(".*") if path.is_dir()]
    assert [cluster.status for cluster in LocalPods.made] == [Status.closed, Status.closed]
    assert [cluster.scaled[0] for cluster in LocalPods.made] == [2, 2]


@pytest.mark.nightly
def test_workers_killed_twenty_times(jobs, reference, tmp_path_factory):
    killed = seed = 0
    while killed < 20:
        own, seed = Cluster(tmp_path_factory.mktemp("own")), seed + 1
        try:
            name = f"killed{seed}"
            most = min(TASKS - 1, 20 - killed)  # one as each task is completed, but for the last
            result = run(jobs, name, workers=Workers(scheduler=own.address), run=kill_some(own, most, seed=seed))
        finally:
            own.close()
        assert own.killed == most
        killed += own.killed
        assert result.count("done", "kept") == TASKS
        assert contents(jobs.parent / name) == reference
