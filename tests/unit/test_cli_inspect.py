"""``lightopt inspect``: defects found where they are, good parts passed, files, words and refusals."""

from __future__ import annotations

import csv
import json
import math
import re
import shutil

import numpy as np
import pytest
from PIL import Image

from lightopt import load_part, load_rig
from lightopt.cli._inspect import _show_evaluation
from lightopt.cli._main import run
from lightopt.core.errors import InputError
from lightopt.images import read_exr, read_image_set, read_metadata, read_png, write_png
from lightopt.inspection import InspectOptions, inspection_provenance

pytestmark = pytest.mark.usefixtures("few_pixels_for_the_rest")

DEFECTS = """\
defects:
  - name: stain
    kind: stain
    at_pixel: {posture: {elevation_deg: 0, rotation_deg: 0}, pixel: [58, 60]}
    size_mm: 3.5
    R_d_factor: 0.6
  - name: dent
    kind: dent
    at_pixel: {posture: {elevation_deg: 0, rotation_deg: 0}, pixel: [92, 72]}
    size_mm: 5
    slope_deg: 12
"""
FIRST = ("--posture", "0,0")


def rendered(bench, out, *options):
    command = ["render", bench.rig, bench.part, "-o", out, "-q", "--patches", "500", "--noise", "3", *options]
    assert run([str(word) for word in command]) == 0
    return out


@pytest.fixture(scope="module")
def parts(shared_bench, tmp_path_factory):
    """Image sets of a part with a stain and a dent, and of a good one, in two postures."""
    folder = tmp_path_factory.mktemp("parts")
    bad = shared_bench.part.with_name("bad.yaml")
    bad.write_text(shared_bench.part.read_text(encoding="utf-8") + DEFECTS, encoding="utf-8")
    command = ["render", shared_bench.rig, bad, "-q", "--patches", "500", "--noise", "3"]
    assert run([str(word) for word in (*command, "-o", folder / "bad")]) == 0
    return {"bad": folder / "bad", "good": rendered(shared_bench, folder / "good")}


@pytest.fixture
def images(parts, tmp_path):
    """The good set, to spoil."""
    shutil.copytree(parts["good"], tmp_path / "images")
    return tmp_path / "images"


def inspect(cli, bench, images, *options, out="out"):
    sets = images if isinstance(images, list) else [images]
    return cli("inspect", bench.rig, bench.part, *sets, "-o", bench.folder / out, "--no-register", *options)


def found(bench, out="out"):
    return json.loads((bench.folder / out / "defects.json").read_text(encoding="utf-8"))


@pytest.mark.slow
@pytest.mark.parametrize("detector", ["residual", "template"])
def test_defects_are_found_where_they_are_and_reported_in_every_file(cli, bench, parts, detector):
    ran = inspect(cli, bench, parts["bad"], "--detector", detector, "--fail-on-defect")
    assert ran.status == 1
    assert "NG" in ran.out
    result = found(bench)
    assert result["verdict"] == "NG"
    truth = read_image_set(parts["bad"]).manifest.extra["defects"]
    for one in truth:
        near = [d for d in result["defects"] if math.dist(d["position_mm"], one["position_mm"]) < 2.0]
        assert near, one["name"]
    if detector == "residual":
        assert len(result["defects"]) == 2
        stain = next(d for d in result["defects"] if math.dist(d["position_mm"], truth[0]["position_mm"]) < 1)
        assert stain["kind"] == "stain"
        assert stain["size_mm"] == pytest.approx([3.5, 3.5], abs=1.0)
        assert stain["area_mm2"] == pytest.approx(truth[0]["area_mm2"], rel=0.4)
        assert {s["posture"]["rotation_deg"] for s in stain["sightings"]} == {0.0, 170.0}
        dent = next(d for d in result["defects"] if d is not stain)
        assert dent["kind"] in ("shape", "unknown")
        # both walls, though one has a glint many times as strong as what the other loses
        assert math.dist(dent["position_mm"], truth[1]["position_mm"]) < 0.7
        assert dent["size_mm"] == pytest.approx([5.0, 5.0], abs=1.5)
        assert dent["area_mm2"] == pytest.approx(truth[1]["area_mm2"], rel=0.5)
    rows = list(csv.DictReader((bench.out / "defects.csv").read_text(encoding="utf-8").splitlines()))
    assert [int(row["number"]) for row in rows] == [d["number"] for d in result["defects"]]
    ply = (bench.out / "defects.ply").read_text(encoding="utf-8")
    vertices = [line.split() for line in ply.split("end_header\n")[1].splitlines()]
    assert f"element vertex {len(vertices)}\n" in ply
    assert {int(v[-1]) for v in vertices} == {d["number"] for d in result["defects"]}
    with Image.open(bench.out / "posture_0_0" / "defects.png") as overlay:
        assert overlay.size == (160, 120)
    synthetic = read_exr(bench.out / "posture_0_0" / "synthetic.exr")
    assert set(synthetic) == {"Y", "deviation.Y", "filled", "mask"}
    reported = read_metadata(bench.out / "posture_0_0" / "synthetic.png")
    assert reported["power"] == 1.0
    grey = read_png(bench.out / "posture_0_0" / "synthetic.png")
    expected = np.clip(synthetic["Y"] / reported["white_level"], 0.0, 1.0) * 255.0
    assert np.abs(grey - expected)[synthetic["mask"] > 0].max() < 0.6
    assert set(result["files"]) | {"defects.json"} == {
        p.relative_to(bench.out).as_posix() for p in bench.out.rglob("*") if p.is_file()
    }


def test_the_verdict_is_reached_and_reported_before_the_images_without_highlights(cli, bench, parts, monkeypatch):
    """They take several times as long, and the residual detector does not look at them."""

    def refuse(*_, **__):
        raise InputError("no image without highlights")

    monkeypatch.setattr("lightopt.inspection.fusion._synthetic_image.fuse_images", refuse)
    ran = inspect(cli, bench, parts["bad"])
    assert "NG: " in ran.out
    assert "no image without highlights" in ran.err
    ran = inspect(cli, bench, parts["bad"], "--detector", "template", "--force")
    assert "NG: " not in ran.out


def test_a_good_part_is_ok_and_the_surface_is_accounted_for(cli, bench, parts):
    ran = inspect(cli, bench, parts["good"], "--fail-on-defect")
    assert ran.status == 0
    assert ran.err == ""
    result = found(bench)
    assert (result["verdict"], result["defects"]) == ("OK", [])
    for posture in result["postures"]:
        surface = posture["surface"]
        shares = [surface[key] for key in ("inspected", "saturated", "shadow", "edge")]
        assert sum(shares) == pytest.approx(1.0, abs=1e-4)
        assert surface["inspected"] > 0.5
        finds = list(surface["finds_contrast"].values())
        assert finds == sorted(finds)
        classes = finds[-1] + surface["only_stronger"] + surface["only_glints"]
        assert classes == pytest.approx(surface["inspected"], abs=1e-4)
        assert 0.0 <= surface["fewer_lights"] < surface["inspected"]
        assert posture["gains"] == pytest.approx({"light1": 1.0, "light3": 1.0}, abs=0.01)


@pytest.mark.slow
@pytest.mark.usefixtures("real_template_banks")
def test_the_same_images_give_the_same_bytes_with_any_number_of_threads(cli, bench, parts, snapshot):
    one = inspect(cli, bench, parts["bad"], "--threads", "1", out="one")
    two = inspect(cli, bench, parts["bad"], "--threads", "2", out="two")
    assert (one.status, two.status) == (0, 0)
    assert snapshot(bench.folder / "one") == snapshot(bench.folder / "two")


@pytest.mark.slow
def test_other_results_are_replaced_only_with_force(cli, bench, parts, snapshot):
    assert inspect(cli, bench, parts["good"]).status == 0
    assert inspect(cli, bench, parts["good"]).status == 0
    before = snapshot(bench.out)
    ran = inspect(cli, bench, parts["bad"])
    assert ran.status == 2
    assert "--force" in ran.err
    assert snapshot(bench.out) == before
    assert inspect(cli, bench, parts["bad"], "--force", "--fusion", "none").status == 0
    assert not list(bench.out.rglob("synthetic.*"))


def test_a_result_names_the_sets_before_it_whose_predictions_it_may_have(bench, parts, images):
    rig, part = load_rig(bench.rig), load_part(bench.part)
    good, bad = (read_image_set(parts[name]) for name in ("good", "bad"))

    def made_from(image_set, *before, register=True):
        return inspection_provenance(rig, part, [image_set], InspectOptions(register=register), before=before)

    assert made_from(good, bad) != made_from(good)
    # where the part lies exactly where its file has it, nothing is taken over
    assert made_from(good, bad, register=False) == made_from(good, register=False)
    # the same images, said to be of another exposure
    manifest = images / "manifest.json"
    manifest.write_text(manifest.read_text(encoding="utf-8").replace('"exposure": 1', '"exposure": 2'), "utf-8")
    assert read_image_set(images).images[0].exposure == 2
    assert made_from(read_image_set(images)) != made_from(good)


@pytest.mark.slow
def test_limits_of_the_part_say_what_counts(cli, bench, parts):
    text = bench.part.read_text(encoding="utf-8")
    bench.part.write_text(text + "inspection: {most_defects: 1, least_size_mm: 20}\n", encoding="utf-8")
    assert inspect(cli, bench, parts["bad"], "--fail-on-defect", "--fusion", "none").status == 0
    assert found(bench)["verdict"] == "OK"
    assert len(found(bench)["defects"]) == 2
    limits = {"most_defects": 1, "least_size_mm": 20.0, "least_contrast": 0.0, "least_inspected": 0.0}
    assert found(bench)["limits"] == limits
    rows = list(csv.DictReader((bench.out / "defects.csv").read_text(encoding="utf-8").splitlines()))
    assert [row["counts"] for row in rows] == ["no", "no"]
    page = (bench.out / "report.html").read_text(encoding="utf-8")
    assert "at most 1 defect of 20 mm or more and a contrast of 0.0 % or more" in page
    assert "a defect must show in 2 images<" in page
    bench.part.write_text(text + "inspection: {most_defects: 5, least_inspected: 0.99}\n", encoding="utf-8")
    ran = inspect(cli, bench, parts["bad"], "--fail-on-defect", "--fusion", "none", "--force")
    assert ran.status == 1
    assert "% of the visible surface was inspected" in ran.err
    bench.part.write_text(text + "inspection: {most_defects: -1, least_contrast: 3}\n", encoding="utf-8")
    ran = inspect(cli, bench, parts["bad"])
    assert ran.status == 2
    assert "most_defects: expected a whole number from 0" in ran.err
    assert "least_contrast: expected a number from 0 to 1" in ran.err


@pytest.mark.slow
def test_several_parts_get_a_folder_each(cli, bench, parts):
    ran = inspect(cli, bench, [parts["good"], parts["bad"]], "--fusion", "none", "--fail-on-defect")
    assert ran.status == 1
    assert "2 parts, 1 OK" in ran.out
    inspected = re.search(r"inspected: (\d.*) % of the visible surface of each part", ran.out)
    assert inspected is not None
    batch = json.loads((bench.out / "batch.json").read_text(encoding="utf-8"))
    assert [(one["folder"], one["verdict"], one["defects"]) for one in batch["sets"]] == [
        ("good", "OK", 0),
        ("bad", "NG", 2),
    ]
    assert batch["files"] == ["report.html"]
    assert (found(bench, "out/good")["verdict"], found(bench, "out/bad")["verdict"]) == ("OK", "NG")
    again = inspect(cli, bench, [parts["good"], parts["good"]])
    assert again.status == 2
    assert "same folder name" in again.err


@pytest.fixture
def dazzled(images):
    """A set that is saturated all over."""
    manifest = json.loads((images / "manifest.json").read_text(encoding="utf-8"))
    for image in manifest["images"]:
        full = np.full((120, 160), 255, np.uint8)
        image["sha256"]["png"] = write_png(images / image["png"], full, metadata={})
    (images / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    return images.rename(images.with_name("dazzled"))


@pytest.mark.slow
def test_a_set_that_is_refused_is_reported_and_the_others_go_on(cli, bench, parts, dazzled):
    ran = inspect(cli, bench, [parts["good"], dazzled, parts["bad"]], "--fusion", "none", "--fail-on-defect")
    assert ran.status == 2
    assert "error: dazzled: not inspected: posture (0°, 0°): all" in ran.err
    assert "error: 1 of 3 sets not inspected: dazzled" in ran.err
    assert "/bad: NG, 2 defects that count, 0 allowed" in ran.err.replace("\\", "/")
    assert "3 parts, 1 OK, 1 not inspected" in ran.out
    lines = ran.out.splitlines()
    good, bad = (
        next(i for i, line in enumerate(lines) if line.startswith(begin)) for begin in ("good: OK: ", "bad: NG: ")
    )
    assert good < bad
    batch = json.loads((bench.out / "batch.json").read_text(encoding="utf-8"))
    assert [(one["folder"], one["verdict"]) for one in batch["sets"]] == [
        ("good", "OK"),
        ("dazzled", "not inspected"),
        ("bad", "NG"),
    ]
    assert batch["sets"][1]["reasons"][0].startswith("dazzled, posture (0°, 0°): all")  # no folders of this machine
    assert {p.name for p in bench.out.iterdir()} == {"good", "bad", "batch.json", "report.html"}
    page = (bench.out / "report.html").read_text(encoding="utf-8")
    for name in ("good", "bad"):
        assert f'<a href="{name}/report.html">{name}</a>' in page
        assert (bench.out / name / "report.html").exists()
    assert "dazzled/report.html" not in page
    assert "<td>not inspected</td><td>dazzled, posture (0°, 0°): all" in page
    own = (bench.out / "good" / "report.html").read_text(encoding="utf-8")
    assert "the background is the least level over the lights" in own
    assert "1 of 3</strong> parts are OK; 1 set not inspected" in page


@pytest.mark.slow
def test_a_refused_set_keeps_no_earlier_result_and_an_old_folder_is_requested_before_work(
    cli, bench, parts, dazzled, tmp_path
):
    good = shutil.copytree(parts["good"], tmp_path / "other" / "dazzled")
    assert inspect(cli, bench, [good, parts["bad"]], "--fusion", "none").status == 0
    (bench.out / "batch.json").unlink()
    ran = inspect(cli, bench, [parts["bad"], dazzled], "--fusion", "none")
    assert ran.status == 2
    assert "--force" in ran.err
    assert ran.out == ""  # nothing was inspected
    ran = inspect(cli, bench, [parts["bad"], dazzled], "--fusion", "none", "--force", "--quiet")
    assert ran.status == 2
    assert not (bench.out / "dazzled").exists()
    assert found(bench, "out/bad")["verdict"] == "NG"
    two = shutil.copytree(dazzled, tmp_path / "two")
    assert inspect(cli, bench, [dazzled, two], "--evaluate", out="none").status == 2
    batch = json.loads((bench.folder / "none" / "batch.json").read_text(encoding="utf-8"))
    assert [one["verdict"] for one in batch["sets"]] == ["not inspected"] * 2


@pytest.mark.slow
def test_sets_of_a_batch_keep_their_own_postures_and_lights(cli, bench, parts, tmp_path):
    few = rendered(bench, tmp_path / "few", "--light", "light1", *FIRST)
    assert inspect(cli, bench, [few, parts["good"]], "--fusion", "none", out="up").status == 0
    assert inspect(cli, bench, [parts["good"], few], "--fusion", "none", out="down").status == 0
    for order in ("up", "down"):
        postures = found(bench, f"{order}/good")["postures"]
        assert [p["lights"] for p in postures] == [["light1", "light3"]] * 2
        assert [p["lights"] for p in found(bench, f"{order}/few")["postures"]] == [["light1"]]


def test_what_a_set_lacks_is_said(cli, bench, tmp_path):
    text = bench.part.read_text(encoding="utf-8")
    out = rendered(bench, tmp_path / "few", "--light", "light1", *FIRST)
    bench.part.write_text(text, encoding="utf-8")
    ran = inspect(cli, bench, out, "--fusion", "none", "--verbose")
    assert ran.status == 0
    assert "no image under light3" in ran.err
    assert "fewer images than the 2" in ran.err
    assert "posture (-10°, 170°): no images" in ran.err
    assert "no images" in ran.out
    surface = found(bench)["postures"][0]["surface"]
    lit = surface["inspected"] - surface["only_glints"]
    assert surface["fewer_lights"] == pytest.approx(lit, abs=2e-5)
    assert lit > 0.5
    page = (bench.out / "report.html").read_text(encoding="utf-8")
    assert "a defect must show in 2 images, or in all images where there are fewer<" in page


@pytest.mark.slow
def test_a_missing_posture_is_not_inspected(cli, bench, parts, tmp_path):
    few = rendered(bench, tmp_path / "few", *FIRST)
    assert inspect(cli, bench, [parts["good"], few], "--fusion", "none").status == 0
    whole, half = (found(bench, f"out/{name}")["surface"] for name in ("good", "few"))
    assert whole["missing"] == 0.0
    assert half["seen"] == whole["seen"]
    assert half["missing"] > 0.2
    assert half["inspected"] < whole["inspected"]
    for surface in (whole, half):
        shares = [surface[key] for key in ("inspected", "saturated", "shadow", "edge", "missing")]
        assert sum(shares) == pytest.approx(1.0, abs=1e-4)
    page = (bench.out / "few" / "report.html").read_text(encoding="utf-8")
    assert f"{100.0 * half['missing']:.1f} % of the visible surface has no images" in page
    row = page.split("<td>all postures</td>")[1].split("</tr>")[0].replace("\u00a0", " ")
    assert f"{100.0 * half['inspected']:.1f} %" in row
    assert f"{100.0 * half['missing']:.1f} %" in row
    assert "<th class=number>no images</th>" in page
    page = (bench.out / "good" / "report.html").read_text(encoding="utf-8")
    assert "<td>all postures</td>" in page
    assert f"% of the part&#x27;s {whole['area_mm2']:.0f} mm² is never seen" in page
    assert "no images" not in page
    text = bench.part.read_text(encoding="utf-8")
    least = 0.5 * (half["inspected"] + whole["inspected"])
    bench.part.write_text(text + f"inspection: {{least_inspected: {least:.4f}}}\n", encoding="utf-8")
    ran = inspect(cli, bench, [parts["good"], few], "--fusion", "none", "--fail-on-defect", "--force")
    assert ran.status == 1
    assert ran.err.count("NG, ") == 1
    assert f"few: NG, {100.0 * half['inspected']:.1f} % of the visible surface was inspected" in ran.err


def test_what_is_allowed_and_what_is_found_is_said(cli, bench, parts):
    text = bench.part.read_text(encoding="utf-8")
    bench.part.write_text(text + "inspection: {most_defects: 3, least_size_mm: 4.5}\n", encoding="utf-8")
    ran = inspect(cli, bench, parts["bad"], "--fusion", "none", "--fail-on-defect", "--evaluate")
    assert ran.status == 0
    assert "OK: 2 defects that count, 3 allowed\nthreshold of the score: " in ran.out
    assert " (0.05 false alarms per posture)\n" in ran.out
    assert "missed" not in ran.out
    assert len(ran.out.splitlines()) <= 15
    share = 100.0 * found(bench)["surface"]["finds_contrast"]["0.2"]
    reported = f"a disc of 5 px that changes the light by 20 % is found on {share:.1f} %"
    assert reported in ran.out
    page = (bench.out / "report.html").read_text(encoding="utf-8")
    assert "2 defects that count, 3 allowed. 2 defects on the" in page
    assert reported in page
    assert "0 without an evaluable pixel; 0 false alarms per posture" in ran.out


def flip(folder, axis):
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    for image in manifest["images"]:
        levels = np.flip(read_png(folder / image["png"]), axis)
        image["sha256"]["png"] = write_png(folder / image["png"], np.ascontiguousarray(levels), metadata={})
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")


def test_labels_say_what_was_found_and_what_was_not(cli, bench, parts):
    ran = inspect(cli, bench, parts["bad"], "--fusion", "none", "--evaluate")
    assert ran.status == 0
    assert "2 of 2 known defects found" in ran.out
    assert "truth.json" in found(bench)["files"]
    reported = json.loads((bench.out / "truth.json").read_text(encoding="utf-8"))
    assert (reported["defects"], reported["found"], reported["hidden"]) == (2, 2, [])
    assert reported["false_alarms_per_posture"] == 0
    assert 0.9 < reported["roc_auc"] <= 1.0
    assert reported["recall"] == [
        {"kind": "dent", "size_mm": 5.0, "defects": 1, "found": 1},
        {"kind": "stain", "size_mm": 3.5, "defects": 1, "found": 1},
    ]
    assert reported["detection"]["all"]["a90"] is None  # two are too few to say


def test_defects_that_were_missed_are_named(capsys):
    each = [
        {"set": "a", "name": f"{kind}-{i}", "kind": kind, "size_mm": 0.5 * (i + 1), "found": kind == "stain"}
        for i in range(7)
        for kind in ("dent", "stain")
    ]
    counts = {"found": 7, "defects": 14, "false_alarms_per_posture": 0.0, "hidden": ["pit-1"], "roc_auc": None}
    _show_evaluation({"each": each, "sets": [{}], **counts})
    found, missed = capsys.readouterr().out.splitlines()
    assert "1 without an evaluable pixel (out of view, at an edge, or narrower than a pixel: pit-1)" in found
    assert missed.startswith("missed: dent-0 (dent, 0.5 mm), dent-1 (dent, 1 mm), ")
    assert missed.endswith("dent-5 (dent, 3 mm) and 1 more; truth.json has all")


@pytest.mark.slow
def test_the_truth_of_a_run_goes_when_the_next_has_none(cli, bench, parts):
    assert inspect(cli, bench, parts["bad"], "--fusion", "none", "--evaluate", "--no-report").status == 0
    assert "report.html" not in found(bench)["files"]
    assert (bench.out / "truth.json").exists()
    assert inspect(cli, bench, parts["bad"], "--fusion", "none").status == 0
    assert not (bench.out / "truth.json").exists()
    assert (bench.out / "report.html").exists()


def test_a_set_rendered_without_defects_counts_with_its_false_alarms_alone(cli, bench, parts):
    bench.part.write_text(bench.part.read_text(encoding="utf-8") + DEFECTS, encoding="utf-8")
    ran = inspect(cli, bench, [parts["good"], parts["bad"]], "--fusion", "none", "--evaluate")
    assert ran.status == 0, ran.err
    assert "2 of 2 known defects found" in ran.out
    reported = json.loads((bench.out / "truth.json").read_text(encoding="utf-8"))
    assert reported["labels"] == ["images", "no defects"]
    assert [(one["set"], one["labels"], one["defects"]) for one in reported["sets"]] == [
        ("good", "no defects", 0),
        ("bad", "images", 2),
    ]
    assert [(one["set"], one["name"], sorted(one["posture"])) for one in reported["each"]] == [
        ("bad", name, ["elevation_deg", "rotation_deg"]) for name in ("stain", "dent")
    ]


def test_what_cannot_be_known_is_refused_before_any_work(cli, bench, parts, images, monkeypatch):
    def never(*_, **__):
        raise AssertionError("inspected")

    monkeypatch.setattr("lightopt.inspection._inspect.Inspector.inspect", never)
    manifest = json.loads((images / "manifest.json").read_text(encoding="utf-8"))
    (images / "manifest.json").write_text(json.dumps({**manifest, "part": None, "lightopt": None}), "utf-8")
    for sets in (images, [parts["bad"], images]):
        ran = inspect(cli, bench, sets, "--evaluate")
        assert ran.status == 2
        assert "no ground truth for this part" in ran.err
        assert not bench.out.exists()


def test_a_flood_of_regions_is_refused_as_another_part(cli, bench, parts, monkeypatch):
    monkeypatch.setattr("lightopt.inspection._inspect.MOST_REGIONS", 1)
    ran = inspect(cli, bench, parts["bad"], "--fusion", "none")
    assert ran.status == 2
    assert "posture (0°, 0°): 2 regions that differ from a good part, expected at most 1" in ran.err
    assert "the model does not describe the part" in ran.err


def test_mirrored_images_are_refused_with_what_would_fit(cli, bench, images):
    flip(images, 1)
    ran = inspect(cli, bench, images)
    assert ran.status == 2
    assert "do not look like this part" in ran.err
    assert "mirrored left to right" in ran.err
    assert not bench.out.exists() or not list(bench.out.iterdir())


def test_black_images_are_called_black(cli, bench, images):
    manifest = json.loads((images / "manifest.json").read_text(encoding="utf-8"))
    for image in manifest["images"]:
        dark = np.zeros((120, 160), np.uint8)
        image["sha256"]["png"] = write_png(images / image["png"], dark, metadata={})
    (images / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    ran = inspect(cli, bench, images)
    assert ran.status == 2
    assert "posture (0°, 0°): the images do not look like this part" in ran.err
    assert "they are black: " in ran.err


def test_a_black_level_that_is_off_is_reported(cli, bench, images):
    manifest = json.loads((images / "manifest.json").read_text(encoding="utf-8"))
    for image in manifest["images"]:
        levels = np.minimum(read_png(images / image["png"]).astype(np.int64) + 9, 255).astype(np.uint8)
        image["sha256"]["png"] = write_png(images / image["png"], levels, metadata={})
    (images / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    ran = inspect(cli, bench, images, "--fusion", "none")
    assert ran.status == 0
    reported = re.search(r"black is ([0-9.]+) sensor levels above the rig's black_level of 0; the difference", ran.err)
    assert reported is not None
    assert float(reported.group(1)) == pytest.approx(9.0, abs=0.7)


def test_images_that_are_saturated_all_over_are_refused(cli, bench, images):
    manifest = json.loads((images / "manifest.json").read_text(encoding="utf-8"))
    for image in manifest["images"]:
        full = np.full((120, 160), 255, np.uint8)
        image["sha256"]["png"] = write_png(images / image["png"], full, metadata={})
    (images / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    ran = inspect(cli, bench, images, "--fail-on-defect")
    assert ran.status == 2
    assert "evaluable pixels of the part are saturated in each of 2 images" in ran.err
    assert "shorter exposure" in ran.err
    assert not (bench.out / "defects.json").exists()


def test_a_posture_without_a_pixel_to_judge_is_said_and_no_good_part(cli, bench, parts, monkeypatch):
    from dataclasses import replace

    from lightopt.inspection.prediction import _prediction_cache as _predictions

    def nothing_clean(*given, **more):
        found = predict(*given, **more)
        return replace(found, clean=np.zeros_like(found.clean))

    predict = _predictions.predict
    monkeypatch.setattr(_predictions, "predict", nothing_clean)
    ran = inspect(cli, bench, parts["good"], "--fail-on-defect")
    assert ran.status == 1
    assert "posture (0°, 0°): no pixel shows the part off its edges; nothing was inspected" in ran.err
    assert "NG, nothing of the surface was inspected" in ran.err
    assert found(bench)["postures"][0]["surface"]["inspected"] == 0.0


def test_sets_of_exr_alone_will_do(cli, bench, parts, tmp_path):
    out = shutil.copytree(parts["bad"], tmp_path / "linear")
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    for image in manifest["images"]:
        (out / image["png"]).unlink()
        del image["png"], image["sha256"]["png"]
    (out / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    ran = inspect(cli, bench, out, "--fusion", "none")
    assert (ran.status, ran.err) == (0, "")
    truth = read_image_set(parts["bad"]).manifest.extra["defects"]
    places = [one["position_mm"] for one in found(bench)["defects"]]
    assert len(places) == 2
    for one in truth:
        assert min(math.dist(place, one["position_mm"]) for place in places) < 2.0


def test_sixteen_bits_and_exposures_and_sets_without_exr_will_do(cli, bench, tmp_path):
    bench.edit("rig.yaml", "bit_depth: 8, read_noise_levels: 0.8", "bit_depth: 16, read_noise_levels: 90")
    bench.edit("rig.yaml", "electrons_per_level: 60", "electrons_per_level: 0.4")
    text = bench.part.read_text(encoding="utf-8")
    bench.part.write_text(text + DEFECTS, encoding="utf-8")
    out = rendered(bench, tmp_path / "deep", "--exposure", "1,1/16", *FIRST)
    for path in out.rglob("light*.exr"):
        path.unlink()
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    for image in manifest["images"]:
        del image["exr"], image["sha256"]["exr"]
    (out / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    assert inspect(cli, bench, out, "--fusion", "none", "--quiet").status == 0
    assert len(found(bench)["defects"]) == 2


@pytest.mark.parametrize(
    ("option", "said"),
    [
        (("--detector", "magic"), "--detector: expected residual or catalogue or template"),
        (("--fusion", "mean"), "--fusion: expected paper, median, minimum, second-largest or none"),
        (("--false-alarms", "0"), "--false-alarms: expected a number from 1e-9 to 1"),
        (("--min-images", "0"), "--min-images: expected"),
        (("--threads", "0"), "--threads: expected"),
        (("--detector", "template", "--fusion", "none"), "--fusion must not be none"),
    ],
)
def test_wrong_options_are_named(cli, bench, parts, option, said):
    ran = inspect(cli, bench, parts["good"], *option)
    assert ran.status == 2
    assert said in ran.err
    assert not bench.out.exists()
