"""``make batch``: every part of a folder, one table, a failing part does not stop the others."""

from __future__ import annotations

import importlib.util
import json
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MORE = "--patches 500 --no-images --posture 0,0"


@pytest.fixture(scope="module")
def batch():
    spec = importlib.util.spec_from_file_location("batch", ROOT / "scripts" / "batch.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_every_part_is_tried_and_a_second_run_keeps_what_is_there(batch, bench, capsys):
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
    assert "1 kept luminance matrix reused" in capsys.readouterr().out
    assert result.read_bytes() == before
    assert matrix.stat().st_mtime_ns == stamp
    (parts / "b.yaml").write_text(good.replace("R_d: 45.0", "R_d: 50"), encoding="utf-8")
    assert batch.main(command) == 0
    assert "was made from other inputs, and is made anew" in capsys.readouterr().out
    assert matrix.stat().st_mtime_ns != stamp
    assert json.loads(result.read_bytes())["results"] != json.loads(before)["results"]


def test_a_folder_without_parts_is_told(batch, tmp_path, capsys):
    assert batch.main(["rig.yaml", str(tmp_path)]) == 2
    assert "no part file (*.yaml) is there" in capsys.readouterr().err
