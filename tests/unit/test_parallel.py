"""Work spread over other processes: what a plan computes with them is what it computes alone.

The processes are doubles here; tests/system/test_plan_workers.py has real ones.
"""

from __future__ import annotations

import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from planned import FEW, prepared

from lightopt import design
from lightopt.batch import _pool
from lightopt.config import load_part, load_rig
from lightopt.core.errors import CheckFailed, InputError
from lightopt.core.parallel import spread
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.design.responses._pairs import PackedCounts, pack_counts, packed_bytes
from lightopt.rendering import panels_in_part
from lightopt.scene import build_scene


class PicklingPool:
    """A pool as processes are: all is pickled, tasks end in another order, and each is run twice."""

    def __init__(self):
        self.functions, self.largest = [], 0

    def spread(self, function, items, keep, *shared, report):
        sent = [pickle.dumps(one) for one in shared]
        values = [pickle.loads(one) for one in sent]
        names = [one.__name__ for one in values if callable(one) and hasattr(one, "__name__")]
        self.functions += names or [function.__name__]
        for place in reversed(range(len(items))):
            task = pickle.dumps((function, items[place]))
            self.largest = max(self.largest, len(task))
            for _ in range(2):
                own, item = pickle.loads(task)
                result = own(item, *values)
            keep(place, pickle.loads(pickle.dumps(result)))
            if report is not None:
                report(1.0 - place / len(items))


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture
def two(bench):
    return prepared(bench)


def planned(two, name, run, **plan):
    options = design.OptimizeOptions(step_deg=10.0, patch_budget=100, images=False)
    plan = {"choose_postures": 2, "posture_step_deg": 90.0, **plan}
    folder = two.folder / name
    result = design.optimize(two.rig, two.part, folder, options=options, plan=design.PlanOptions(**plan), run=run)
    design.write_design(result, blind_pictures=None, run=run)
    return contents(folder)


@pytest.mark.slow
@pytest.mark.parametrize("exposures", [(), (1 / 16,)])
def test_other_processes_change_no_plan(two, exposures):
    alone = planned(two, "alone", RunContext(threads=1), exposures=exposures)
    pool = PicklingPool()
    assert planned(two, "spread", RunContext(threads=1).spread_over(pool), exposures=exposures) == alone
    # pixels, faces and patches of postures, postures for lights, lights for postures, blind spots
    used = {"_masks_of_posture", "_seen_points", "_seen_patches", "_counts_of_row", "_packed_block", "_visibility_in"}
    assert set(pool.functions) == used
    assert pool.largest < 20_000, "octets of a task: a row of flags, no table"


@pytest.mark.slow
def test_a_target_that_is_not_reached_has_the_same_reasons(two):
    messages = []
    for run in (RunContext(threads=1), RunContext(threads=1).spread_over(PicklingPool())):
        with pytest.raises(CheckFailed) as caught:
            planned(two, f"missed{len(messages)}", run, target=1.0)
        messages.append(caught.value.messages)
    assert messages[0] == messages[1]


def doubled(item, factor):
    return item * factor


@pytest.mark.parametrize("threads", [1, 3])
def test_without_a_pool_threads_do_the_work(threads):
    found, shares = {}, []
    spread(doubled, range(20), found.__setitem__, 2, pool=None, threads=threads, report=shares.append)
    assert found == {place: 2 * place for place in range(20)}
    assert shares[-1] == 1.0


def test_packed_counts_are_the_counts():
    random = np.random.default_rng(3)
    lowest = random.integers(0, 1 << 20, (5, 40, 2), np.uint64)
    lowest[:, random.random(40) < 0.6] = 0
    lowest[3] = 0
    every = np.stack([lowest, lowest & random.integers(0, 1 << 20, (5, 40, 2), np.uint64)], axis=1)
    packed = [pack_counts(counts) for counts in every]
    again = PackedCounts(packed, every.shape[1:])
    assert len(again) == 5
    for one, other in zip(every, again, strict=True):
        assert np.array_equal(one, other)
    assert np.array_equal(again[1:3][0], every[1])
    size = sum(array.nbytes for one in packed for array in one)
    assert size <= packed_bytes(sum(len(patches) for patches, _ in packed), 2, 128)


def test_panels_far_from_the_part_are_not_tried_and_none_is_missed(two):
    scene = build_scene(load_rig(two.rig), load_part(two.part), postures=(Posture(0.0, 0.0), Posture(30.0, 40.0)))
    assert panels_in_part(scene) == ()
    light = scene.lights[0]
    centre = scene.mesh.vertices.mean(axis=0)
    inside = light.moved(np.eye(3), centre - light.centre)
    lights = (scene.lights[1], inside, light)
    found = panels_in_part(replace(scene, lights=lights))
    assert [one.light for one in found] == [light.name] * len(found)
    assert {one.posture for one in found} == set(scene.postures)


class Lost(Exception):  # noqa: N818
    task = "counts-1"


@pytest.mark.parametrize(
    ("future", "message"),
    [
        (SimpleNamespace(status="cancelled"), "the connection to the scheduler was lost"),
        (SimpleNamespace(status="error", exception=Lost), "each worker that ran it was lost"),
        (SimpleNamespace(status="error", exception=lambda: InputError("too many")), "too many"),
    ],
)
def test_what_goes_wrong_elsewhere_is_a_message(future, message):
    with pytest.raises(InputError, match=message):
        _pool._result_of(future)


def test_a_worker_of_another_version_computes_nothing():
    with pytest.raises(InputError, match=r'lightopt: previously "9\.9"'):
        _pool._run('{"lightopt": "9.9"}', doubled, 1, 2)


def test_options_for_workers(cli, two):
    ask = "optimize", two.rig, two.part, "-o", two.out, *FEW
    for words in (("--workers", 2), ("--scheduler", "tcp://127.0.0.1:1"), ("--slurm",), ("--kubernetes",)):
        ran = cli(*ask, *words)
        assert (ran.status, ran.err) == (2, f"error: {words[0]}: has no effect without --choose-postures or --target\n")
    chosen = *ask, "--choose-postures", 2
    ran = cli(*chosen, "--scheduler", "tcp://127.0.0.1:1", "--workers", 2)
    assert (ran.status, "no effect with --scheduler" in ran.err) == (2, True)
    ran = cli(*chosen, "--slurm", "--kubernetes")
    assert (ran.status, "expected one of them" in ran.err) == (2, True)


def test_a_scheduler_that_does_not_answer(cli, two, monkeypatch):
    monkeypatch.setattr("lightopt.batch._cluster._ANSWER_S", 0.2)
    ran = cli(
        *("optimize", two.rig, two.part, "-o", two.out, *FEW, "--choose-postures", 2),
        *("--scheduler", "tcp://127.0.0.1:1"),
    )
    assert ran.status == 2
    assert ran.err.startswith("error: tcp://127.0.0.1:1: no Dask scheduler answers within 0.2 s")
    assert len(ran.err.splitlines()) == 1
    assert not two.out.exists()
