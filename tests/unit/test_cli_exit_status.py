"""Exit statuses: of defects, of verdicts whose reader goes away, of the system's refusals."""

from __future__ import annotations

import errno
import json
import os
import re
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from lightopt.cli import _process
from lightopt.core.errors import CheckFailed, HardwareError, InputError
from lightopt.images import write_png

closes_pipes = pytest.mark.skipif(sys.platform == "win32", reason="pipes of Windows do not say that nobody reads")


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """The folder for temporary files, empty."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.delenv("LIGHTOPT_DEBUG", raising=False)
    return folder


@pytest.fixture
def schema(cli, monkeypatch):
    """Runs ``lightopt schema rig``, in which something is raised."""

    def run(error, *options):
        def fail(_kind):
            raise error

        monkeypatch.setattr("lightopt.config.json_schema", fail)
        return cli(*options, "schema", "rig")

    return run


# --- in process


def test_a_defect_is_one_line_and_a_traceback_in_a_file(schema, temporary):
    ran = schema(ZeroDivisionError("division\nby zero"))
    assert (ran.status, ran.out) == (70, "")
    (path,) = temporary.iterdir()
    assert ran.err == (
        f"error: unexpected ZeroDivisionError: division by zero (a bug in lightopt); its traceback is in {path}; "
        "--debug or LIGHTOPT_DEBUG=1 shows it on the terminal\n"
    )
    text = path.read_text(encoding="utf-8")
    assert "Traceback (most recent call last)" in text
    assert "in fail" in text
    assert re.match(r"lightopt \S+, Python 3", text)
    if sys.platform != "win32":
        assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_each_defect_has_a_file_of_its_own(schema, temporary):
    schema(ValueError("one"))
    schema(ValueError("two"))
    assert len(list(temporary.iterdir())) == 2


@pytest.mark.parametrize("where", ["before", "after", "environment"])
def test_debug_shows_the_traceback(schema, cli, temporary, monkeypatch, where):
    if where == "environment":
        monkeypatch.setenv("LIGHTOPT_DEBUG", "1")
        ran = schema(ValueError("oh"))
    elif where == "before":
        ran = schema(ValueError("oh"), "--debug")
    else:
        schema(ValueError("oh"))
        ran = cli("schema", "rig", "--debug")
    assert ran.status == 70
    assert "Traceback (most recent call last)" in ran.err
    assert ran.err.endswith("error: unexpected ValueError: oh (a bug in lightopt); its traceback is above\n")
    assert os.environ.get("LIGHTOPT_DEBUG") == ("1" if where == "environment" else None)
    assert len(list(temporary.iterdir())) == (where == "after")


def test_a_traceback_that_cannot_be_written_is_printed(schema, temporary, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(temporary / "not there"))
    ran = schema(ValueError("oh"))
    assert ran.status == 70
    assert ran.err.startswith("Traceback (most recent call last)")
    last = ran.err.splitlines()[-1]
    assert last.startswith("error: unexpected ValueError: oh (a bug in lightopt); its traceback is above, because ")
    assert "No such file" in last


def test_an_exception_that_cannot_say_what_it_is(schema, temporary):
    class MuteError(Exception):
        def __str__(self):
            raise RuntimeError("no words")

    ran = schema(MuteError())
    assert ran.status == 70
    assert "unexpected MuteError (a bug in lightopt)" in ran.err
    (path,) = temporary.iterdir()
    assert "in fail" in path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (MemoryError("Unable to allocate 74.5 GiB"), 70),
        (RecursionError("maximum recursion depth exceeded"), 70),
        (ImportError("libGL.so.1: cannot open shared object file"), 70),
        (SystemExit(0), 70),
        (SystemExit(1), 70),
        (BrokenPipeError(errno.EPIPE, "Broken pipe"), 70),
        (ConnectionResetError(errno.ECONNRESET, "Connection reset by peer"), 70),
        (OSError("an SDK's own"), 70),
        (FileNotFoundError(errno.ENOENT, "No such file", str(Path(_process.__file__).parent / "x")), 70),
        (OSError(errno.ENOSPC, "No space left on device"), 2),
        (PermissionError(errno.EACCES, "Permission denied", "/root/part.stl"), 2),
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "part.stl"), 2),
        (InputError("wrong"), 2),
        (HardwareError("silent"), 3),
        (CheckFailed("differs"), 1),
        (KeyboardInterrupt(), 130),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else "",
)
def test_which_error_has_which_status(schema, temporary, error, status):
    ran = schema(error)
    assert ran.status == status
    assert len(ran.err.splitlines()) == 1
    assert bool(list(temporary.iterdir())) == (status == 70)


# --- as a process


def lightopt(*arguments, before="", temporary=None, env=None, **options):
    """Run the command line in a process of its own, in which something was changed before."""
    environment = {**os.environ, **({} if temporary is None else {"TMPDIR": str(temporary)}), **(env or {})}
    environment.pop("LIGHTOPT_DEBUG", None)
    command = [sys.executable, "-c", f"{before}\nfrom lightopt.cli import main\nmain()"]
    return subprocess.Popen(
        [*command, *map(str, arguments)],
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        env=environment,
        **options,
    )


def left(process):
    """Exit status, and what was said on standard error, of a process nobody reads the output of."""
    if process.stdout is not None:
        process.stdout.close()
    said = process.stderr.read()
    process.stderr.close()
    return process.wait(120), said


CRASHES = {
    "import": "import sys; sys.modules['typer'] = None",
    "thread": """
import threading, lightopt.config as c
def json_schema(kind):
    def fail(): raise ValueError('in a thread')
    t = threading.Thread(target=fail); t.start(); t.join()
    return {}
c.json_schema = json_schema""",
}


@pytest.mark.parametrize("where", CRASHES)
def test_a_crash_of_the_process_has_the_status_of_a_defect(tmp_path, where):
    status, said = left(lightopt("schema", "rig", before=CRASHES[where], temporary=tmp_path, stdout=subprocess.DEVNULL))
    assert status == 70
    assert said.startswith("error: unexpected ")
    assert len(said.splitlines()) == 1
    assert "Traceback" in next(tmp_path.glob("lightopt-error-*")).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """Two PNGs that differ."""
    folder = tmp_path_factory.mktemp("pictures")
    for name, level in (("a.png", 100), ("b.png", 120)):
        write_png(folder / name, np.full((8, 8), level, dtype=np.uint8), metadata={})
    return folder


@closes_pipes
@pytest.mark.parametrize(("other", "status"), [("b.png", 1), ("a.png", 0)])
def test_compare_judges_though_nobody_reads(pictures, tmp_path, other, status):
    figures = tmp_path / "figures.json"
    process = lightopt("compare", pictures / "a.png", pictures / other, "--json", figures, stdout=subprocess.PIPE)
    found, said = left(process)
    assert found == status
    assert "Exception ignored" not in said
    assert "BrokenPipe" not in said
    assert (said.startswith("error: differs: ") and len(said.splitlines()) == 1) if status else said == ""
    assert json.loads(figures.read_text(encoding="utf-8"))["passed"] == (status == 0)


@closes_pipes
def test_nobody_reads_what_goes_wrong_either(pictures):
    """Both streams are one pipe that is closed, as in ``2>&1 | head -1``."""
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "lightopt", "compare", pictures / "a.png", pictures / "b.png"]
    done = subprocess.run(command, stdout=writing, stderr=writing, check=False)
    os.close(writing)
    assert done.returncode == 1


@pytest.mark.skipif(sys.platform == "win32", reason="shells of POSIX")
@pytest.mark.parametrize("closing", ["<&- >&- 2>&-", ">&-", "> /dev/full"])
def test_streams_that_are_closed_or_full(pictures, tmp_path, closing):
    if "full" in closing and not Path("/dev/full").exists():
        pytest.skip("only Linux has a device that is always full")
    arguments = f"compare {pictures / 'a.png'} {pictures / 'b.png'} --json {tmp_path / 'f.json'}"
    done = subprocess.run(f"{sys.executable} -m lightopt {arguments} {closing}", shell=True, check=False)
    # a table that has no room is no verdict; one that nobody wants is
    assert done.returncode == (2 if "full" in closing else 1)
    assert json.loads((tmp_path / "f.json").read_text(encoding="utf-8"))["passed"] is False


@closes_pipes
@pytest.mark.slow
def test_check_judges_though_nobody_reads(bench):
    assert left(lightopt("check", bench.rig, stdout=subprocess.PIPE)) == (0, "")
    # a panel inside the part
    bench.edit("rig.yaml", "distance_mm: 330, elevation_deg: 45", "distance_mm: 20, elevation_deg: 45")
    status, said = left(lightopt("check", bench.rig, bench.part, stdout=subprocess.PIPE))
    assert status == 1
    assert said.endswith("must be corrected before rendering\n")


@closes_pipes
@pytest.mark.slow
def test_render_does_its_work_though_nobody_reads(shared_bench, tmp_path):
    arguments = ("render", shared_bench.rig, shared_bench.part, "-o", tmp_path / "out", "--patches", 500)
    status, said = left(lightopt(*arguments, stdout=subprocess.PIPE))
    assert (status, said) == (0, "")
    assert (tmp_path / "out" / "posture_-10_170" / "light3.png").exists()


@closes_pipes
@pytest.mark.slow
def test_inspect_judges_though_nobody_reads(bench, cli, tmp_path):
    """Images of a part with a dent, inspected as a good one: NG, and all its files, whoever reads."""
    good = bench.part.read_text(encoding="utf-8")
    place = "at_pixel: {posture: {elevation_deg: 0, rotation_deg: 0}, pixel: [80, 60]}"
    dent = f"defects: [{{name: d, kind: dent, {place}, size_mm: 6, slope_deg: 20}}]\n"
    (bench.folder / "bad.yaml").write_text(good + dent, encoding="utf-8")
    sets = bench.folder / "set"
    assert cli("render", bench.rig, bench.folder / "bad.yaml", "-o", sets, "--patches", 500, "-q").status == 0
    arguments = ("inspect", bench.rig, bench.part, sets, "--no-register", "--fail-on-defect", "--min-images", 1)
    status, said = left(lightopt(*arguments, "-o", tmp_path / "out", stdout=subprocess.PIPE))
    assert status == 1, said
    assert "NG" in said
    assert "BrokenPipe" not in said
    assert (tmp_path / "out" / "defects.json").exists()
