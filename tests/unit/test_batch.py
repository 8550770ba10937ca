"""``make batch``: every part of a folder, one table, a failing part does not stop the others."""

from __future__ import annotations

import importlib.util
import json
import shutil
import signal
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

from lightopt.cli._main import run

ROOT = Path(__file__).resolve().parents[2]
MORE = "--patches 500 --no-images --posture 0,0"


@pytest.fixture(scope="module")
def batch():
    spec = importlib.util.spec_from_file_location("batch", ROOT / "scripts" / "batch.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def mostly_in_process(monkeypatch, batch):
    """The first command is a process of its own; the others save the start of an interpreter."""
    own, ran = batch.call, []

    def call(command):
        ran.append(command)
        if len(ran) == 1:
            return own(command)
        with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
            status = run(command)
        return subprocess.CompletedProcess(command, status, out.getvalue(), err.getvalue())

    monkeypatch.setattr(batch, "call", call)


@pytest.mark.slow
def test_every_part_is_tried_and_a_second_run_keeps_what_is_there(batch, bench, capsys, monkeypatch):
    mostly_in_process(monkeypatch, batch)
    bench.edit(
        "rig.yaml",
        "elevation_deg: 60, azimuth_deg: 45}",
        "elevation_deg: 60, azimuth_deg: 45, elevation_range_deg: [40, 60]}",
    )
    parts = bench.folder / "parts"
    parts.mkdir()
    shutil.copy(bench.mesh, parts)
    good = bench.part.read_text(encoding="utf-8")
    (parts / "a.yaml").write_text(good.replace("R_d: 45.0", "R_d: -1"), encoding="utf-8")
    (parts / "b.yaml").write_text(good, encoding="utf-8")
    command = [str(bench.rig), str(parts), "--step", "10", "--out", str(bench.out), "--options", MORE]
    assert batch.main(command) == 1
    said = capsys.readouterr()
    rows = {line.split()[0]: line.split() for line in said.out.splitlines() if line.startswith(("a ", "b "))}
    assert rows["a"][1:4] == ["failed", "-", "-"]
    assert rows["b"][1:4] == ["ok", "ok", "ok"]
    assert "R_d" in said.err
    assert "1 of 2 parts failed: a" in said.err
    result = bench.out / "b" / "best" / "result.json"
    before = result.read_bytes()
    matrix = bench.out / "b" / "best" / "posture_0_0" / "matrix.npz"
    stamp = matrix.stat().st_mtime_ns
    (parts / "a.yaml").unlink()
    assert batch.main(command) == 0
    capsys.readouterr()
    assert result.read_bytes() == before
    assert matrix.stat().st_mtime_ns == stamp
    (parts / "b.yaml").write_text(good.replace("R_d: 45.0", "R_d: 50"), encoding="utf-8")
    assert batch.main(command) == 0
    assert "was made from other inputs, and is made anew" in capsys.readouterr().out
    assert matrix.stat().st_mtime_ns != stamp
    assert json.loads(result.read_bytes())["results"] != json.loads(before)["results"]


def fake(monkeypatch, batch, answers):
    """Commands are not run: their names are kept, and each gets the next of the answers (status, message)."""
    ran = []

    def call(command):
        ran.append(command)
        status, message = next(answers)
        return subprocess.CompletedProcess(command, status, "", message)

    monkeypatch.setattr(batch, "call", call)
    monkeypatch.setattr(batch, "summary", lambda _: [("0,0", "90.0 %", "60,45"), ("0,82", "91.0 %", "60,50")])
    return ran


def test_ctrl_c_ends_with_the_summary_of_what_was_done(batch, tmp_path, monkeypatch, capsys):
    for name in "abc":
        (tmp_path / f"{name}.yaml").touch()
    answers = iter([(0, ""), (0, ""), (0, ""), (0, ""), (130, "interrupted\n")])
    ran = fake(monkeypatch, batch, answers)
    assert batch.main(["rig.yaml", str(tmp_path), "--out", str(tmp_path / "out")]) == 130
    assert len(ran) == 5, "nothing is begun afterwards"
    said = capsys.readouterr()
    assert "1 of 3 parts were done before" in said.err
    rows = {line.split()[0]: line.split()[1:4] for line in said.out.splitlines() if line[:2] in ("a ", "b ")}
    assert rows == {"a": ["ok", "ok", "ok"], "b": ["ok", "stopped", "-"]}
    assert (tmp_path / "out" / "summary.txt").read_text(encoding="utf-8").count("\n") == 4
    # every posture has a line of its own
    first, second = said.out.splitlines()[-3:-1]
    assert first.split()[5:] == ["0,0", "90.0", "%", "60,45"]
    assert second.split() == ["0,82", "91.0", "%", "60,50"]


def test_the_summary_has_every_posture(batch, tmp_path):
    def answer(share, *elevations):
        lights = [{"elevation_deg": e, "azimuth_deg": 45.0} for e in elevations]
        return [{"share_of_inspectable_area": share, "lights": lights}, {"share_of_inspectable_area": 0.1}]

    def place(tilt, turn):
        return {"elevation_deg": tilt, "rotation_deg": turn}

    groups = [
        {"postures": [place(0.0, 82.0)], "objectives": answer(0.921, 60.0, 35.0)},
        {"postures": [place(-20.0, 180.0)], "objectives": answer(None, 30.0)},
        {"postures": [place(0.0, 0.0), place(0.0, 90.0)], "objectives": answer(0.5, 40.0)},
    ]
    path = tmp_path / "result.json"
    path.write_text(json.dumps({"results": groups}), encoding="utf-8")
    assert batch.summary(path) == [
        ("0,82", "92.1 %", "60,45 35,45"),
        ("-20,180", "-", "30,45"),
        ("all 2", "50.0 %", "40,45"),
    ]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends Ctrl-C to all processes of a console")
def test_a_command_that_gets_ctrl_c_ends_by_itself(batch, monkeypatch, tmp_path):
    """Not killed while it tidies up, which takes it a second here."""
    child = tmp_path / "lightopt.py"
    child.write_text(
        "import os, signal, time\nos.kill(os.getppid(), signal.SIGINT)\ntime.sleep(1.0)\nprint('tidy')\n",
        encoding="utf-8",
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        done = batch.call([])
    finally:
        signal.signal(signal.SIGINT, before)
    assert (done.returncode, done.stdout) == (130, "tidy\n")


@pytest.mark.parametrize(
    ("there", "forced"),
    [
        ({"format": "lightopt-images/1", "kind": "simulated", "part": {"file": "a.yaml"}}, True),
        ({"format": "lightopt-images/1", "kind": "captured", "part": {"file": "a.yaml"}}, False),
        ({"format": "lightopt-images/1", "kind": "simulated", "part": {"file": "b.yaml"}}, False),
        ({"format": "another/1", "part": {"file": "a.yaml"}}, False),
        ([], False),
        (None, False),
    ],
)
def test_only_its_own_result_of_the_same_part_is_replaced(batch, tmp_path, monkeypatch, there, forced):
    (tmp_path / "a.yaml").touch()
    manifest = tmp_path / "out" / "a" / "images" / "manifest.json"
    manifest.parent.mkdir(parents=True)
    if there is not None:
        manifest.write_text(json.dumps(there), encoding="utf-8")
    refused = (2, "error: holds the image set of another run; use --force to replace it\n")
    ran = fake(monkeypatch, batch, iter([(0, ""), refused, (0, ""), (0, "")]))
    assert batch.main(["rig.yaml", str(tmp_path), "--out", str(tmp_path / "out")]) == (0 if forced else 1)
    assert [("--force" in command) for command in ran] == [False, False, *([True, False] if forced else [])]


def test_a_folder_without_parts_is_reported(batch, tmp_path, capsys):
    assert batch.main(["rig.yaml", str(tmp_path)]) == 2
    assert "no part file (*.yaml) is there" in capsys.readouterr().err
