"""``lightopt optimize`` with workers: the plan is that of one process, whoever is killed.

Rationale: a plan of thousands of postures runs for hours on machines that fail. What a lost worker computed is computed
again, what it was sent is sent again, and the result is the same byte for byte.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import pytest
from clusters import Cluster, kill_some
from planned import prepared

from lightopt import design
from lightopt.batch import Workers, _cluster, other_processes
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and sessions of POSIX")


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def two(shared_bench, tmp_path_factory):
    return prepared(type(shared_bench).make(tmp_path_factory.mktemp("spread") / "bench"))


def plan(two, name: str, workers: Workers, run: RunContext) -> dict[str, bytes]:
    options = design.OptimizeOptions(step_deg=10.0, patch_budget=100, images=False)
    request = design.PlanOptions(choose_postures=2, posture_step_deg=45.0, exposures=(1 / 16,))
    folder = two.folder / name
    with other_processes(workers, run) as spread:
        result = design.optimize(two.rig, two.part, folder, options=options, plan=request, run=spread)
    # the processes have ended
    design.write_design(result, blind_pictures=None, run=run)
    return contents(folder)


@pytest.fixture(scope="module")
def reference(two) -> dict[str, bytes]:
    """What one process computes."""
    return plan(two, "alone", Workers(), RunContext(threads=1))


@pytest.mark.slow
def test_two_processes_of_this_machine(two, reference):
    assert plan(two, "two", Workers(number=2), RunContext()) == reference


@pytest.mark.slow
def test_killed_workers_lose_nothing(two, reference, tmp_path_factory):
    cluster = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        workers = Workers(scheduler=cluster.address)
        assert plan(two, "killed", workers, kill_some(cluster, 2, seed=1)) == reference
    finally:
        cluster.close()


def process_of(_item: int) -> int:
    time.sleep(0.05)
    assert "MALLOC_TRIM_THRESHOLD_" not in os.environ  # with which each array's memory is got anew
    return os.getpid()


@pytest.mark.slow
def test_a_posture_returns_to_the_process_that_has_its_images(monkeypatch):
    # Dask leaves it here where a test had a cluster of its own
    monkeypatch.delenv("MALLOC_TRIM_THRESHOLD_", raising=False)
    passes: list[dict[int, int]] = [{}, {}, {}]
    with other_processes(Workers(number=2), RunContext()) as run:
        assert run.pool is not None
        for one in passes:
            run.pool.spread(process_of, range(12), one.__setitem__, report=None)
    assert len(set(passes[0].values())) == 2
    for one in passes[1:]:
        assert sum(one[item] == passes[0][item] for item in range(12)) >= 10  # an idle one may take the last


@pytest.mark.slow
def test_workers_of_another_version_are_refused(two, monkeypatch):
    monkeypatch.setattr(_cluster, "computed_by", lambda: {"lightopt": "9.9"})
    with pytest.raises(InputError) as caught:
        plan(two, "refused", Workers(number=2), RunContext())
    assert 'lightopt: previously "9.9", now "0' in caught.value.messages[0]
    assert not (two.folder / "refused").exists()


@pytest.mark.slow
def test_an_exception_ends_the_workers_of_this_machine(two):
    def stop(stage: str, share: float) -> None:
        if share > 0.2:
            raise KeyboardInterrupt

    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        plan(two, "stopped", Workers(number=2), RunContext(progress=stop))
    assert time.monotonic() - begun < 120.0


@pytest.mark.nightly
def test_workers_killed_ten_times(two, reference, tmp_path_factory):
    for seed in range(2):
        cluster = Cluster(tmp_path_factory.mktemp("own"))
        try:
            found = plan(two, f"killed{seed}", Workers(scheduler=cluster.address), kill_some(cluster, 10, seed=seed))
        finally:
            cluster.close()
        assert cluster.killed == 10
        assert found == reference
