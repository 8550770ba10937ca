"""Compiled kernels are kept on disk by what is compiled: nothing stale runs, and nothing is compiled twice."""

from __future__ import annotations

import importlib
import os
import pkgutil
import subprocess
import sys
from types import ModuleType

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import lightopt
from lightopt.core import kernels

SOURCE = '''\
"""A module with kernels that call each other."""
from typing import NamedTuple
import numpy as np
from lightopt.core.kernels import kernel

SCALE = 2.0
TABLE = np.array([10.0, 20.0])

class Pair(NamedTuple):
    first: float
    second: float

@kernel
def inner(x):
    """Inner."""
    return x + 1.0

@kernel
def middle(x, offset=3.0):
    return inner(x) * SCALE + offset

@kernel
def outer(x):
    """Outer."""
    return middle(x) + TABLE[0]

@kernel
def first_of(pair):
    return pair.first

def other():
    return 1
'''


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder for compiled kernels."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    kernels.cache_folder.cache_clear()
    yield tmp_path / "cache" / "lightopt" / "kernels"
    kernels.cache_folder.cache_clear()


def module(source: str = SOURCE) -> ModuleType:
    made = ModuleType("made")
    sys.modules["made"] = made
    exec(compile(source, "made.py", "exec"), made.__dict__)
    return made


@pytest.mark.parametrize(
    ("old", "new", "result"),
    [
        ("x + 1.0", "x + 2.0", 19.0),  # two calls below
        ("SCALE = 2.0", "SCALE = 3.0", 19.0),  # a constant of a called kernel
        ("[10.0, 20.0]", "[11.0, 20.0]", 18.0),
        ("offset=3.0", "offset=4.0", 18.0),
        ("middle(x) + TABLE[0]", "middle(x) - TABLE[0]", -3.0),
    ],
)
def test_a_change_of_what_a_kernel_uses_is_compiled(folder, old, new, result):
    before = module()
    assert before.outer(1.0) == 17.0
    after = module(SOURCE.replace(old, new))
    assert SOURCE.count(old) == 1
    assert kernels.fingerprint(after.outer) != kernels.fingerprint(before.outer)
    assert after.outer(1.0) == result
    assert module().outer(1.0) == 17.0  # what was compiled before is not lost either


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"""Outer."""', '"""Another docstring."""'),
        ("SCALE = 2.0", "# a comment\n\n\nSCALE = 2.0"),
        ("return 1", "return 2"),  # of a function that no kernel calls
    ],
)
def test_what_is_not_compiled_changes_nothing(folder, old, new):
    assert module().outer(1.0) == 17.0
    again = module(SOURCE.replace(old, new))
    assert again.outer(1.0) == 17.0
    assert (sum(again.outer.stats.cache_hits.values()), sum(again.outer.stats.cache_misses.values())) == (1, 0)


def test_fields_of_named_tuples_that_change_places_are_compiled_anew(folder):
    before = module()
    assert before.first_of(before.Pair(1.0, 2.0)) == 1.0
    assert before.first_of(before.Pair(first=1.0, second=2.0)) == 1.0
    after = module(SOURCE.replace("first: float\n    second: float", "second: float\n    first: float"))
    assert after.first_of(after.Pair(first=1.0, second=2.0)) == 1.0


def test_other_arguments_have_files_of_their_own(folder):
    made = module()
    assert made.inner(1.0) == 2.0
    assert list(made.inner(np.arange(2.0))) == [1.0, 2.0]
    assert len(list(folder.glob("inner-*.kernel"))) == 2


def test_a_file_that_was_cut_off_is_compiled_anew(folder):
    assert module().inner(1.0) == 2.0
    (file,) = folder.glob("inner-*.kernel")
    whole = file.read_bytes()
    for kept in (b"", whole[: len(whole) // 2]):
        file.write_bytes(kept)
        assert module().inner(1.0) == 2.0
        assert len(file.read_bytes()) == len(whole)


def test_files_that_nobody_used_for_months_go_when_a_new_one_comes(folder):
    made = module()
    assert made.inner(1.0) == 2.0
    (used,) = folder.glob("inner-*.kernel")
    for path in folder.iterdir():
        os.utime(path, (0.0, 0.0))
    unused = folder / "inner-0.kernel"
    unused.write_bytes(b"")
    os.utime(unused, (0.0, 0.0))
    module().inner(1.0)  # loads the file, and uses it so
    kernels._remove_unused.cache_clear()
    assert made.inner(1) == 2
    assert used.exists()
    assert not unused.exists()


def test_what_has_no_fingerprint_is_refused(folder):
    made = module(SOURCE.replace("TABLE = np.array([10.0, 20.0])", "TABLE = {0: 10.0}"))
    with pytest.raises(TypeError, match="outer uses TABLE, a dict"):
        made.outer(1.0)


def test_every_kernel_has_a_fingerprint():
    names = [found.name for found in pkgutil.walk_packages(lightopt.__path__, "lightopt.")]
    found = {
        id(value): value
        for name in names
        if not name.endswith("__main__")
        for value in vars(importlib.import_module(name)).values()
        if isinstance(value, Dispatcher)
    }
    assert len(found) > 50
    assert len({kernels.fingerprint(value) for value in found.values()}) == len(found)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="there every process compiles for itself")
def test_of_two_processes_one_compiles(folder, tmp_path):
    (tmp_path / "made.py").write_text(SOURCE, encoding="utf-8")
    script = (
        "import sys, made; print('ready', flush=True); sys.stdin.readline(); made.outer(1.0); "
        "print(*(sum(k.stats.cache_misses.values()) for k in (made.outer, made.middle, made.inner)))"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    start = [
        subprocess.Popen([sys.executable, "-c", script], env=environment, stdin=-1, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    for process in start:
        assert process.stdout.readline() == "ready\n"
    for process in start:
        process.stdin.write("go\n")
        process.stdin.flush()
    compiled = sorted(process.communicate(timeout=300)[0].strip() for process in start)
    # who loads the outer one needs no inner one
    assert compiled == ["0 0 0", "1 1 1"]


def test_a_folder_that_cannot_be_written_is_replaced_by_a_private_one(folder, tmp_path):
    (tmp_path / "cache").write_text("a file where the folder should be", encoding="utf-8")
    found = kernels.cache_folder()
    assert found.is_dir()
    assert not found.is_relative_to(tmp_path)
    found.rmdir()


@pytest.mark.slow
def test_a_kernel_runs_without_scipys_linear_algebra():
    """It takes longer to load than the kernels of a command."""
    script = (
        "import sys, numpy as np; from lightopt.geometry import TriangleMesh, face_areas; "
        "print(face_areas(TriangleMesh(np.eye(3), np.array([[0, 1, 2]])))); print('scipy.linalg' in sys.modules)"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300)
    assert ran.stdout.splitlines() == ["[0.8660254]", "False"], ran.stderr
