"""The golden scenes render as they did: the same check as ``make golden-check``, and that it can fail."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path

import numpy as np
import pytest

from lightopt.core.provenance import file_sha256
from lightopt.images import read_exr, read_image_set, write_exr

ROOT = Path(__file__).resolve().parents[2]
LARGEST_BYTES = 2_000_000


def load_script():
    spec = importlib.util.spec_from_file_location("goldens", ROOT / "scripts" / "goldens.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


goldens = load_script()


@pytest.mark.nightly  # make golden-check does the same, and CI runs it
@pytest.mark.parametrize("name", goldens.RENDERS)
def test_a_golden_scene_renders_as_it_did(cli, tmp_path, name):
    assert (goldens.GOLDEN / name / "manifest.json").is_file(), f"no golden set {name}: make golden"
    goldens.render(name, tmp_path / name)
    # where it differs, the pictures and figures are in the temporary folder that pytest keeps
    ran = cli(
        "compare", goldens.GOLDEN / name, tmp_path / name,
        "--diff", tmp_path / "differences", "--json", tmp_path / "comparison.json",
    )  # fmt: skip
    assert ran.status == 0, f"{ran.err}\n{ran.out}\nin {tmp_path}; if this is meant to be so: make golden"


@pytest.mark.parametrize("name", goldens.RENDERS)
def test_golden_sets_are_whole(name):
    image_set = read_image_set(goldens.GOLDEN / name)  # every file there, with the hash listed
    assert image_set.images
    assert image_set.geometry
    assert image_set.manifest.patches is not None


def test_no_golden_belongs_to_no_scene():
    folders = {path.name for path in goldens.GOLDEN.iterdir() if path.is_dir()}
    assert folders == {*goldens.RENDERS, "scenes"}


def test_the_goldens_are_small():
    sizes = [path.stat().st_size for path in goldens.GOLDEN.rglob("*") if path.is_file()]
    assert sum(sizes) <= LARGEST_BYTES


# --- the check can fail


@pytest.fixture
def copy(tmp_path):
    """A golden set to spoil."""
    name = next(iter(goldens.RENDERS))
    return goldens.GOLDEN / name, shutil.copytree(goldens.GOLDEN / name, tmp_path / name)


def perturb(folder: Path, name: str, edit) -> None:
    """Change an EXR as another version of the renderer would have: file and manifest agree."""
    path = folder / name
    before = file_sha256(path)
    channels = {key: values.copy() for key, values in read_exr(path).items()}
    edit(channels)
    write_exr(path, channels, metadata={})
    manifest = folder / "manifest.json"
    text = manifest.read_text(encoding="utf-8")
    assert before in text
    manifest.write_text(text.replace(before, file_sha256(path)), encoding="utf-8", newline="\n")


def test_a_copy_is_the_same(cli, copy):
    assert cli("compare", *copy).status == 0


def test_images_one_percent_brighter_are_noticed(cli, copy):
    golden, new = copy

    def brighter(channels):
        for name in channels:
            channels[name] *= np.float32(1.01)

    perturb(new, read_image_set(new).images[0].exr, brighter)
    ran = cli("compare", golden, new)
    assert ran.status == 1
    assert "differs: " in ran.err


def test_a_highlight_one_pixel_aside_is_noticed(cli, copy):
    golden, new = copy

    def aside(channels):
        for name, values in channels.items():
            channels[name] = np.ascontiguousarray(np.roll(values, 1, axis=1))

    perturb(new, read_image_set(new).images[-1].exr, aside)
    assert cli("compare", golden, new).status == 1


def test_geometry_that_moved_by_ten_micrometres_is_noticed(cli, copy):
    golden, new = copy

    def moved(channels):
        channels["P.Z"][channels["Z"] > 0] += np.float32(0.01)

    perturb(new, read_image_set(new).geometry[0].exr, moved)
    assert cli("compare", golden, new).status == 1


@pytest.mark.parametrize("lost", ["manifest.json", "patches.npz", "posture_0_0/light1.png", "posture_0_0/geometry.exr"])
@pytest.mark.parametrize("side", ["golden", "new"])
def test_a_missing_file_is_a_failure_on_either_side(cli, copy, lost, side):
    golden, new = copy
    (new / lost).unlink()
    ran = cli("compare", golden, new) if side == "new" else cli("compare", new, golden)
    assert ran.status == (2 if lost == "manifest.json" else 1)  # without a manifest there is no set to compare
    assert side in ran.err
    assert "missing" in ran.err or "no " in ran.err


def test_the_script_leaves_with_failure(copy, tmp_path, monkeypatch):
    """What `make golden-check` runs, with images that are rendered already: one spoilt golden set is one failure."""
    golden, new = copy

    def darker(channels):
        channels["Y"] *= np.float32(0.9)

    perturb(new, read_image_set(new).images[0].exr, darker)
    monkeypatch.setattr(goldens, "GOLDEN", new.parent)
    monkeypatch.setattr(goldens, "RENDERS", {golden.name: goldens.RENDERS[golden.name]})
    monkeypatch.setattr(goldens, "render", lambda _, out: shutil.copytree(golden, out))
    assert goldens.check(tmp_path / "out") == 1
    shutil.rmtree(new)
    assert goldens.check(tmp_path / "out") == 1, "a missing golden is a failure"
