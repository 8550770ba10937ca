"""``lightopt optimize --objective detectability``: results, blind spots as files, running again, bad input."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from test_cli_optimize import BARE, FEW, result_of, with_lights

from lightopt import build_scene
from lightopt.cli._main import run
from lightopt.config import load_part, load_rig
from lightopt.core.transforms import Posture
from lightopt.design import BlindReason, blind_text
from lightopt.design._problem import images_that_decide
from lightopt.design.responses._image_evaluator import ImageEvaluator
from lightopt.images import read_png
from lightopt.rendering import build_patches, cast_rays_at
from lightopt.scene import build_lights

LIGHTS = ("light1", "light2", "light3")
DEFECTS = ("--objective", "detectability", "--objective", "paper", "--min-images", "2", "--false-alarms", "0.2")


@pytest.fixture
def three(bench):
    return with_lights(bench)


@pytest.fixture(scope="module")
def planned(shared_bench, tmp_path_factory):
    bench = with_lights(type(shared_bench).make(tmp_path_factory.mktemp("planned") / "bench"))
    options = (*FEW, *DEFECTS, "--lights-per-posture", "--no-images", "--keep-matrix")
    command = ["optimize", bench.rig, bench.part, "-o", bench.out, *options]
    assert run([str(part) for part in command]) == 0
    return bench


def ply_of(path):
    """Header lines, vertices and faces of a PLY file as this package writes it."""
    data = path.read_bytes()
    head, body = data.split(b"end_header\n", 1)
    lines = head.decode("ascii").splitlines()
    count = {line.split()[1]: int(line.split()[2]) for line in lines if line.startswith("element")}
    vertices = np.frombuffer(body, "<f4", 3 * count["vertex"]).reshape(-1, 3)
    kinds = [("n", "u1"), ("corners", "<i4", 3), ("colour", "u1", 3), ("seen", "<f4"), ("code", "u1")]
    kinds += [("reachable", "<f4"), ("reachable_code", "u1")]
    faces = np.frombuffer(body[vertices.nbytes :], np.dtype(kinds))
    assert len(faces) == count["face"]
    return lines, vertices, faces


@pytest.mark.slow
def test_result_has_scores_kinds_directions_and_blind_spots(planned):
    result = result_of(planned.out)
    assert result["provenance"]["options"]["min_images"] == 2
    assert result["provenance"]["options"]["false_alarms"] == 0.2
    for one in result["results"]:
        found, paper = one["objectives"]
        assert found["objective"] == "detectability"
        assert found["min_images"] == 2
        assert found["complete"]
        kinds = found["defects"]
        assert list(kinds) == ["scratch", "dent", "bump", "pit", "blister", "stain", "haze"]
        assert found["share_of_inspectable_area"] == pytest.approx(np.mean(list(kinds.values())), abs=1e-5)
        assert found["worst_defect"] == min(kinds, key=kinds.get)
        assert len(found["directions_deg"]) == 8
        assert found["score"] >= paper["scores_under"]["detectability"]
        assert found["bound"] == found["score"]
    spots = result["blind_spots"]
    assert spots["min_images"] == 2
    for part in (spots, *spots["postures"]):
        for lights in ("chosen", "any_position"):
            own = part[lights]
            assert own["seen"] + sum(r["share"] for r in own["blind"]) == pytest.approx(1.0, abs=1e-5)
        assert part["chosen"]["seen"] <= part["any_position"]["seen"]
    assert max(p["chosen"]["seen"] for p in spots["postures"]) <= spots["chosen"]["seen"]
    for one, part in zip(result["results"], spots["postures"], strict=True):
        seen = one["objectives"][0]["score"] / (7 * 8) * 1e-6
        counted = spots["surface_mm2"] * (1.0 - part["chosen"]["left_out_of_surface"])
        assert part["chosen"]["seen"] * counted == pytest.approx(seen, rel=1e-4)
        assert part["chosen"]["left_out_of_surface"] > 0.0


def test_table_and_surface_say_the_same_in_the_part_files_coordinates(planned):
    spots = result_of(planned.out)["blind_spots"]
    with (planned.out / "blind.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    own = [r for r in rows if (r["postures"], r["lights"]) == ("all", "chosen")]
    whole = {r["what"]: float(r["share"]) for r in own if r["share_of"] != "surface"}
    (left_out,) = (r for r in own if r["share_of"] == "surface")
    assert whole["found"] == pytest.approx(spots["chosen"]["seen"], abs=1e-6)
    assert sum(whole.values()) == pytest.approx(1.0, abs=1e-5)
    assert left_out["what"] == "left out: at a grazing angle or an edge"
    assert float(left_out["share"]) == pytest.approx(spots["chosen"]["left_out_of_surface"], abs=1e-6)
    assert sum(float(r["area_mm2"]) for r in own) == pytest.approx(spots["surface_mm2"], rel=1e-4)
    lines, vertices, faces = ply_of(planned.out / "blind.ply")
    assert any("lengths in mm, coordinates of the part's own file" in line for line in lines)
    assert [line for line in lines if line.startswith("comment code 6")] == ["comment code 6: saturated by light2"]
    scene = build_scene(planned.rig, planned.part)
    low, high = scene.mesh.bounds
    own = np.array([scene.placement.to_file(np.array(corner)) for corner in (low, high)])
    np.testing.assert_allclose(vertices.min(axis=0), own.min(axis=0), atol=1e-3)
    np.testing.assert_allclose(vertices.max(axis=0), own.max(axis=0), atol=1e-3)
    a, b, c = (vertices[faces["corners"][:, k]].astype(float) for k in range(3))
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    assert areas.sum() == pytest.approx(spots["surface_mm2"], rel=1e-4)
    counted = areas[faces["code"] != BlindReason.GRAZING].sum()
    assert (areas * faces["seen"]).sum() / counted == pytest.approx(whole["found"], abs=1e-4)
    for code in np.unique(faces["code"]):
        lost = (areas * (1 - faces["seen"]))[faces["code"] == code].sum() / counted
        if code not in (BlindReason.SEEN, BlindReason.GRAZING):
            assert lost == pytest.approx(whole[blind_text(int(code), LIGHTS)], abs=1e-4)
    assert trimesh.load(planned.out / "blind.ply", process=False).faces.shape == (len(faces), 3)


def test_pictures_show_each_posture(planned):
    files = [entry["file"] for entry in result_of(planned.out)["files"]]
    pictures = ["posture_0_0/blind.png", "posture_-10_170/blind.png"]
    assert files == ["blind.csv", "blind.ply", *pictures, "report.html"]
    picture = read_png(planned.out / "posture_0_0" / "blind.png", colour=True)
    scene = build_scene(planned.rig, planned.part)
    height, width = scene.camera.height, scene.camera.width
    assert picture.shape[0] > height
    assert picture.shape[1] >= width
    view = picture[:height, :width].reshape(-1, 3).astype(float)
    part = view[(view < 255).any(axis=1)]
    assert 0.02 < len(part) / len(view) < 0.98
    # every pixel has the colour of the table at some brightness, or its pale one
    with (planned.out / "blind.csv").open(encoding="utf-8", newline="") as file:
        reported = {row["what"]: row["colour"] for row in csv.DictReader(file)}
    full = np.array([[int(text[k : k + 2], 16) for k in (1, 3, 5)] for text in reported.values()], float)
    colours = np.concatenate([full, (full + 255) // 2])
    shade = np.clip((part @ colours.T) / (colours**2).sum(axis=1), 0.8, 1.0)
    off = np.abs(part[:, None, :] - shade[:, :, None] * colours).max(axis=2)
    assert off.min(axis=1).max() <= 1.5
    # and those of the surface are the same
    _, _, faces = ply_of(planned.out / "blind.ply")
    assert {tuple(colour) for colour in faces["colour"].tolist()} <= {tuple(c) for c in colours.astype(int).tolist()}
    # below it the legend has the colours as they are
    legend = {tuple(colour) for colour in picture[height:].reshape(-1, 3).tolist()}
    here = {row for row in reported if blind_row(planned, row) > 0.0}
    assert {tuple(int(reported[row][k : k + 2], 16) for k in (1, 3, 5)) for row in here} <= legend


def blind_row(planned, what):
    """Share of a row of blind.csv in the first posture under the chosen lights."""
    with (planned.out / "blind.csv").open(encoding="utf-8", newline="") as file:
        rows = [(row["postures"], row["lights"], row["what"], row["share"]) for row in csv.DictReader(file)]
    return sum(float(row[3]) for row in rows if row[:3] == ("0,0", "chosen", what))


@pytest.mark.slow
def test_kept_matrices_are_reused_and_give_the_same_bytes(planned, cli, snapshot, monkeypatch):
    before = snapshot(planned.out)
    command = ("optimize", planned.rig, planned.part, "-o", planned.out, *FEW, *DEFECTS, "--no-images")
    ran = cli(*command, "--lights-per-posture", "--keep-matrix", "--threads", "1", "-v")
    assert ran.status == 0
    assert "2 stored luminance matrices reused" in ran.out
    assert "never seen by the camera" in ran.out
    assert "kind found worst" in ran.out
    assert snapshot(planned.out) == before


@pytest.mark.slow
def test_other_false_alarms_and_other_noise_are_other_matrices_and_other_results(three, cli):
    command = ("optimize", three.rig, three.part, "-o", three.out, *FEW, *BARE, "--posture", "0,0")
    command += ("--objective", "detectability", "--keep-matrix")
    assert cli(*command).status == 0
    loose = result_of(three.out)["results"][0]["objectives"][0]["score"]
    ran = cli(*command, "--false-alarms", "1e-9")
    assert ran.status == 2
    assert "options.false_alarms: previously 0.05, now 1e-09" in ran.err
    ran = cli(*command, "--false-alarms", "1e-9", "--force")
    assert ran.status == 0
    assert "reused" not in ran.out
    strict = result_of(three.out)["results"][0]["objectives"][0]["score"]
    assert strict < loose
    # levels alone are not mistaken for a matrix with defects, nor the other way round
    ran = cli(*command[:-3], "--keep-matrix", "--force")
    assert ran.status == 0
    assert "reused" not in ran.out
    assert "blind_spots" not in result_of(three.out)
    assert not list(three.out.rglob("blind.*"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--min-images", "2"), "--min-images: has no effect without --objective detectability"),
        (("--false-alarms", "1"), "--false-alarms: has no effect without --objective detectability"),
        (("--objective", "detectability", "--min-images", "0"), "--min-images: expected"),
        (("--objective", "detectability", "--min-images", "4"), "seen in 4 images, and the rig has 3 lights only"),
        (("--objective", "detectability", "--false-alarms", "0"), "--false-alarms: expected a number from 1e-9 to 1"),
        (("--objective", "detectability", "--false-alarms", "nan"), "--false-alarms: expected a number from 1e-9 to 1"),
    ],
)
def test_bad_options(three, cli, arguments, message):
    ran = cli("optimize", three.rig, three.part, "-o", three.out, *arguments)
    assert (ran.status, ran.out) == (2, "")
    assert message in ran.err
    assert not three.out.exists()


@pytest.mark.slow
def test_part_with_a_catalogue_of_its_own(three, cli):
    with three.part.open("a", encoding="utf-8") as file:
        file.write(
            "defect_catalogue:\n"
            "  - {name: <knock>, kind: dent, size_mm: 2, slope_deg: 10}\n"
            "  - {name: spot, kind: stain, size_mm: 2, R_d_factor: 0.2}\n"
        )
    command = ("optimize", three.rig, three.part, "-o", three.out, *FEW, *BARE, "--posture", "0,0", "-q")
    assert cli(*command, "--objective", "detectability").status == 0
    found = result_of(three.out)["results"][0]["objectives"][0]
    assert list(found["defects"]) == ["<knock>", "spot"]
    assert json.loads((three.out / "result.json").read_text(encoding="utf-8"))["blind_spots"]["min_images"] == 2


def test_where_the_surface_scatters_too_little_light_one_image_decides_and_it_is_said(three, cli):
    three.edit("part.yaml", "R_d: 45.0", "R_d: 0.5")
    command = ("optimize", three.rig, three.part, "-o", three.out, "--patches", "400", "--step", "30", *BARE)
    command += ("--posture", "0,0", "--objective", "detectability")
    ran = cli(*command)
    assert ran.status == 0, ran.err
    assert "the surface scatters too little light to be seen (R_d 0.5)" in ran.err
    assert "one image decides" in ran.err
    decided = result_of(three.out)
    (answer,) = decided["results"][0]["objectives"]
    options = decided["provenance"]["options"]
    assert {answer["min_images"], options["min_images"], decided["blind_spots"]["min_images"]} == {1}
    # it is the same result as if one image had been requested, which needs no warning
    ran = cli(*command, "--min-images", "1")
    assert ran.status == 0, ran.err
    assert "one image decides" not in ran.err
    requested = result_of(three.out)
    assert requested["provenance"]["options"] == options
    assert requested["results"] == decided["results"]
    # of levels alone nothing is decided
    assert "one image decides" not in cli(*command[:-2], "--force").err


def test_one_image_decides_where_the_brightest_scattered_light_drowns_in_noise(three):
    rig, part = load_rig(three.rig), load_part(three.part)

    def scattering(R_d):
        reflectance = part.reflectance.model_copy(update={"R_d": R_d, "R_s": 0.0})
        return part.model_copy(update={"reflectance": reflectance})

    def decides(R_d, longest=1.0):
        return images_that_decide(rig, scattering(R_d), 2, longest=longest)

    low, high = 1e-3, 45.0
    assert (decides(low), decides(high)) == (1, 2)
    while high > 1.001 * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if decides(middle) == 1 else (low, middle)
    # a longer exposure is as good as more light
    assert [decides(0.1 * low, longest) for longest in (1.0, 9.9, 10.1)] == [1, 1, 2]
    assert images_that_decide(rig, scattering(high), 3, longest=1.0) == 3
    assert images_that_decide(rig, scattering(low), 1, longest=1.0) == 1
    # thirty times as much light as is just not seen is nowhere brighter than thirty times three deviations
    scene = replace(build_scene(rig, scattering(30.0 * low)), postures=(Posture(0.0, 0.0),))
    caster = cast_rays_at(scene)
    table = build_patches(scene, caster=caster, budget=1000)
    evaluator = ImageEvaluator(scene=scene, table=table, caster=caster, detection=None)
    levels = evaluator.matrices(Posture(0.0, 0.0), [[light] for light in build_lights(rig)])[0].levels
    least = 3.0 * math.sqrt(scene.sensor.noise_variance(3.0))
    assert 0.7 * 30.0 * least < max(layer.max() for layer in levels) <= 1.05 * 30.0 * least


@pytest.mark.usefixtures("few_pixels_for_the_rest")
def test_a_calibration_gives_threshold_and_rate_and_must_be_of_the_same_inspection(three, cli):
    sets = []
    for seed in range(5):
        sets.append(three.folder / f"good-{seed}")
        few = ("--posture", "0,0", "--patches", "500")
        ran = cli("render", three.rig, three.part, "-o", sets[-1], "--noise", seed, *few)
        assert ran.status == 0, ran.err
    learned = three.folder / "learned"
    ran = cli(
        "inspect", three.rig, three.part, *sets, "-o", learned, "--calibrate", "--false-alarms", "0.5",
        "--min-images", "2", "--no-register",
    )  # fmt: skip
    assert ran.status == 0, ran.err
    options = (*FEW, *BARE, "--objective", "detectability", "--posture", "0,0", "--calibration", learned)
    ran = cli("optimize", three.rig, three.part, "-o", three.out, *options)
    assert (ran.status, ran.err.count("register")) == (2, 1)
    ran = cli(
        "inspect", three.rig, three.part, *sets, "-o", learned, "--calibrate", "--false-alarms", "0.5",
        "--min-images", "2", "--force",
    )  # fmt: skip
    assert ran.status == 0, ran.err
    ran = cli("optimize", three.rig, three.part, "-o", three.out, *options)
    assert ran.status == 0, ran.err
    result = result_of(three.out)
    chosen = result["provenance"]["options"]
    calibration = json.loads((learned / "calibration.json").read_text(encoding="utf-8"))
    assert chosen["false_alarms"] == 0.5
    assert chosen["calibration"]["score"] == pytest.approx(calibration["postures"][0]["threshold"], abs=1e-4)
    ran = cli("optimize", three.rig, three.part, "-o", three.out, *options, "--min-images", "1", "--force")
    assert ran.status == 2
    assert "--min-images: calibration.json was made with 2, found 1" in ran.err


def test_exposures_are_planned_on_the_same_surface_whatever_the_objective(bench, cli):
    # one position, so that the lights stand the same for both
    bench.edit("rig.yaml", "azimuth_deg: 45}", "azimuth_deg: 45, elevation_range_deg: [60, 60]}")
    shares = []
    for objective in ("detectability", "coverage"):
        out = bench.folder / objective
        options = ("--objective", objective, "--exposure", "1,1/4", "--posture", "0,0", "--min-images", "2", *BARE)
        ran = cli("optimize", bench.rig, bench.part, "-o", out, *options, *FEW)
        assert ran.status == 0, ran.err
        planned = result_of(out)["exposures"]
        # what the planned images show of each kind is known where defects are an objective
        assert ("defects" in planned) == (objective == "detectability")
        shares.append({key: value for key, value in planned.items() if key != "defects"})
    assert shares[0] == shares[1]
