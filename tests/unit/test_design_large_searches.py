"""Searches that are large: many lights, spaces cut off by a limit, progress, being stopped, and memory."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from reference._search import all_combinations, coverage_value, paper_value

from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.design import (
    OBJECTIVES,
    LevelThresholds,
    LuminanceMatrix,
    ObjectiveResult,
    OptimizeOptions,
    area_units,
    search,
)
from lightopt.design._candidates import Candidates
from lightopt.design._cells import Cells, LightCells
from lightopt.design.search._best_positions import answer_set, limit_warning
from lightopt.design.search._exact_search import CombinationSpace

HERE = Path(__file__).resolve().parent
THRESHOLDS = LevelThresholds(shade=30, saturation=250, black=12)
T = (30, 250)


def random_matrix(sizes, patches, *, smooth=False, seed=0):
    """Random levels; `smooth`: a patch's classes change once or twice along a light's candidates, as on real parts."""
    rng = np.random.default_rng(seed)
    levels = []
    for size in sizes:
        layer = rng.integers(0, 320, (size, patches))
        if smooth:
            layer = rng.integers(0, 320, patches) + np.linspace(-60, 60, size)[:, None]
        levels.append(np.clip(layer, 12, 255).astype(np.uint8))
    return LuminanceMatrix(levels=tuple(levels), areas=rng.random(patches))


@pytest.mark.parametrize("lights", [12, 24, 70, 300])
@pytest.mark.parametrize("name", ["paper", "coverage"])
def test_many_lights_of_which_few_move_against_the_plain_definition(name, lights):
    sizes = [1] * lights
    sizes[1], sizes[lights // 2], sizes[-2] = 3, 4, 2
    matrix = random_matrix(sizes, 60)
    weights = np.ones(60, np.int64) if name == "paper" else area_units(matrix.areas)
    value = partial(paper_value, black=12) if name == "paper" else partial(coverage_value, areas=weights)
    value = partial(value, shade=30, saturation=250)
    expected = all_combinations(matrix.levels, value, *T, weights, None, 12)
    found = search([matrix], OBJECTIVES[name], THRESHOLDS, keep=24)
    assert [r.sort_key for r in found.ranking] == expected
    clash = np.zeros((3, 2), np.bool_)
    clash[1, 0] = True
    space = CombinationSpace(
        sizes=tuple(sizes), groups=(tuple(map(np.arange, sizes)),), clashes={(1, lights - 2): clash}
    )
    found = search([matrix], OBJECTIVES[name], THRESHOLDS, keep=24, space=space)
    allowed = [one for one in expected if (one[2][1], one[2][-2]) != (1, 0)]
    assert [r.sort_key for r in found.ranking] == allowed


@pytest.mark.parametrize("sizes", [(2,) * 12, (2,) * 10 + (1,) * 14, (3, 1) * 6, (5,) * 5])
@pytest.mark.parametrize("name", ["paper", "coverage"])
def test_a_dozen_lights_and_two_in_seconds(name, sizes):
    """10,000 patches; the best is what the definition says, and no combination drawn at random is better."""
    objective, matrix = OBJECTIVES[name], random_matrix(sizes, 10_000)
    search([random_matrix(sizes, 10)], objective, THRESHOLDS, keep=2)  # compiles
    begun = time.process_time()
    found = search([matrix], objective, THRESHOLDS, keep=2)
    assert time.process_time() - begun < 20.0  # of all threads
    assert found.scored == np.prod(sizes)
    weights = objective.weights(matrix.areas)
    rng = np.random.default_rng(1)
    drawn = [tuple(int(rng.integers(n)) for n in sizes) for _ in range(50)]
    for ranked in found.ranking:
        assert ranked.score == objective.score(matrix.combination(ranked.candidates), weights, THRESHOLDS)
    for combination in drawn:
        assert objective.score(matrix.combination(combination), weights, THRESHOLDS) <= found.best.score


def test_more_moving_lights_than_numpy_has_axes_end_with_a_bound():
    matrix = random_matrix((2,) * 80, 20)
    for objective in OBJECTIVES.values():
        found = search([matrix], objective, THRESHOLDS, keep=2, limit=100_000, table_cells=64)
        assert found.left > 2**79
        assert found.bound >= found.best.score
        one, weights = matrix.combination(found.best.candidates), objective.weights(matrix.areas)
        assert objective.score(one, weights, THRESHOLDS) == found.best.score
    with pytest.raises(InputError, match=r"more than 10\^300 combinations; raise option 'step_deg'"):
        search([random_matrix((2,) * 1000, 3)], OBJECTIVES["coverage"], THRESHOLDS)


@pytest.mark.parametrize("limit", [1, 10, 1000, 30_000])
def test_the_limit_is_kept(limit):
    matrix = random_matrix((20, 20, 20, 20), 50)
    for objective in OBJECTIVES.values():
        found = search([matrix], objective, THRESHOLDS, keep=2, limit=limit)
        assert 1 <= found.scored <= 2 * limit
        assert found.left > 0
        assert not found.complete
        assert found.scored + found.excluded + found.left == 20**4


def test_proven_and_complete_are_two_things():
    """A limit may leave combinations that cannot be better and may be as good."""
    levels = tuple(np.full((4, 3), 100, np.uint8) for _ in range(3))
    matrix = LuminanceMatrix(levels=levels, areas=np.ones(3))
    found = search([matrix], OBJECTIVES["coverage"], THRESHOLDS, keep=2, limit=8)
    assert found.proven
    assert not found.complete
    assert found.ties < 63
    answer = ObjectiveResult(objective=OBJECTIVES["coverage"], found=found, scores={"coverage": found.best.score})
    said = limit_warning(answer, [Posture(0.0, 0.0)])
    assert f"with {found.left} left" in said
    assert f"none scores more than {found.bound:,}" in said
    whole = search([matrix], OBJECTIVES["coverage"], THRESHOLDS, keep=2)
    assert whole.proven
    assert whole.complete
    assert (whole.ties, whole.left) == (63, 0)


def test_a_limit_under_which_nothing_scores_names_no_optimum():
    """The one combination that was looked at scores 0, and better ones are left."""
    levels = ([[0, 255], [100, 5], [5, 255]], [[0, 100], [0, 0], [100, 255]], [[100, 255], [100, 255], [100, 0]])
    matrix = LuminanceMatrix(levels=tuple(np.array(one, np.uint8) for one in levels), areas=np.ones(2))
    places = tuple(tuple((30.0, float(k)) for k in range(3)) for _ in range(3))
    candidates = Candidates(
        names=("a", "b", "c"),
        channels=((0,), (1,), (2,)),
        places=places,
        panels=((),) * 3,
        left_out=(),
        space=CombinationSpace.of((3, 3, 3)),
        cells=Cells((LightCells((), (), ()),) * 3, CombinationSpace.of((0, 0, 0))),
    )
    lights = [SimpleNamespace(elevation_deg=30.0, azimuth_deg=0.0, distance_range_mm=None)] * 3
    problem = SimpleNamespace(
        rig=SimpleNamespace(lights=lights),
        candidates=candidates,
        objectives=[OBJECTIVES["paper"]],
        thresholds=LevelThresholds(shade=10, saturation=255),
        options=OptimizeOptions(rows=2, limit=1),
    )
    result = answer_set(
        *([matrix], [Posture(0.0, 0.0)], [OBJECTIVES["paper"]]),
        SimpleNamespace(problem=problem, run=RunContext(threads=1)),
    )
    (answer,) = result.answers
    assert answer.found.bound > 0
    assert answer.nothing is not None
    assert answer.nothing.startswith("each of 1 combinations (26 left) scores 0")


MEDIUM = {
    "paper": ((40, 40, 40), 150_000, False),
    "paper, many lights": ((4,) * 8, 200_000, False),
    "coverage, by runs": ((40, 40, 40, 5), 250_000, True),
    "coverage, by bits": ((40, 40, 40), 50_000, False),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MEDIUM)
def test_shares_rise_and_an_exception_ends_the_search_soon(name):
    sizes, patches, smooth = MEDIUM[name]
    matrix = random_matrix(sizes, patches, smooth=smooth)
    objective = OBJECTIVES[name.partition(",")[0]]
    small = random_matrix(sizes, 200, smooth=smooth)
    search([small], objective, THRESHOLDS, keep=2)  # compiles
    shares: list[float] = []
    search([matrix], objective, THRESHOLDS, keep=2, progress=shares.append)
    assert shares == sorted(shares)
    assert len({share for share in shares if 0.0 < share < 1.0}) >= 5
    assert shares[-1] == 1.0
    moments = []

    def stop(_):
        moments.append(time.process_time())
        if len(moments) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        search([matrix], objective, THRESHOLDS, keep=2, progress=stop)
    assert len(moments) == 3
    assert time.process_time() - moments[-1] < 2.0  # of all threads


INTERRUPTED = """
import os, signal, sys, threading, time
from lightopt.core.interrupts import interrupt
from test_design_large_searches import MEDIUM, OBJECTIVES, THRESHOLDS, random_matrix, search
matrix = random_matrix((60, 60, 60, 60), 100_000)
objective = OBJECTIVES[{name!r}]
search([random_matrix((60, 60, 2, 2), 200)], objective, THRESHOLDS, keep=2)
signal.signal(signal.SIGINT, interrupt)
sent = []
def kill():
    sent.append(time.process_time())
    os.kill(os.getpid(), signal.SIGINT)
timer = threading.Timer(1.0, kill)
timer.start()
try:
    search([matrix], objective, THRESHOLDS, keep=2)
except KeyboardInterrupt:
    print(time.process_time() - sent[0])
else:
    print("was not interrupted")
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no signal to a process alone")
@pytest.mark.parametrize("name", ["paper", "coverage"])
def test_ctrl_c_ends_a_long_search_within_a_second(name):
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED.format(name=name)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (HERE, HERE.parent)))},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < 3.0  # of all threads


MEMORY = """
import sys
from pathlib import Path
from types import SimpleNamespace
import numpy as np
from lightopt.design.objectives import OBJECTIVES
from lightopt.design.responses._luminance_matrix import LevelThresholds, LuminanceMatrix
from lightopt.design.search._exact_search import search

def levels(sizes, patches):
    # written row by row, so that nothing else is ever held
    rng = np.random.default_rng(0)
    made = [np.empty((n, patches), np.uint8) for n in sizes]
    for layer in made:
        start = rng.integers(0, 256, patches).astype(np.uint8)
        for k in range(len(layer)):
            np.add(start, np.uint8({change} * k % 256), out=layer[k])  # modulo 256
    return LuminanceMatrix(levels=tuple(made), areas=np.ones(patches))

def peak():
    # of this program alone: what getrusage says counts the process that it was forked from, too
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line for line in lines if line.startswith("VmHWM")).split()[1])

thresholds = LevelThresholds(shade=10, saturation=250)
objective = OBJECTIVES[{name!r}]
search([levels((3, 3, 3), 1000)], objective, thresholds, keep=2)
before = peak()
matrix = levels((1000, 3, 3), 150_000)
held = peak()
for cells in (1 << 22, 1000):
    search([matrix], objective, thresholds, keep=2, table_cells=cells, limit=20_000)
print(before, held - before, peak() - held)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak is read from Linux's /proc")
@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("paper", 1),
        pytest.param("coverage", 1, marks=pytest.mark.nightly),
        pytest.param("coverage", 77, marks=pytest.mark.nightly),
    ],
)
def test_a_search_holds_no_second_copy_of_the_levels(name, change):
    """150 MB of levels, whole and in boxes: all else is less than that, so that 1 GB, the most, stays below 2 GB."""
    code = MEMORY.format(name=name, change=change)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=600)
    base, levels, more = map(int, done.stdout.split())
    assert levels > 145e6
    assert more < 140e6
    assert base + 1e9 + more < 2e9


def test_scores_do_not_depend_on_how_the_work_is_cut(monkeypatch):
    matrix = random_matrix((5, 1, 4, 3), 700)
    whole = {name: o.scores(matrix, o.weights(matrix.areas), THRESHOLDS, 2, None) for name, o in OBJECTIVES.items()}
    for module, names in {
        "_paper": ("BLOCK_LEVELS", "LEAST_PATCHES", "TASK_LEVELS", "WALK_LEVELS"),
        "_coverage": ("CHUNK_PATCHES", "CHUNK_BOXES", "CHUNK_LEVELS"),
    }.items():
        for name in names:
            monkeypatch.setattr(f"lightopt.design.objectives.{module}.{name}", 50)
    for (name, objective), cost in itertools.product(OBJECTIVES.items(), (0.0, 1e9)):
        monkeypatch.setattr("lightopt.design.objectives._paper.DIRECT_COST", cost)
        weights = objective.weights(matrix.areas)
        again = objective.scores(matrix, weights, THRESHOLDS, 3, None)
        np.testing.assert_array_equal(again, whole[name])
