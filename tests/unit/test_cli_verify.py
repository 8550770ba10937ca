"""``lightopt verify``: files, words, exit statuses and refusals."""

from __future__ import annotations

import json
import shutil

import pytest

from lightopt.cli._main import run


@pytest.fixture(scope="module")
def good(shared_bench, tmp_path_factory):
    """An image set of the rig as its file has it."""
    out = tmp_path_factory.mktemp("good") / "set"
    command = ["render", shared_bench.rig, shared_bench.part, "-o", out, "-q", "--patches", "500", "--noise", "3"]
    assert run([str(word) for word in command]) == 0
    return out


@pytest.fixture
def dim(good, bench, tmp_path):
    """The same set, and a rig file whose light1 is brighter than the light of that set."""
    bench.edit("rig.yaml", "elevation_deg: 60, azimuth_deg: 45}", "elevation_deg: 60, azimuth_deg: 45, gain: 1.1}")
    return shutil.copytree(good, tmp_path / "dim")


def test_a_rig_within_its_tolerances(cli, bench, good):
    ran = cli("verify", bench.rig, bench.part, good, "-o", bench.out)
    assert ran.status == 0, ran.err
    assert ran.out.startswith("the rig is within its tolerances\n")
    assert len(ran.out.splitlines()) <= 15
    result = json.loads((bench.out / "verify.json").read_text(encoding="utf-8"))
    assert result["format"] == "lightopt-verification/1"
    assert result["within_tolerances"] is True
    assert [light["light"] for light in result["lights"]] == ["light1", "light3"]
    assert "<h2>Causes</h2>" in (bench.out / "report.html").read_text(encoding="utf-8")


def test_a_rig_that_has_left_them(cli, bench, dim, tmp_path):
    history = tmp_path / "history"
    command = ("verify", bench.rig, bench.part, dim, "-o", bench.out, "--history", history)
    ran = cli(*command)
    assert ran.status == 1
    assert "gain of light1" in ran.out
    assert len(ran.out.splitlines()) <= 15
    assert "error: the rig has left its tolerances: gain of light1: -9." in ran.err
    (finding,) = json.loads((bench.out / "verify.json").read_text(encoding="utf-8"))["findings"]
    assert finding["components"]["value"] == pytest.approx(1.0 / 1.1 - 1.0, abs=0.01)
    # within wider limits, and again in the table over time
    ran = cli(*command, "--limit", "gain=12%", "--force", "--no-report", "-v")
    assert ran.status == 0, ran.err
    assert "12 %   within" in ran.out
    assert (history / "history.csv").read_text(encoding="utf-8").count("\n") == 3
    assert (history / "history.png").read_bytes().startswith(b"\x89PNG")
    assert not (bench.out / "report.html").exists()


def test_a_known_good_set_instead_of_the_model(cli, bench, dim, good):
    ran = cli("verify", bench.rig, bench.part, dim, "-o", bench.out, "--baseline", good)
    assert ran.status == 0, ran.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--limit", "gain"), '--limit gain: expected a share of the brightness, such as 3%, found ""'),
        (("--limit", "gains=3%"), "--limit: expected NAME=VALUE with a name of gain, exposure, black"),
        (("--limit", "part_mm=far"), '--limit part_mm: expected a number, found "far"'),
        (("--limit", "part_mm=-1"), "limit part_mm: expected a number above 0, found -1"),
        (("--baseline", "none"), "none"),
    ],
)
def test_refusals(cli, bench, good, options, words):
    ran = cli("verify", bench.rig, bench.part, good, "-o", bench.out, *options)
    assert ran.status == 2
    assert words in ran.err
    assert not bench.out.exists()


def test_a_baseline_of_other_postures(cli, bench, good, tmp_path):
    manifest = json.loads((good / "manifest.json").read_text(encoding="utf-8"))
    other = shutil.copytree(good, tmp_path / "other")
    manifest["images"] = manifest["images"][:-1]
    (other / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    ran = cli("verify", bench.rig, bench.part, good, "-o", bench.out, "--baseline", other)
    assert ran.status == 2
    assert "the known good set has no image light3" in ran.err


def test_results_of_other_inputs_are_kept(cli, bench, good):
    assert cli("verify", bench.rig, bench.part, good, "-o", bench.out, "-q").out == ""
    ran = cli("verify", bench.rig, bench.part, good, "-o", bench.out, "--limit", "black=2")
    assert ran.status == 2
    assert "already has verify.json of a verification" in ran.err
