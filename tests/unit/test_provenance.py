"""What results depend on: said in one layout by all commands, and nothing reused where it differs."""

from __future__ import annotations

import json
import re
import shutil
from importlib.metadata import requires, version

import numpy as np
import pytest
from designed import design
from packaging.requirements import Requirement

from lightopt import __version__
from lightopt.config import input_hashes, load_rig
from lightopt.core import provenance
from lightopt.core.errors import InputError
from lightopt.design import OptimizeOptions
from lightopt.images import read_image_set, write_png
from lightopt.inspection import read_calibration
from lightopt.rendering import RenderOptions, render_image_set

FEW = ("--patches", "500", "-q", "--posture", "0,0")
SECTIONS = {"lightopt", "code_sha256", "versions", "inputs", "options"}


@pytest.fixture
def other_code(monkeypatch):
    """Another edit of the sources."""

    def change():
        monkeypatch.setattr(provenance, "code_sha256", lambda: "0" * 64)

    return change


@pytest.fixture
def other_package(monkeypatch):
    """Another release of a package."""
    before = provenance.versions()

    def change(name="embreex"):
        monkeypatch.setattr(provenance, "versions", lambda: {**before, name: "0.0.1"})

    return change


# --- the hash of the code


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """A copy of the sources, whose hash is taken."""
    package = tmp_path / "lightopt"
    source = provenance.Path(provenance.__file__).parents[1]
    for name in ("core", "optics", "cli", "report"):
        shutil.copytree(source / name, package / name, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(provenance, "__file__", str(package / "core" / "provenance.py"))

    def taken():
        provenance.code_sha256.cache_clear()
        return provenance.code_sha256()

    yield package, taken
    provenance.code_sha256.cache_clear()


def test_the_hash_changes_with_any_code_that_computes(copied):
    package, taken = copied
    before = taken()
    assert re.fullmatch("[0-9a-f]{64}", before)
    assert taken() == before
    path = package / "optics" / "_sensor.py"
    text = path.read_text(encoding="utf-8")
    path.write_text(text + "\nGAIN = 2\n", encoding="utf-8")
    edited = taken()
    path.write_text(text, encoding="utf-8")
    assert taken() == before
    path.rename(path.with_name("_other.py"))
    moved = taken()
    path.with_name("_other.py").rename(path)
    (package / "new").mkdir()
    (package / "new" / "__init__.py").write_text("", encoding="utf-8")
    assert len({before, edited, moved, taken()}) == 4


def test_the_hash_does_not_change_with_what_only_shows_results(copied):
    package, taken = copied
    before = taken()
    for name in ("cli/_main.py", "report/_page.py"):
        (package / name).write_text("changed = True\n", encoding="utf-8")
    (package / "optics" / "__pycache__").mkdir()
    (package / "optics" / "__pycache__" / "x.py").write_text("x = 1\n", encoding="utf-8")
    (package / "optics" / "notes.txt").write_text("x", encoding="utf-8")
    assert taken() == before


def test_the_code_is_read_once():
    provenance.code_sha256.cache_clear()
    first = provenance.computed_by()
    assert provenance.computed_by() == first
    for cached in (provenance.code_sha256, provenance.versions):
        assert cached.cache_info().misses == 1


NO_RESULT_DEPENDS_ON = {
    "matplotlib": "draws charts",
    "pillow": "draws reports",
    "pydantic": "checks the files' keys and values, and changes none",
    "pyserial": "carries bytes to devices",
    "pyyaml": "splits files into words; numbers are read by lightopt.config",
    "rich": "prints",
    "typer": "parses the command line",
}


def test_all_packages_that_results_come_from_are_named():
    found = provenance.computed_by()
    assert found["lightopt"] == __version__
    needed = [Requirement(line) for line in requires("lightopt") or ()]
    packages = {one.name for one in needed if one.marker is None or "extra" not in str(one.marker)}
    assert packages > NO_RESULT_DEPENDS_ON.keys()
    expected = {"python", "llvmlite", *packages} - NO_RESULT_DEPENDS_ON.keys()
    assert set(found["versions"]) == expected, "a new dependency: do results depend on it?"
    assert found["versions"]["trimesh"] == version("trimesh")


# --- differences in words


def test_differences_are_reported_in_order_and_names_of_files_are_none():
    there = provenance.provenance(
        {"rig": {"file": "a.yaml", "sha256": "1"}, "image_sets": [{"manifest_sha256": "1"}]}, {"points": 4}
    )
    now = {
        **there,
        "code_sha256": "0",
        "versions": {**there["versions"], "numpy": "0"},
        "inputs": {"rig": {"file": "b.yaml", "sha256": "2"}, "image_sets": [{"manifest_sha256": "2"}]},
        "options": {"points": 9},
    }
    assert provenance.differences(there, now) == (
        f'options.points: previously 4, now 9; versions.numpy: previously "{version("numpy")}", now "0"; '
        "the code of lightopt has changed; rig.sha256: another content; image_sets: another content"
    )
    renamed = {**there, "inputs": {**there["inputs"], "rig": {"file": "b.yaml", "sha256": "1"}}}
    assert provenance.differences(there, renamed) == ""
    assert provenance.differences(there, {"options": {"points": 4}}, partly=True) == ""
    assert provenance.differences(there, {"options": {"points": 4}}) != ""


def test_of_many_differences_some_are_reported():
    reported = provenance.differences({}, {f"option{i}": i for i in range(10)})
    assert reported.count("; ") == 6
    assert reported.endswith("; and 4 more")
    assert "…" in provenance.differences({}, {"long": "x" * 500})


# --- every command says it, and nothing of other code is reused


def check(found, *, inputs):
    assert set(found) == SECTIONS
    assert found["code_sha256"] == provenance.code_sha256()
    assert found["versions"] == provenance.versions()
    assert set(found["inputs"]) == inputs
    for name in ("rig", "part", "mesh"):
        assert re.fullmatch("[0-9a-f]{64}", found["inputs"][name]["sha256"])


@pytest.fixture
def tiny(tmp_path):
    """Makes a foreign set of two images under two lights."""

    def make(name, level=9):
        folder = tmp_path / name
        folder.mkdir()
        images = []
        for k in (1, 2):
            write_png(folder / f"{k}.png", np.full((4, 5), k * level, np.uint8), metadata={})
            images.append(
                {
                    "light": f"light{k}", "light_elevation_deg": 60, "light_azimuth_deg": 90 * k, "exposure": 1,
                    "posture": {"elevation_deg": 0, "rotation_deg": 0}, "png": f"{k}.png",
                }
            )  # fmt: skip
        manifest = {"format": "lightopt-images/1", "kind": "captured", "bit_depth": 8, "images": images}
        (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
        return folder

    return make


def provenance_of(path):
    return json.loads(path.read_text(encoding="utf-8"))["provenance"]


def test_overlaps_of_other_images_or_code_are_not_replaced(cli, tiny, tmp_path, snapshot, other_code):
    one, out = tiny("one"), tmp_path / "out"
    assert cli("overlap", one, "-o", out).status == 0
    found = provenance_of(out / "overlap.json")
    assert set(found) == SECTIONS
    assert found["inputs"] == {"image_sets": [read_image_set(one).fingerprint]}
    before = snapshot(out)
    assert cli("overlap", one, "-o", out, "-q").status == 0, "the same again"
    ran = cli("overlap", tiny("two", level=99), "-o", out)
    assert ran.status == 2
    assert "image_sets: another content" in ran.err
    assert snapshot(out) == before
    other_code()
    ran = cli("overlap", one, "-o", out)
    assert "the code of lightopt has changed); use --force" in ran.err
    assert cli("overlap", one, "-o", out, "--force").status == 0


def test_a_map_that_nothing_lists_is_not_replaced(cli, tiny, tmp_path):
    mine = tmp_path / "out" / "posture_0_0" / "overlap.png"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine", encoding="utf-8")
    ran = cli("overlap", tiny("one"), "-o", tmp_path / "out")
    assert ran.status == 2
    assert "already has posture_0_0/overlap.png" in ran.err
    assert mine.read_text(encoding="utf-8") == "mine"


def test_a_comparison_says_what_was_compared(cli, tiny, tmp_path):
    a, b = tiny("a"), tiny("b")
    (a / "notes.txt").write_text("mine", encoding="utf-8")

    def compare(name, *paths):
        assert cli("compare", *paths, "--json", tmp_path / name, "--absolute", 0.5).status in (0, 1)
        found = provenance_of(tmp_path / name)
        assert set(found) == SECTIONS
        assert found["options"]["absolute"] == 0.5
        return found["inputs"]

    sets = compare("sets.json", a, b / "manifest.json")
    assert sets["golden"] == sets["new"]
    assert set(sets["new"]) == {"manifest_sha256", "files_sha256"}
    files = compare("files.json", a / "1.png", b / "2.png")
    assert files["golden"] == {"sha256": provenance.file_sha256(a / "1.png")}
    assert files["golden"] != files["new"]
    (b / "2.png").write_bytes((b / "1.png").read_bytes())
    again = compare("again.json", a, b)
    assert again["golden"] == sets["golden"]
    assert again["new"]["files_sha256"] != sets["new"]["files_sha256"]
    (b / "2.png").unlink()
    assert compare("missing.json", a, b)["new"]["files_sha256"] != again["new"]["files_sha256"]


def test_a_check_says_what_was_checked(cli, bench):
    path = bench.folder / "findings.json"
    assert cli("check", bench.rig, "--json", path).status == 0
    found = provenance_of(path)
    assert set(found) == SECTIONS
    assert found["inputs"] == {"rig": input_hashes(load_rig(bench.rig), None)["rig"]}


@pytest.mark.parametrize("what", ["code", "package"])
def test_a_render_is_not_resumed_by_other_code(bench, snapshot, other_code, other_package, what):
    options = RenderOptions(patch_budget=500)
    render_image_set(bench.rig, bench.part, bench.out, options=options)
    document = json.loads((bench.out / "manifest.json").read_text(encoding="utf-8"))
    check(document["provenance"], inputs={"rig", "part", "mesh"})
    (bench.out / "posture_-10_170" / "light3.exr").unlink()
    before = snapshot(bench.out)
    other_code() if what == "code" else other_package()
    reported = "the code of lightopt has changed" if what == "code" else r"versions\.embreex: previously"
    with pytest.raises(InputError, match=f"image set of another run .*{reported}.*option 'force'"):
        render_image_set(bench.rig, bench.part, bench.out, options=options)
    assert snapshot(bench.out) == before
    done = render_image_set(bench.rig, bench.part, bench.out, options=options, force=True)
    assert (done.resumed, done.replaced > 0) == (0, True)


def test_a_capture_is_not_resumed_by_other_code(take, bench, world, snapshot, other_code):
    take()
    document = json.loads((bench.out / "manifest.json").read_text(encoding="utf-8"))
    check(document["provenance"], inputs={"rig", "part", "mesh"})
    before = snapshot(bench.out)
    other_code()
    with pytest.raises(InputError, match="the code of lightopt has changed"):
        take(resume=True)
    assert snapshot(bench.out) == before


KEPT = OptimizeOptions(step_deg=20.0, patch_budget=500, keep_matrix=True, images=False)


@pytest.fixture
def movable(bench):
    bench.edit("rig.yaml", "azimuth_deg: 45}", "azimuth_deg: 45, elevation_range_deg: [40, 60]}")
    return bench


def run(bench, *, force=True, keep=True):
    options = KEPT if keep else OptimizeOptions(step_deg=20.0, patch_budget=500, images=False)
    return design(bench.rig, bench.part, bench.out, options=options, force=force)


@pytest.mark.parametrize("what", ["code", "package"])
def test_a_kept_matrix_of_other_code_is_not_reused(movable, other_code, other_package, what):
    run(movable)
    document = json.loads((movable.out / "result.json").read_text(encoding="utf-8"))
    check(document["provenance"], inputs={"rig", "part", "mesh"})
    assert run(movable).reused == 2
    other_code() if what == "code" else other_package("cascadio")
    with pytest.raises(InputError, match="the result of another run"):
        run(movable, force=False)
    assert run(movable).reused == 0
    assert run(movable).reused == 2, "it was kept anew"


def test_a_kept_matrix_is_read_only_where_that_is_requested(movable):
    run(movable)
    assert run(movable, keep=False).reused == 0
    assert run(movable).reused == 2


@pytest.mark.slow
def test_a_fit_is_not_replaced_by_one_of_other_code(cli, bench, other_code, snapshot):
    assert cli("render", bench.rig, bench.part, "-o", bench.folder / "set", *FEW, "--noise", 1).status == 0
    command = ("fit-diffuse", bench.rig, bench.part, bench.folder / "set", "-o", bench.out, "--pixels", "8000")
    assert cli(*command, "-q").status == 0
    document = json.loads((bench.out / "fit.json").read_text(encoding="utf-8"))
    check(document["provenance"], inputs={"rig", "part", "mesh", "image_sets"})
    before = snapshot(bench.out)
    assert cli(*command, "-q").status == 0
    assert snapshot(bench.out) == before
    other_code()
    ran = cli(*command, "-q")
    assert ran.status == 2
    assert "(the code of lightopt has changed); use --force" in ran.err
    assert snapshot(bench.out) == before


@pytest.mark.slow
def test_a_calibration_of_other_code_is_refused(cli, bench, other_code, tmp_path):
    """One that good parts taught, at the fewest sets and the highest rate that they bear."""
    sets = []
    for seed in range(3):
        folder = bench.folder / f"good{seed}"
        sets.append(folder)
        assert cli("render", bench.rig, bench.part, "-o", folder, *FEW, "--noise", seed).status == 0
    options = ("--false-alarms", "0.9", "--no-register", "-q")
    made = tmp_path / "calibration"
    assert cli("inspect", bench.rig, bench.part, *sets, "-o", made, "--calibrate", *options).status == 0
    document = json.loads((made / "calibration.json").read_text(encoding="utf-8"))
    check(document["provenance"], inputs={"rig", "part", "mesh", "image_sets"})
    command = ("inspect", bench.rig, bench.part, sets[0], "--calibration", made, "--no-register", "--no-report")
    ran = cli(*command, "-o", bench.out)
    assert ran.status == 0, ran.err
    found = json.loads((bench.out / "defects.json").read_text(encoding="utf-8"))["provenance"]
    check(found, inputs={"rig", "part", "mesh", "image_sets", "calibration"})
    other_code()
    ran = cli(*command, "-o", bench.folder / "again")
    assert ran.status == 2
    assert "calibration.json was made by another lightopt" in ran.err
    assert "the code of lightopt has changed" in ran.err
    assert "calibrate again" in ran.err
    assert not (bench.folder / "again").exists()
    del document["provenance"]["code_sha256"]
    (made / "calibration.json").write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(InputError, match="not a calibration that lightopt wrote"):
        read_calibration(made)


def test_results_depend_on_the_covariance_of_a_calibrated_rig(bench):
    bench.rig.write_text(f"{bench.rig.read_text()}\ncalibration: {{covariance: rig.npz}}\n", encoding="utf-8")
    covariance = bench.rig.with_name("rig.npz")
    assert "covariance" not in input_hashes(load_rig(bench.rig), None)  # most commands do without
    seen = set()
    for variance in (1.0, 2.0):
        np.savez(covariance, names=["focal length [px]"], covariance=[[variance]])
        seen.add(input_hashes(load_rig(bench.rig), None)["covariance"]["sha256"])
    assert len(seen) == 2
