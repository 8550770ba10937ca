"""``lightopt compare``: exit statuses, what it prints, JSON and difference pictures."""

from __future__ import annotations

import json
import re
import shutil

import numpy as np
import pytest

from lightopt.core.provenance import file_sha256
from lightopt.images import read_exr, write_exr


@pytest.fixture(scope="module")
def golden(shared_bench, tmp_path_factory):
    """A small image set that no test changes."""
    from lightopt.cli._main import run

    out = tmp_path_factory.mktemp("compare") / "golden"
    arguments = ["render", str(shared_bench.rig), str(shared_bench.part), "-o", str(out), "-q", "--patches", "500"]
    assert run(arguments) == 0
    return out


@pytest.fixture
def new(golden, tmp_path):
    """A copy of it to change."""
    return shutil.copytree(golden, tmp_path / "new")


def change(folder, name, edit):
    """Change the pixels of an EXR and let the manifest know, as another renderer would have written it."""
    path = folder / name
    before = file_sha256(path)
    channels = {key: values.copy() for key, values in read_exr(path).items()}
    edit(channels)
    write_exr(path, channels, metadata={})
    manifest = folder / "manifest.json"
    text = manifest.read_text(encoding="utf-8")
    manifest.write_text(text.replace(before, file_sha256(path)), encoding="utf-8", newline="\n")


def brighter(channels):
    channels["Y"] += np.float32(0.3)


LIGHT = "posture_0_0/light1.exr"


def test_a_set_is_the_same_as_itself(cli, golden, new):
    ran = cli("compare", golden, new)
    assert (ran.status, ran.err) == (0, "")
    verdict, head, greatest = ran.out.splitlines()
    assert re.fullmatch(r"no difference beyond the thresholds in \d+ files", verdict)
    every = cli("compare", golden, new, "--verbose").out.splitlines()
    assert every[0] == verdict
    assert greatest.split() in [line.split() for line in every]
    assert head.split() == ["file", "channel", "max", "rms", "p99", "differing", "IoU"]
    rows = [line.split() for line in every[2:]]
    y = next(row for row in rows if row[0] == LIGHT and row[1] == "Y")
    assert y[2:] == ["0", "0", "0", "0.000", "%", "1.0000", "ok"]
    assert {row[1] for row in rows} >= {"Y", "levels", "P.X", "N.Z", "Z", "patch", "hit"}
    assert any(row[0].endswith("patches.npz") for row in rows)
    assert cli("compare", golden / "manifest.json", new / "manifest.json").status == 0


def test_files_are_compared_like_sets(cli, golden, new):
    for name in (LIGHT, "posture_0_0/light1.png", "posture_0_0/geometry.exr"):
        ran = cli("compare", golden / name, new / name)
        assert (ran.status, ran.err) == (0, ""), name


def test_a_difference_fails_and_says_where(cli, golden, new):
    change(new, LIGHT, brighter)
    for a, b in ((golden, new), (golden / LIGHT, new / LIGHT)):
        ran = cli("compare", a, b)
        assert ran.status == 1
        assert "DIFFERS" in ran.out
        assert ran.err.startswith("error: differs: ")
        assert "100" in ran.err  # of the pixels
        assert "Traceback" not in ran.err


def test_thresholds_decide(cli, golden, new):
    change(new, LIGHT, brighter)
    a, b = golden / LIGHT, new / LIGHT
    assert cli("compare", a, b, "--absolute", "0.31").status == 0
    assert cli("compare", a, b, "--absolute", "0.29").status == 1
    assert cli("compare", a, b, "--max-share", "1").status == 0
    # the dark background differs by 0.3 whatever its relative threshold
    assert cli("compare", a, b, "--absolute", "0", "--relative", "100").status == 1


def test_a_share_of_pixels_may_differ(cli, golden, new):
    part = np.flatnonzero(read_exr(golden / LIGHT)["Y"])
    assert 1000 < len(part) < 0.8 * 160 * 120
    allowed = len(part) // 1000  # 0.1 % of the part, however large the frame

    def brighten(pixels):
        def edit(channels):
            channels["Y"].ravel()[pixels] += 1.0

        return edit

    change(new, LIGHT, brighten(part[:allowed]))
    assert cli("compare", golden, new).status == 0
    assert cli("compare", golden, new, "--max-share", "0.0005").status == 1
    change(new, LIGHT, brighten(part[allowed]))
    assert cli("compare", golden, new).status == 1


def test_geometry_has_a_threshold_of_its_own(cli, golden, new):
    def shifted(channels):
        channels["P.X"][channels["Z"] > 0] += np.float32(0.01)

    change(new, "posture_0_0/geometry.exr", shifted)
    assert cli("compare", golden, new).status == 1
    assert cli("compare", golden, new, "--geometry-absolute", "0.02").status == 0


def test_saturated_areas_are_compared_on_request(cli, golden, new):
    def larger_highlight(channels):
        y = channels["Y"]
        near = (y > 120) & (y < 255)
        y[near] = 256.0

    change(new, LIGHT, larger_highlight)
    generous = ("--max-share", "1")
    assert cli("compare", golden, new, *generous).status == 0
    ran = cli("compare", golden, new, *generous, "--min-iou", "0.98")
    assert ran.status == 1
    assert "IoU" in ran.err or "overlap" in ran.err
    # from 100 on both are saturated in the same pixels
    assert cli("compare", golden, new, *generous, "--min-iou", "0.98", "--saturation", "100").status == 0


def test_missing_files_are_failures_never_skips(cli, golden, new):
    (new / LIGHT).unlink()
    ran = cli("compare", golden, new)
    assert ran.status == 1
    assert "light1" in ran.err
    assert "missing" in ran.err
    # the other way round a golden is missing
    ran = cli("compare", new, golden)
    assert ran.status == 1
    assert "golden" in ran.err
    assert "missing" in ran.err


def test_a_path_that_is_no_image_and_no_set_is_wrong_input(cli, golden, new, tmp_path):
    for a, b, role in ((tmp_path / "no", new, "golden"), (golden, tmp_path / "no", "new")):
        ran = cli("compare", a, b)
        assert ran.status == 2
        assert f"{role} set" in ran.err
        assert "Traceback" not in ran.err
    ran = cli("compare", tmp_path / "no.exr", new / LIGHT)
    assert ran.status == 2
    assert f"golden file is missing: {tmp_path / 'no.exr'}" in ran.err
    text = tmp_path / "part.yaml"
    text.write_text("format: lightopt-part/1\n", encoding="utf-8")
    ran = cli("compare", golden / LIGHT, text)
    assert ran.status == 2
    assert "expected an EXR or PNG image" in ran.err
    (new / LIGHT).write_bytes((golden / LIGHT).read_bytes()[:2000])  # damaged: wrong alone, a failure in a set
    assert cli("compare", golden / LIGHT, new / LIGHT).status == 2
    assert cli("compare", golden, new).status == 1


def test_missing_images_are_failures(cli, golden, new):
    manifest = json.loads((new / "manifest.json").read_text(encoding="utf-8"))
    manifest["images"] = manifest["images"][1:]
    (new / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    ran = cli("compare", golden, new)
    assert ran.status == 1
    assert "new set lacks light1 at posture (0°, 0°)" in ran.err
    ran = cli("compare", new, golden)  # more than the golden is only a note
    assert ran.status == 0
    assert "only in the new set: light1 at posture (0°, 0°)" in ran.out


def test_json_holds_all_figures(cli, golden, new, tmp_path):
    change(new, LIGHT, brighter)
    path = tmp_path / "figures.json"
    assert cli("compare", golden, new, "--json", path).status == 1
    figures = json.loads(path.read_text(encoding="utf-8"))
    assert figures["passed"] is False
    assert figures["reasons"]
    assert len(figures["files"]) == 4 + 4 + 2 + 1
    channel = next(
        c for f in figures["files"] if f["b"].endswith("light1.exr") for c in f["channels"] if c["name"] == "Y"
    )
    assert channel["max"] == pytest.approx(0.3, rel=1e-3)
    assert channel["rms"] == pytest.approx(0.3, rel=1e-3)
    assert channel["share"] > 0.5


def test_diff_draws_one_picture_or_a_folder_of_them(cli, golden, new, tmp_path):
    change(new, LIGHT, brighter)
    picture = tmp_path / "diff.png"
    ran = cli("compare", golden / LIGHT, new / LIGHT, "--diff", picture)
    assert ran.status == 1
    assert f"{picture}: blue lower, red higher, full colour at 0.3" in ran.out
    assert picture.read_bytes().startswith(b"\x89PNG")
    folder = tmp_path / "diffs"
    ran = cli("compare", golden, new, "--diff", folder)
    assert ran.status == 1
    assert f"10 difference pictures in {folder}" in ran.out
    assert len(list(folder.glob("*.diff.png"))) == 10


def test_comparing_leaves_both_as_they_are(cli, golden, new, snapshot):
    before = snapshot(golden), snapshot(new)
    cli("compare", golden, new)
    assert (snapshot(golden), snapshot(new)) == before


@pytest.mark.parametrize(
    ("option", "value"),
    [("--absolute", "-1"), ("--relative", "nan"), ("--max-share", "1.5"), ("--min-iou", "2"), ("--saturation", "inf")],
)
def test_thresholds_without_sense_are_errors(cli, golden, new, option, value):
    ran = cli("compare", golden, new, option, value)
    assert ran.status == 2
    assert ran.err.startswith("error: threshold ")
    assert ran.out == ""
