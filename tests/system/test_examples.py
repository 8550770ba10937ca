"""The examples run as they stand, on rigs whose cameras have a quarter of the pixels."""

from __future__ import annotations

import re
import runpy
import shutil
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def test_there_is_one_for_each_task():
    assert len(EXAMPLES) == 9


def coarse(rig: Path, to: Path) -> None:
    """A copy of a rig file: half the pixels along each side, of twice the size."""
    text = rig.read_text(encoding="utf-8")
    for key, factor in (("resolution_px", 0.5), ("pixel_size_um", 2.0)):
        (line,) = re.findall(rf"^ *{key}: .*$", text, re.MULTILINE)
        values, *comment = line.split("#", 1)
        changed = re.sub(r"[0-9.]+", lambda number, factor=factor: f"{float(number[0]) * factor:g}", values)
        text = text.replace(line, "#".join([changed, *comment]))
    to.write_text(text, encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """The examples, and the sample rig and parts that they use."""
    root = tmp_path_factory.mktemp("clone")
    (root / "configs" / "rigs").mkdir(parents=True)
    shutil.copytree(ROOT / "examples", root / "examples", ignore=shutil.ignore_patterns("rig.yaml", "__pycache__"))
    shutil.copytree(ROOT / "configs" / "parts", root / "configs" / "parts")
    coarse(ROOT / "examples" / "rig.yaml", root / "examples" / "rig.yaml")
    coarse(ROOT / "configs" / "rigs" / "four-panel.yaml", root / "configs" / "rigs" / "four-panel.yaml")
    return root / "examples"


@pytest.mark.slow
@pytest.mark.usefixtures("few_pixels_for_the_rest")
@pytest.mark.parametrize("example", EXAMPLES, ids=[path.stem for path in EXAMPLES])
def test_it_runs(example, folder, tmp_path, monkeypatch, capsys):
    program = str(folder / example.name)
    monkeypatch.setattr(sys, "argv", [program, str(tmp_path / "out")])
    runpy.run_path(program, run_name="__main__")
    assert capsys.readouterr().out
