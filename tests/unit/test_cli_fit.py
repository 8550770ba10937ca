"""``lightopt fit-diffuse`` and ``fit-specular``: files, words and refusals."""

from __future__ import annotations

import json
import re
import shutil

import numpy as np
import pytest

from lightopt import load_part, load_rig
from lightopt.images import read_image_set, read_png, write_png

pytestmark = pytest.mark.usefixtures("few_pixels_for_the_rest")
GUESS = ("R_d: 45.0, R_s: 12500, sigma_rad: 0.0475", "R_d: 30, R_s: 500, sigma_rad: 0.1")


@pytest.fixture
def cli(cli):
    """Fits look at few pixels here: what is tested are files, words and refusals."""

    def command(name, *arguments):
        few = ("--pixels", 1500) if name.startswith("fit-") and "--pixels" not in arguments else ()
        return cli(name, *arguments, *few)

    return command


@pytest.fixture(scope="module")
def measured(shared_bench, tmp_path_factory):
    """Noisy images of the knob."""
    from lightopt.cli._main import run

    out = tmp_path_factory.mktemp("measured") / "set"
    command = ["render", shared_bench.rig, shared_bench.part, "-o", out, "-q", "--patches", "500", "--noise", "5"]
    assert run([str(word) for word in (*command, "--exposure", "1,1/16")]) == 0
    return out


@pytest.fixture
def images(measured, bench):
    """A copy to spoil, beside a part file that knows nothing."""
    bench.edit("part.yaml", *GUESS)
    return shutil.copytree(measured, bench.folder / "images")


def spoil(images, change, where=lambda entry: True):
    """Change the PNGs of a set, and its hashes with them."""
    path = images / "manifest.json"
    manifest = json.loads(path.read_text())
    for entry in manifest["images"]:
        if where(entry):
            file = images / entry["png"]
            levels = np.ascontiguousarray(change(read_png(file)))
            entry["sha256"]["png"] = write_png(file, levels, metadata={})
    path.write_text(json.dumps(manifest))


def edit_manifest(images, change):
    path = images / "manifest.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))


# --- the way through


@pytest.mark.slow
def test_diffuse_then_specular_recovers_the_truth(cli, bench, images):
    first = cli("fit-diffuse", bench.rig, bench.part, images, "-o", bench.folder / "d", "--pixels", 5000)
    assert (first.status, first.err) == (0, "")
    part = bench.folder / "d" / "part.fitted.yaml"
    assert load_part(part).reflectance.R_d == pytest.approx(45.0, rel=0.01)
    assert load_part(part).reflectance.R_s == 500
    second = cli("fit-specular", bench.rig, part, images, "-o", bench.folder / "s", "--pixels", 5000)
    assert (second.status, second.err) == (0, "")
    fitted = load_part(bench.folder / "s" / "part.fitted.yaml").reflectance
    assert fitted.R_d == load_part(part).reflectance.R_d
    assert fitted.R_s == pytest.approx(12500, rel=0.02)
    assert fitted.sigma_rad == pytest.approx(0.0475, rel=0.01)
    assert "95 % interval" in second.out
    assert "each light predicted from the others" in second.out
    figures = json.loads((bench.folder / "s" / "fit.json").read_text())
    low, high = figures["values"]["R_s"]["interval_95"]
    assert low < 12500 < high
    assert len(figures["left_out"]) == 2
    assert all(image["rms_sensor_levels"] < 2.0 for left in figures["left_out"] for image in left["images"])
    assert len(list((bench.folder / "s" / "left-out").glob("*.png"))) == 8


@pytest.mark.slow
def test_only_the_fitted_values_of_the_part_change(cli, bench, images):
    text = bench.part.read_text().replace("postures:", "# a comment\npostures:")
    bench.part.write_text(text)
    ran = cli("fit-diffuse", bench.rig, bench.part, images, "-o", bench.folder, "-q")
    assert (ran.status, ran.out, ran.err) == (0, "", "")
    before, after = text.splitlines(), (bench.folder / "part.fitted.yaml").read_text().splitlines()
    assert [a for a, b in zip(after, before, strict=True) if a != b] == [after[-1]]
    assert after[-1].startswith("reflectance: {R_d: 4")
    assert after[-1].endswith(", R_s: 500, sigma_rad: 0.1}")


@pytest.mark.slow
def test_gain_and_dark_are_freed_and_written_to_the_rig(cli, bench, images):
    bench.edit("rig.yaml", "gain: 0.8", "gain: 1.1")
    spoil(images, lambda levels: np.minimum(levels.astype(int) + 3, 255).astype(np.uint8))
    ran = cli(
        "fit-specular", bench.rig, bench.part, images, "-o", bench.out, "--joint", "--free", "gain", "--free", "dark",
        "--no-validate",
    )  # fmt: skip
    assert ran.status == 0
    rig = load_rig(bench.out / "rig.fitted.yaml")
    assert rig.lights[1].gain == pytest.approx(0.8, rel=0.005)
    assert rig.lights[0].gain == 1.0
    assert rig.camera.sensor.black_level == pytest.approx(3.0, abs=0.05)
    assert load_part(bench.out / "part.fitted.yaml").reflectance.R_d == pytest.approx(45.0, rel=0.01)


@pytest.mark.slow
def test_numbers_of_points_are_compared_and_the_right_one_kept(cli, bench, images):
    ran = cli(
        "fit-specular", bench.rig, bench.part, images, "-o", bench.out, "--joint", "--points", "1,4",
        "--no-validate",
    )  # fmt: skip
    assert ran.status == 0
    figures = json.loads((bench.out / "fit.json").read_text())
    assert [row["points"] for row in figures["by_points"]] == [1, 4]
    assert figures["points"] == 4
    own = figures["by_points"][1]
    assert own["area_px"] == pytest.approx(own["measured_area_px"], rel=0.01)
    assert own["perimeter_px"] == pytest.approx(own["measured_perimeter_px"], rel=0.03)


@pytest.mark.slow
def test_the_papers_procedure(cli, bench, images):
    one = ("--method", "paper")
    coarse = ("--start-sigma", "0.03", "--sigma-step", "0.01")
    assert cli("fit-diffuse", bench.rig, bench.part, images, "-o", bench.folder / "d", *one).status == 0
    part = bench.folder / "d" / "part.fitted.yaml"
    assert load_part(part).reflectance.R_d == pytest.approx(45.0, rel=0.01)
    ran = cli("fit-specular", bench.rig, part, images, "-o", bench.folder / "s", *one, *coarse)
    assert ran.status == 0
    assert "this method gives no uncertainty" in ran.out
    figures = json.loads((bench.folder / "s" / "fit.json").read_text())["paper"]
    # the sweep only knows multiples of its step
    assert abs(figures["sigma_rad"] - 0.0475) <= 0.005
    assert figures["sweep"][0]["iterations"][0]["R_s"] == 255
    assert any(step["reached"] for step in figures["sweep"])


@pytest.mark.slow
def test_the_same_fit_again_gives_the_same_bytes(cli, bench, images, snapshot):
    command = ("fit-specular", bench.rig, bench.part, images, "-o", bench.out, "--joint", "--no-validate")
    assert cli(*command, "--threads", "1").status == 0
    first = snapshot(bench.out)
    assert cli(*command, "--threads", "2").status == 0
    assert snapshot(bench.out) == first


@pytest.mark.slow
def test_a_fit_of_other_inputs_is_not_replaced(cli, bench, images):
    command = ("fit-diffuse", bench.rig, bench.part, images, "-o", bench.out)
    assert cli(*command).status == 0
    refused = cli(*command, "--free", "dark")
    assert refused.status == 2
    assert "use --force" in refused.err
    assert cli(*command, "--free", "dark", "--force").status == 0


@pytest.mark.slow
@pytest.mark.parametrize("points", ["4", pytest.param("auto", marks=pytest.mark.nightly)])
def test_a_part_that_lies_a_little_off_is_found(cli, bench, tmp_path, points):
    bench.edit("part.yaml", "translate_mm: [0, 0, 0]", "translate_mm: [0.8, -0.6, 0], rotate_deg: [0, 0, 1]")
    bench.edit("rig.yaml", "points: 4", f"points: {points}")
    exposures = ("--exposure", "1,1/16", "--patches", "500", "--noise", "2", "-q")
    once = ("--posture", "0,0")
    assert cli("render", bench.rig, bench.part, "-o", tmp_path / "off", *exposures, *once).status == 0
    bench.edit("part.yaml", "translate_mm: [0.8, -0.6, 0], rotate_deg: [0, 0, 1]", "translate_mm: [0, 0, 0]")
    bench.edit("part.yaml", *GUESS)
    command = ("fit-specular", bench.rig, bench.part, tmp_path / "off", "--joint", "--no-validate")
    nominal = cli(*command, "-o", tmp_path / "nominal")
    assert nominal.status == 2
    assert "Register the part" in nominal.err
    reported = re.search(r"shifted by ([0-9.]+) px", nominal.err)
    assert reported is not None
    # 1 mm, at 0.44 mm a pixel
    assert float(reported[1]) == pytest.approx(1.0 / 0.44, rel=0.1)
    ran = cli(*command, "-o", bench.out, "--register")
    assert ran.status == 0
    fitted = load_part(bench.out / "part.fitted.yaml").reflectance
    assert fitted.R_d == pytest.approx(45.0, rel=0.01)
    assert fitted.R_s == pytest.approx(12500, rel=0.02)
    assert fitted.sigma_rad == pytest.approx(0.0475, rel=0.01)
    placement = json.loads((bench.out / "fit.json").read_text())["placement"]
    print("found", placement, fitted)
    # the anchor centres the bounding box of the turned part, which is (-0.0036, 0.0059) mm beside that of the part
    assert placement["x_mm"] == pytest.approx(0.80364, abs=5.0 * placement["x_error_mm"])
    assert placement["y_mm"] == pytest.approx(-0.60593, abs=5.0 * placement["y_error_mm"])
    assert placement["turn_deg"] == pytest.approx(1.0, abs=5.0 * placement["turn_error_deg"])
    assert placement["x_error_mm"] < (0.0012 if points == "auto" else 0.001)
    # and the part file says so itself
    lies = load_part(bench.out / "part.fitted.yaml").placement
    assert lies.translate_mm == pytest.approx((0.8, -0.6, 0.0), abs=0.02)
    assert lies.rotate_deg == pytest.approx((0.0, 0.0, 1.0), abs=0.05)


# --- what is said


@pytest.mark.slow
def test_images_that_hardly_separate_the_two_ask_for_a_shorter_exposure(cli, bench, images):
    edit_manifest(images, lambda m: m.update(images=[e for e in m["images"] if e["exposure"] == 1][:2]))
    ran = cli("fit-specular", bench.rig, bench.part, images, "-o", bench.out, "--joint", "--pixels", "2500")
    assert ran.status == 0
    assert "hardly separate R_s from σ" in ran.err
    assert "add a shorter exposure" in ran.err


@pytest.mark.slow
def test_a_held_r_d_that_is_wrong_is_noticed(cli, bench, images):
    ran = cli("fit-specular", bench.rig, bench.part, images, "-o", bench.out, "--no-validate")
    assert "R_d is held at 30" in ran.err
    assert "fit R_d as well" in ran.err


@pytest.mark.slow
def test_point_lights_fitted_to_an_evenly_lit_panel_are_noticed(cli, bench, tmp_path):
    bench.edit("rig.yaml", "points: 4", "points: auto")
    exposures = ("--exposure", "1,1/16", "--patches", "500", "--noise", "2", "-q")
    assert cli("render", bench.rig, bench.part, "-o", tmp_path / "even", *exposures).status == 0
    bench.edit("rig.yaml", "points: auto", "points: 4")
    command = ("fit-specular", bench.rig, bench.part, tmp_path / "even", "--joint", "--no-validate")
    ran = cli(*command, "-o", tmp_path / "four")
    assert ran.status == 0
    assert "evenly lit panels describe these images better than 4 points" in ran.err
    reported = float(ran.err.partition("R_s would be about ")[2].split()[0])
    assert reported == pytest.approx(12500, rel=0.02)
    assert "evenly lit" not in cli(*command, "-o", tmp_path / "auto", "--points", "auto").err


@pytest.mark.slow
def test_images_of_point_lights_want_no_evenly_lit_panel(cli, bench, images):
    ran = cli("fit-specular", bench.rig, bench.part, images, "-o", bench.out, "--joint", "--no-validate")
    assert (ran.status, ran.err) == (0, "")


@pytest.mark.slow
def test_force_leaves_nothing_of_the_fit_before(cli, bench, images):
    command = ("fit-specular", bench.rig, bench.part, images, "-o", bench.out, "--joint", "-q")
    assert cli(*command, "--free", "gain", "--pixels", "2500").status == 0
    assert (bench.out / "rig.fitted.yaml").exists()
    assert list((bench.out / "left-out").glob("*.png"))
    (bench.out / "notes.txt").write_text("mine")
    assert cli(*command, "--no-validate", "--force").status == 0
    listed = {*json.loads((bench.out / "fit.json").read_text())["files"], "fit.json", "notes.txt"}
    assert {p.relative_to(bench.out).as_posix() for p in bench.out.rglob("*") if p.is_file()} == listed
    assert "rig.fitted.yaml" not in listed


@pytest.mark.slow
def test_what_validation_keeps_is_said(cli, bench, images):
    ran = cli(
        "fit-specular", bench.rig, bench.part, images, "-o", bench.out, "--joint", "--free", "gain", "--pixels", "2500"
    )  # fmt: skip
    assert "each light predicted from the others (its own gain from all images):" in ran.out
    figures = json.loads((bench.out / "fit.json").read_text())
    assert figures["not_left_out"] == ["its own gain"]
    gain = figures["gains"]["light3"]
    assert gain["interval_95"][0] < 0.8 < gain["interval_95"][1]
    assert 0.0 < gain["standard_error"] < 0.03
    assert figures["gains"]["light1"]["interval_95"] is None


@pytest.mark.slow
def test_a_black_level_below_zero_is_not_hidden(cli, bench, images):
    # the camera takes two levels off, and what was clipped at 255 with them
    spoil(images, lambda levels: np.maximum(levels.astype(int) - 2, 0).astype(np.uint8))
    edit_manifest(images, lambda manifest: manifest.update(saturation_level=253))
    bench.edit("rig.yaml", "bit_depth: 8", "bit_depth: 8, saturation_level: 253")
    ran = cli(
        "fit-specular", bench.rig, bench.part, images, "-o", bench.out, "--joint", "--free", "dark", "--no-validate"
    )  # fmt: skip
    assert ran.status == 0
    assert "the fitted black level is -" in ran.err
    assert load_rig(bench.out / "rig.fitted.yaml").camera.sensor.black_level == 0.0
    assert json.loads((bench.out / "fit.json").read_text())["black_level"]["value"] == pytest.approx(-2, abs=0.1)


@pytest.mark.nightly
def test_the_papers_procedure_compares_numbers_of_points(cli, bench, images):
    ran = cli(
        "fit-specular", bench.rig, bench.part, images, "-o", bench.out, "--method", "paper", "--points", "1,4"
    )  # fmt: skip
    assert ran.status == 0
    figures = json.loads((bench.out / "fit.json").read_text())
    assert [row["points"] for row in figures["by_points"]] == [1, 4]
    assert [row["mean_log_likelihood"] for row in figures["by_points"]] == [None, None]
    deviation = {
        row["points"]: abs(row["area_px"] / row["measured_area_px"] - 1)
        + abs(row["perimeter_px"] / row["measured_perimeter_px"] - 1)
        for row in figures["by_points"]
    }
    assert figures["points"] == min(deviation, key=lambda m: deviation[m])


# --- refusals


def refused(cli, bench, images, *words, command="fit-specular", options=()):
    ran = cli(command, bench.rig, bench.part, images, "-o", bench.out, *options)
    assert ran.status == 2
    assert "Traceback" not in ran.err
    for word in words:
        assert word in ran.err
    assert not (bench.out / "fit.json").exists()


def test_images_of_another_size(cli, bench, images):
    bench.edit("rig.yaml", "[160, 120]", "[176, 120]")
    refused(cli, bench, images, "160 × 120 px", "176 × 120 px", "resolution_px", "and 7 images more")


def test_a_folder_without_manifest_is_reported_what_to_do(cli, bench, images, tmp_path):
    (images / "manifest.json").rename(images / "renamed.json")
    refused(cli, bench, images, "no manifest.json", "docs/reference/conventions.md")
    refused(cli, bench, images / "renamed.txt", "renamed.txt")
    (images / "renamed.json").rename(images / "manifest.json")
    refused(cli, bench, images.parent, "no image set, but these folders in it are", str(images))
    picture = next(images.rglob("*.png"))
    refused(cli, bench, picture, "not text; expected an image set's folder or its manifest.json")


def test_lights_that_the_rig_does_not_have(cli, bench, images):
    bench.edit("rig.yaml", "name: light3", "name: light4")
    refused(cli, bench, images, 'light "light3" is not in', "light1, light4")


def test_lights_that_stood_elsewhere(cli, bench, images):
    bench.edit("rig.yaml", "elevation_deg: 45, azimuth_deg: 225", "elevation_deg: 50, azimuth_deg: 225")
    refused(cli, bench, images, "light3 stood at elevation 45°", "50°")


def test_postures_out_of_the_stages_range(cli, bench, images):
    bench.edit("rig.yaml", "elevation_range_deg: [-45, 45]", "elevation_range_deg: [-5, 45]")
    bench.edit("part.yaml", ", {elevation_deg: -10, rotation_deg: 170}", "")
    refused(cli, bench, images, "elevation -10° is outside the stage's range")


def test_another_bit_depth(cli, bench, images):
    bench.edit("rig.yaml", "bit_depth: 8", "bit_depth: 12")
    refused(cli, bench, images, "images of 8 bits", "12")


@pytest.mark.parametrize("command", ["fit-diffuse", "fit-specular"])
@pytest.mark.parametrize(("level", "word"), [(255, "is saturated"), (0, "is black")])
def test_every_pixel_saturated_or_black(cli, bench, images, command, level, word):
    spoil(images, lambda levels: np.full_like(levels, level))
    refused(cli, bench, images, word, "exposure", command=command)


def test_no_saturated_pixel_for_the_papers_method(cli, bench, images):
    spoil(images, lambda levels: np.minimum(levels, 250))
    refused(cli, bench, images, "no saturated pixel", options=("--method", "paper"))


def test_no_diffuse_only_pixel_for_the_papers_method(cli, bench, images):
    options = ("--method", "paper", "--highlight-margin", "89")
    refused(cli, bench, images, "no diffuse-only pixel", command="fit-diffuse", options=options)


@pytest.mark.slow
def test_lights_that_were_exchanged_are_reported(cli, bench, images):
    def exchange(manifest):
        for entry in manifest["images"]:
            entry["light"] = {"light1": "light3", "light3": "light1"}[entry["light"]]
        places = {entry["light"]: entry for entry in manifest["images"]}
        for name, angles in (("light1", (60, 45)), ("light3", (45, 225))):
            assert name in places
            for entry in manifest["images"]:
                if entry["light"] == name:
                    entry["light_elevation_deg"], entry["light_azimuth_deg"] = angles

    edit_manifest(images, exchange)
    # one posture is enough
    edit_manifest(images, lambda m: m.update(images=[e for e in m["images"] if e["posture"]["rotation_deg"] == 0]))
    refused(cli, bench, images, "with light1 and light3 exchanged: check the wiring", options=("--joint",))


@pytest.mark.nightly
def test_mirrored_images_are_reported(cli, bench, images):
    spoil(images, lambda levels: levels[:, ::-1])
    refused(cli, bench, images, "do not look like this part", "mirrored left to right", options=("--joint",))


@pytest.mark.nightly
def test_the_papers_procedure_refuses_images_of_another_part_too(cli, bench, images):
    spoil(images, lambda levels: levels[:, ::-1])
    refused(cli, bench, images, "do not look like this part", "mirrored", options=("--method", "paper"))


@pytest.mark.parametrize(
    ("option", "value", "word"),
    [
        ("--sigma-step", "1e-7", "expected 0.0002 rad or more"),
        ("--start-sigma", "5", "expected 0.001 to 0.2 rad, found 5"),
        ("--start-rs", "0", "--start-rs: expected a number above 0"),
        ("--lambda-s1", "nan", "--lambda-s1: expected a number above 0"),
    ],
)
def test_impossible_options_of_the_paper(cli, bench, images, option, value, word):
    refused(cli, bench, images, word, options=("--method", "paper", option, value))


def test_options_of_the_paper_without_its_method(cli, bench, images):
    refused(cli, bench, images, "--sigma-step: has no effect without --method paper", options=("--sigma-step", "0.001"))


@pytest.mark.slow
def test_shifted_images_are_reported(cli, bench, images):
    # where the stage has turned the part, no place of the part shifts all images alike
    edit_manifest(
        images, lambda m: m.update(images=[e for e in m["images"] if e["exposure"] == 1 and e["light"] == "light1"])
    )
    spoil(images, lambda levels: np.roll(levels, 4, axis=1))
    reported = ("do not look like this part", "in posture (0°, 0°), with the part shifted by", "correct the camera")
    refused(cli, bench, images, *reported, options=("--joint",))


@pytest.mark.slow
def test_one_light_alone_is_fitted_and_not_validated(cli, bench, images):
    edit_manifest(images, lambda m: m.update(images=[e for e in m["images"] if e["light"] == "light1"][:2]))
    ran = cli("fit-specular", bench.rig, bench.part, images, "-o", bench.out, "--joint")
    assert ran.status == 0
    assert "no validation: it leaves out one light" in ran.err


def test_options_that_are_wrong_are_all_named(cli, bench, images):
    refused(cli, bench, images, "--free:", "--points:", options=("--free", "sigma", "--points", "5"))
    for option, value in (("--method", "guess"), ("--pixels", "3"), ("--threads", "0")):
        refused(cli, bench, images, f"{option}: expected", options=(option, value))


def test_a_set_without_images(cli, bench, images):
    edit_manifest(images, lambda m: m.update(images=[]))
    refused(cli, bench, images, "lists no images")


@pytest.mark.slow
def test_exr_only_images_are_read(cli, bench, images):
    def drop(manifest):
        manifest["images"] = [e for e in manifest["images"] if e["exposure"] == 1]
        for entry in manifest["images"]:
            del entry["png"], entry["sha256"]["png"]

    edit_manifest(images, drop)
    assert read_image_set(images).images[0].png is None
    ran = cli(
        "fit-specular", bench.rig, bench.part, images, "-o", bench.out, "--joint", "--no-validate", "--pixels", 8000
    )  # fmt: skip
    assert ran.status == 0
    fitted = load_part(bench.out / "part.fitted.yaml").reflectance
    assert fitted.R_d == pytest.approx(45.0, rel=0.005)
    assert fitted.R_s == pytest.approx(12500, rel=0.02)


# ---- forms of the lobe


@pytest.mark.slow
def test_the_form_of_the_lobe_is_chosen_and_written(cli, bench):
    bench.edit("part.yaml", "R_s: 12500, sigma_rad: 0.0475", "model: ggx, R_s: 9000, alpha: 0.08")
    images = bench.folder / "images"
    rendered = cli("render", bench.rig, bench.part, "-o", images, "-q", "--noise", 2, "--exposure", "1,1/16")
    assert rendered.status == 0, rendered.err
    bench.edit("part.yaml", "model: ggx, R_s: 9000, alpha: 0.08", "R_s: 500, sigma_rad: 0.1")
    options = ("--joint", "--model", "auto", "--pixels", 8000)
    found = cli("fit-specular", bench.rig, bench.part, images, "-o", bench.out, *options)
    assert found.status == 0, found.err
    assert re.search(r"ggx .*selected", found.out)
    rows = {row["model"]: row for row in json.loads((bench.out / "fit.json").read_text())["by_model"]}
    assert list(rows) == ["torrance-sparrow", "ggx", "two-lobe"]
    wrong = rows["torrance-sparrow"]["left_out_rms_sensor_levels"]
    assert wrong > 2.0 * rows["ggx"]["left_out_rms_sensor_levels"]
    reflectance = load_part(bench.out / "part.fitted.yaml").reflectance
    assert (reflectance.model, reflectance.sigma_rad) == ("ggx", None)
    assert reflectance.alpha == pytest.approx(0.08, rel=0.02)


@pytest.mark.slow
def test_the_form_of_the_diffuse_component_is_fitted_and_written(cli, bench):
    bench.edit("part.yaml", "R_d: 45.0", "R_d: 90, diffuse_exponent: 1.4")
    images = bench.folder / "images"
    rendered = cli("render", bench.rig, bench.part, "-o", images, "-q", "--noise", 2, "--exposure", "1,1/16")
    assert rendered.status == 0, rendered.err
    bench.edit("part.yaml", "R_d: 90, diffuse_exponent: 1.4", "R_d: 30, oren_nayar_roughness: 0.3")
    options = ("--joint", "--pixels", 5000, "--no-validate", "--diffuse")
    for form, key in (("exponent", "diffuse_exponent"), ("lambert", None)):
        out = bench.folder / form
        found = cli("fit-specular", bench.rig, bench.part, images, "-o", out, *options, form)
        assert found.status == 0, found.err
        reflectance = load_part(out / "part.fitted.yaml").reflectance
        assert reflectance.oren_nayar_roughness is None
        if key is None:
            assert reflectance.diffuse_exponent is None
        else:
            assert reflectance.diffuse_exponent == pytest.approx(1.4, rel=0.01)
            assert reflectance.R_d == pytest.approx(90.0, rel=0.01)
            assert re.search(rf"{key} +1\.", found.out)
        written = json.loads((out / "fit.json").read_text())["diffuse"]
        assert written["exponent"] == pytest.approx(reflectance.diffuse_exponent or 1.0, rel=1e-4)
        assert written["oren_nayar_roughness"] == 0.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--model", "phong"], ["--model", "ggx", "phong"]),
        (["--diffuse", "phong"], ["--diffuse", "oren-nayar", "phong"]),
        (["--diffuse", "exponent"], ["another R_d", "joint"]),
        (["--diffuse", "exponent", "--joint", "--method", "paper"], ["--method paper"]),
        (["--method", "paper", "--model", "auto"], ["--method paper", "one Gaussian lobe"]),
        (["--method", "paper", "--model", "ggx"], ["one Gaussian lobe", "ggx"]),
    ],
)
def test_forms_of_the_lobe_that_cannot_be_fitted(cli, bench, images, options, words):
    ran = cli("fit-specular", bench.rig, bench.part, images, "-o", bench.out, *options)
    assert ran.status == 2
    assert all(word in ran.err for word in words), ran.err


def test_no_form_of_the_lobe_is_chosen_by_one_light(cli, bench, images):
    edit_manifest(images, lambda m: m.update(images=[i for i in m["images"] if i["light"] == "light1"]))
    ran = cli("fit-specular", bench.rig, bench.part, images, "-o", bench.out, "--model", "auto")
    assert ran.status == 2
    assert "at least two lights" in ran.err
