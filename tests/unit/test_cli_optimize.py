"""``lightopt optimize`` and ``lightopt overlap``: what they write and say, running again, bad input."""

from __future__ import annotations

import csv
import json
import re
import shutil
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import trimesh
from designed import design

from lightopt.cli._main import run
from lightopt.config import load_part, load_rig
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.design import OptimizeOptions, area_text, design_tolerances, optimize, places_of
from lightopt.images import read_image_set, read_png

CONFIGS = Path(__file__).parents[2] / "configs"

LIGHTS = """\
lights:   # three of them
  - {name: light1, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45, elevation_range_deg: [40, 60]}
  - name: light2
    distance_mm: 330
    elevation_deg: 50.0    # the low one
    azimuth_deg: 165
    azimuth_range_deg: [155, 165]
  - {name: light3, distance_mm: 330, elevation_deg: 45, azimuth_deg: 285, elevation_range_deg: [45, 50]}
"""
FEW = ("--patches", "800", "--step", "10")
EACH = (*FEW, "--lights-per-posture", "--keep-matrix")
BARE = ("--no-images", "--no-report")
"""Where only figures are looked at: the report takes longer than a small search."""


def with_lights(bench, lights=LIGHTS):
    text = bench.rig.read_text(encoding="utf-8")
    head, rest = text.split("lights:\n", 1)
    stage = rest[rest.index("stage:") :]
    bench.rig.write_text(head + lights + stage, encoding="utf-8", newline="\n")
    return bench


@pytest.fixture
def three(bench):
    return with_lights(bench)


@pytest.fixture(scope="module")
def optimized(shared_bench, tmp_path_factory):
    """A result with images for both postures, that the tests of its content share."""
    bench = with_lights(type(shared_bench).make(tmp_path_factory.mktemp("optimized") / "bench"))
    assert run(["optimize", str(bench.rig), str(bench.part), "-o", str(bench.out), *EACH]) == 0
    return bench


def result_of(folder: Path):
    return json.loads((folder / "result.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_result_says_angles_scores_proof_and_provenance(optimized):
    result = result_of(optimized.out)
    assert result["format"] == "lightopt-optimum/1"
    assert result["provenance"]["inputs"]["rig"]["sha256"] == load_rig(optimized.rig).source.sha256
    assert result["thresholds"] == {"black": 0, "shaded_below": 10, "saturated_from": 255}
    assert [len(light["positions_deg"]) for light in result["candidates"]] == [3, 2, 2]
    assert str(optimized.folder) not in json.dumps(result)
    assert [len(group["postures"]) for group in result["results"]] == [1, 1]
    for group in result["results"]:
        assert [answer["objective"] for answer in group["objectives"]] == ["coverage", "paper"]
        for answer in group["objectives"]:
            assert answer["combinations"] == {
                "total": 12,
                "scored": 12,
                "excluded_by_bound": 0,
                "colliding": 0,
                "left": 0,
            }
            assert answer["proven"] is True
            assert answer["bound"] == answer["score"] == answer["scores_under"][answer["objective"]]
            assert answer["gap"] == answer["score"] - answer["runner_up"]["score"] >= 0
            assert [light["light"] for light in answer["lights"]] == ["light1", "light2", "light3"]
            others = [other["scores_under"][answer["objective"]] for other in group["objectives"]]
            assert max(others) == answer["score"], "no other objective's best set is better under this one"
        between = group["objectives"][0]["between_candidates"]
        assert between["bound"] >= group["objectives"][0]["score"]
        assert 0 <= between["excess_between"] < 0.1
        assert 0 < group["objectives"][0]["share_of_inspectable_area"] <= 1


def test_ranking_lists_all_combinations_in_order(optimized):
    with (optimized.out / "ranking.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 2 * 12
    first = [row for row in rows if row["postures"] == "0,0" and row["objective"] == "paper"]
    keys = [(-int(row["score"]), -int(row["usable_sum"])) for row in first]
    assert keys == sorted(keys)
    assert [row["rank"] for row in first] == [str(k) for k in range(1, 13)]
    assert {row["light2_elevation_deg"] for row in rows} == {"50"}
    best = result_of(optimized.out)["results"][0]["objectives"][1]["lights"]
    assert float(first[0]["light1_elevation_deg"]) == best[0]["elevation_deg"]


def test_rigs_keep_comments_and_take_the_angles(optimized):
    result = result_of(optimized.out)
    given = optimized.rig.read_text(encoding="utf-8").splitlines()
    for listed in result["rigs"]:
        path = optimized.out / listed["file"]
        text = path.read_text(encoding="utf-8").splitlines()
        assert len(text) == len(given)
        changed = [(a, b) for a, b in zip(given, text, strict=True) if a != b]
        assert all("elevation_deg" in a or "azimuth_deg" in a for a, _ in changed)
        assert "    elevation_deg: 50.0    # the low one" in text, "what is fixed stays as it was written"
        group = next(g for g in result["results"] if g["postures"][0] in listed["postures"])
        for light, best in zip(load_rig(path).lights, group["objectives"][0]["lights"], strict=True):
            assert (light.elevation_deg, light.azimuth_deg) == (best["elevation_deg"], best["azimuth_deg"])


def test_images_of_the_best_set_and_their_overlaps(optimized, cli, tmp_path):
    result = result_of(optimized.out)
    for listed in result["rigs"]:
        images = read_image_set((optimized.out / listed["file"]).parent / "images")
        assert [entry.posture.as_dict() for entry in images.images[::3]] == listed["postures"]
        rig = load_rig(optimized.out / listed["file"])
        angles = [(e.light_elevation_deg, e.light_azimuth_deg) for e in images.images[:3]]
        assert angles == [(light.elevation_deg, light.azimuth_deg) for light in rig.lights]
    overlap = result["overlaps"][0]
    levels = [images_of(optimized, result, 0)[k] for k in range(3)]
    assert overlap["saturated_px"] == {f"light{k + 1}": int((levels[k] >= 255).sum()) for k in range(3)}
    both = int(((levels[0] >= 255) & (levels[1] >= 255)).sum())
    assert overlap["overlap_px"][0] == {"lights": ["light1", "light2"], "px": both}
    # the same from the command for a captured set
    folder = (optimized.out / result["rigs"][0]["file"]).parent / "images"
    ran = cli("overlap", folder, "-o", tmp_path / "o")
    assert (ran.status, ran.err) == (0, "")
    again = json.loads((tmp_path / "o" / "overlap.json").read_text(encoding="utf-8"))
    assert {"map": overlap["map"], **again["overlaps"][0]} == overlap
    assert again["files"] == ["posture_0_0/overlap.png"]
    drawn = read_png(tmp_path / "o" / "posture_0_0" / "overlap.png", colour=True)
    assert drawn.shape == (120, 160, 3)
    several = np.sum([level >= 255 for level in levels], axis=0)
    assert np.array_equal((drawn == (70, 110, 190)).all(axis=2), several == 1)
    assert cli("overlap", folder, "-o", tmp_path / "o", "-q").status == 0, "the same maps again"


def images_of(bench, result, index):
    images = read_image_set((bench.out / result["rigs"][index]["file"]).parent / "images")
    return [images.load(entry).sensor for entry in images.images[:3]]


@pytest.mark.slow
def test_the_same_command_gives_the_same_bytes_on_any_threads(optimized, cli, snapshot, tmp_path):
    ran = cli("optimize", optimized.rig, optimized.part, "-o", tmp_path, *EACH, "--threads", 1)
    assert (ran.status, ran.err) == (0, "")
    assert snapshot(tmp_path) == snapshot(optimized.out)
    again = cli("optimize", optimized.rig, optimized.part, "-o", tmp_path, *EACH, "-v")
    assert again.status == 0
    assert "2 stored luminance matrices reused" in again.out
    assert snapshot(tmp_path) == snapshot(optimized.out)


@pytest.mark.slow
def test_the_terminal_shows_the_table(optimized, cli):
    brief = cli("optimize", optimized.rig, optimized.part, "-o", optimized.out, *EACH).out
    assert brief.startswith("posture ")
    assert len(brief.splitlines()) <= 15
    assert brief.count("between the candidates") == 2  # of either posture
    ran = cli("optimize", optimized.rig, optimized.part, "-o", optimized.out, *EACH, "-v")
    lines = ran.out.splitlines()
    assert lines[0] == "3 × 2 × 2 positions of light1, light2, light3: 12 combinations at most"
    assert set(brief.splitlines()) <= set(lines)
    assert str(optimized.out / "result.json") in lines
    header = next(k for k, line in enumerate(lines) if line.startswith("posture "))
    assert re.split("  +", lines[header]) == [
        *("posture", "best for", "light1", "light2", "light3", "coverage", "paper"),
        *("left out", "runner-up", "ties / near best", "combinations"),
    ]
    # every cell is what result.json says
    rows = [re.split("  +", line.strip()) for line in lines[header + 1 : header + 5]]
    expected = []
    for group in result_of(optimized.out)["results"]:
        posture = group["postures"][0]
        where = f"posture ({posture['elevation_deg']:g}°, {posture['rotation_deg']:g}°)".replace("-", "−")
        for place, answer in enumerate(group["objectives"]):
            covered, levels = (answer["scores_under"][name] for name in ("coverage", "paper"))
            area, points = group["inspectable_area_um2"], 0 if group["grain"] >= 0.01 else 1
            grain = group["grain"] * area
            gap = area_text(answer["gap"], grain) if place == 0 else f"{answer['gap']:,}"
            gap = gap if gap.startswith("<") else f"−{gap}"
            left_out = 100 * group["left_out_of_visible_area"]
            near = answer["near_best"]
            assert near["at_least"] is False
            expected.append(
                [
                    where,
                    answer["objective"],
                    *(f"{one['elevation_deg']:g}°, {one['azimuth_deg']:g}°" for one in answer["lights"]),
                    f"{area_text(covered, grain)} ({100 * covered / area:.{points}f} %)",
                    f"{levels:,}",
                    f"{left_out:.{points}f} %",
                    gap if answer["gap"] else "equal",
                    f"{answer['ties']:,} / {near['combinations']:,}",
                    "12",
                ]
            )
    assert [[cell.replace("-10", "−10") for cell in row] for row in rows] == expected


@pytest.mark.slow
def test_patches_that_are_too_coarse_are_reported(three, cli):
    few = ("--step", "20", *BARE, "--posture", "0,0")
    trimesh.creation.box((40, 30, 10)).export(three.mesh)
    coarse = cli("optimize", three.rig, three.part, "-o", three.out, *few, "--patches", "12")
    assert "patches have edges up to" in coarse.err
    # the number that it names is enough
    number = re.search(r"whole patches\. --patches (\d+) cuts them to 7\.6 mm or less", coarse.err)
    assert number is not None, coarse.err
    fine = cli("optimize", three.rig, three.part, "-o", three.out, *few, "--patches", number[1], "--force")
    assert "patches have edges" not in fine.err


@pytest.mark.slow
def test_a_step_part_of_many_triangles_says_how_to_have_fewer(three, cli):
    shutil.copyfile(CONFIGS / "parts" / "cover-knob.step", three.folder / "knob.step")
    three.edit("part.yaml", "knob.stl", "knob.step")
    few = ("--step", "20", *BARE, "--posture", "0,0", "--patches", "500", "-v")
    ran = cli("optimize", three.rig, three.part, "-o", three.out, *few)
    reported = re.search(r"visible patches of .*; ([\d,]+) of the mesh's own triangles may show", ran.out)
    assert reported is not None, ran.out
    many = int(reported[1].replace(",", ""))
    assert many > 500
    three.edit("part.yaml", "knob.step", "knob.step, chord_tolerance_mm: 0.5")
    ran = cli("optimize", three.rig, three.part, "-o", three.out, *few, "--force")
    assert ran.status == 0, ran.err
    assert "the mesh's own triangles" not in ran.out
    assert (
        int(re.search(r"([\d,]+) visible patches", ran.out)[1].replace(",", "")) <= 750
    )  # half as many cuts beside them


@pytest.mark.slow
def test_another_run_is_refused_before_any_work_and_replaced_by_force(three, cli, snapshot):
    command = ("optimize", three.rig, three.part, "-o", three.out, *FEW[:2], *BARE)
    assert cli(*command, "--step", "10", "--posture", "0,0").status == 0
    before = snapshot(three.out)
    ran = cli(*command, "--step", "20", "--posture", "0,0")
    assert ran.status == 2
    assert "the result of another run (options.step_deg: previously 10.0, now 20.0); use --force" in ran.err
    assert snapshot(three.out) == before
    assert cli(*command, "--step", "20", "--force", "-q").status == 0
    assert result_of(three.out)["provenance"]["options"]["step_deg"] == 20.0
    listed = {rig["file"] for rig in result_of(three.out)["rigs"]}
    assert {p.relative_to(three.out).as_posix() for p in three.out.rglob("rig.optimized.yaml")} == listed


@pytest.mark.slow
def test_force_leaves_no_map_of_the_run_before(three, cli):
    command = ("optimize", three.rig, three.part, "-o", three.out, "--patches", "800", "--step", "20", "-q")
    assert cli(*command).status == 0
    before = {three.out / one["map"] for one in result_of(three.out)["overlaps"]}
    assert len(before) == 2
    assert all(path.is_file() for path in before)
    assert cli(*command, "--posture", "0,0", "--force").status == 0
    now = {three.out / one["map"] for one in result_of(three.out)["overlaps"]}
    assert set(three.out.rglob("overlap*.png")) == now
    assert len(now) == 1


@pytest.mark.slow
def test_common_lights_and_common_elevation(three, cli):
    three.edit("rig.yaml", "elevation_range_deg: [45, 50]", "elevation_range_deg: [45, 60]")
    ran = cli(
        "optimize", three.rig, three.part, "-o", three.out, "--patches", "800", "--step", "5", "--no-images",
        "--no-report", "--common-elevation", "--objective", "paper",
    )  # fmt: skip
    assert (ran.status, ran.err) == (0, "")
    result = result_of(three.out)
    assert [len(group["postures"]) for group in result["results"]] == [2]
    assert any(line.startswith("all 2 postures  paper ") for line in ran.out.splitlines())
    (answer,) = result["results"][0]["objectives"]
    assert answer["lights"][0]["elevation_deg"] == answer["lights"][2]["elevation_deg"]
    assert answer["combinations"]["total"] == 4 * 3
    assert [rig["file"] for rig in result["rigs"]] == ["rig.optimized.yaml"]
    # a common set is no better for a posture than the posture's own
    own = cli(
        "optimize", three.rig, three.part, "-o", three.folder / "own", "--patches", "800", "--step", "5", "--no-images",
        "--lights-per-posture", "--common-elevation", "--objective", "paper", "-q",
    )  # fmt: skip
    assert own.status == 0
    singles = [group["objectives"][0]["score"] for group in result_of(three.folder / "own")["results"]]
    assert answer["score"] <= sum(singles)


@pytest.mark.slow
@pytest.mark.parametrize("azimuth", [165, 162])  # among the candidates, and between them
@pytest.mark.parametrize("objective", ["coverage", "detectability"])
def test_what_the_lights_show_as_they_stand_is_what_a_fixed_rig_scores(three, cli, azimuth, objective):
    three.edit("rig.yaml", "azimuth_deg: 165", f"azimuth_deg: {azimuth}")
    command = ("optimize", three.rig, three.part, *FEW, *BARE, "--objective", objective)
    ran = cli(*command, "-o", three.out)
    assert (ran.status, ran.err) == (0, "")
    (group,) = result_of(three.out)["results"]
    initial, best = group["lights_as_they_stand"], group["objectives"][0]
    assert initial["objective"] == objective
    # a rig whose lights have no other positions
    for old, new in (("elevation_range_deg: [40, 60]", "elevation_range_deg: [60, 60]"),
                     ("azimuth_range_deg: [155, 165]", f"azimuth_range_deg: [{azimuth}, {azimuth}]"),
                     ("elevation_range_deg: [45, 50]", "elevation_range_deg: [45, 45]")):  # fmt: skip
        three.edit("rig.yaml", old, new)
    assert cli(*command, "-o", three.folder / "fixed", "-q").status == 0
    (fixed,) = result_of(three.folder / "fixed")["results"]
    assert initial["score"] == fixed["objectives"][0]["score"] <= best["score"]
    share = f"{100 * initial['share_of_inspectable_area']:.{0 if group['grain'] >= 0.01 else 1}f} %"
    (line,) = (line for line in ran.out.splitlines() if line.startswith("as the lights stand now: "))
    assert share in line
    assert ("points" in line) == (best["score"] > initial["score"])


@pytest.mark.slow
def test_images_and_seconds_of_a_part_are_said(three, cli):
    few = ("optimize", three.rig, three.part, *FEW, *BARE)
    ran = cli(*few, "-o", three.out)
    planned = cli("capture", three.out / "rig.optimized.yaml", three.part, "--dry-run")
    assert "capture: 6 images in " in ran.out
    whole = float(re.search(r"6 images in (\d+) s", planned.out)[1])
    said = float(re.search(r"6 images in ([\d.]+) s per part, at the speed of the virtual bench", ran.out)[1])
    home = float(re.search(r"^ *[\d.]+ +([\d.]+) +home", planned.out, re.MULTILINE)[1])
    assert said == pytest.approx(whole - home, abs=0.6)
    ran = cli(*few, "-o", three.folder / "own", "--lights-per-posture")
    alike = len(result_of(three.folder / "own")["rigs"]) == 1
    assert ("the lights have to be moved between postures" in ran.out) != alike


def test_a_limit_is_said_with_its_bound(three, cli):
    ran = cli(
        "optimize", three.rig, three.part, "-o", three.out, *FEW, *BARE, "--posture", "0,0",
        "--max-combinations", "2", "--objective", "coverage",
    )  # fmt: skip
    assert ran.status == 0
    answer = result_of(three.out)["results"][0]["objectives"][0]
    assert answer["combinations"]["left"] > 0
    assert answer["complete"] is False
    assert answer["bound"] >= answer["score"]
    assert answer["proven"] is (answer["bound"] == answer["score"])
    assert f"with {answer['combinations']['left']} left; the best found scores {answer['score']:,}" in ran.err
    row = next(line for line in ran.out.splitlines() if " mm² (" in line)
    assert f"  ≥ {answer['ties']} / ≥ {answer['near_best']['combinations']}  " in re.sub("  +", "  ", row)
    assert answer["near_best"]["at_least"] is True
    assert "< 10 mm²  " in row, "the gap is below what so few patches can tell"


def test_an_interrupted_run_leaves_whole_matrices_that_are_reused(three):
    def stop(stage, share):
        if stage.startswith("casting rays") and stage.endswith(", 170°)"):
            raise KeyboardInterrupt

    options = OptimizeOptions(step_deg=10.0, patch_budget=800, keep_matrix=True, images=False)
    with pytest.raises(KeyboardInterrupt):
        design(three.rig, three.part, three.out, options=options, progress=stop)
    assert [p.relative_to(three.out).as_posix() for p in three.out.rglob("*") if p.is_file()] == [
        "posture_0_0/matrix.npz"
    ]
    assert design(three.rig, three.part, three.out, options=options).reused == 1
    three.edit("part.yaml", "R_d: 45.0", "R_d: 46.0")
    assert design(three.rig, three.part, three.out, options=options, force=True).reused == 0
    kept = three.out / "posture_0_0" / "matrix.npz"
    with np.load(kept) as arrays:
        assert set(arrays) == {"key", "areas_mm2", "grazing_mm2"} | {f"light_{k}" for k in range(3)} | {
            f"angles_{k}_deg" for k in range(3)
        }
    kept.write_bytes(kept.read_bytes()[:1000])
    assert design(three.rig, three.part, three.out, options=options).reused == 1, "a damaged one is made anew"


# --- bad input


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--step", "0"), "--step: expected degrees above 0, found 0"),
        (("--shade-below", "10"), "--shade-below: expected a share of full scale from 0 to 1, such as 10/255"),
        (("--shade-below", "1"), "leaves none usable"),
        (("--objective", "paint"), '--objective: expected coverage or paper or detectability, found "paint"'),
        (("--ranking-rows", "0"), "--ranking-rows: expected at least 1, found 0"),
        (("--points", "5"), "points: expected a square"),
        (("--posture", "80,0"), "posture: elevation 80° is outside the stage's range"),
    ],
)
def test_options_out_of_range(three, cli, arguments, message):
    ran = cli("optimize", three.rig, three.part, "-o", three.out, *arguments)
    assert (ran.status, ran.out) == (2, "")
    assert message in ran.err
    assert not three.out.exists()


def sheet():
    """A sheet that stands nearly upright, open: from above it is seen at a grazing angle only."""
    corners = [[0, -10, 0], [1, -10, 20], [1, 10, 20], [0, 10, 0]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


SHAPES = {
    "plate": trimesh.creation.box((40, 25, 3)),
    "ball": trimesh.creation.icosphere(subdivisions=2, radius=12),
    "torus": trimesh.creation.torus(12, 4, major_sections=24, minor_sections=12),
    "sheet": sheet(),
}
QUICK = ("--step", "30", *BARE, "--posture", "0,0", "--patches", "400")


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("objective", ["coverage", pytest.param("detectability", marks=pytest.mark.nightly)])
def test_plain_shapes_have_an_answer_or_an_error_in_words(three, cli, shape, objective):
    SHAPES[shape].export(three.mesh)
    ran = cli("optimize", three.rig, three.part, "-o", three.out, *QUICK, "--objective", objective)
    assert "nan" not in (ran.out + ran.err).lower()
    if shape == "sheet" or (shape, objective) == ("torus", "detectability"):
        # in so small an image all of the torus is a silhouette or a crease
        assert ran.status == 2
        assert "the camera sees no surface, away from edges, at less than 80° to its normal" in ran.err
        assert not (three.out / "result.json").exists()
        return
    assert ran.status == 0, ran.err
    (group,) = result_of(three.out)["results"]
    (answer,) = group["objectives"]
    assert 0.0 < answer["share_of_inspectable_area"] <= 1.0
    assert 0.0 <= group["left_out_of_visible_area"] < 0.5
    # the edges of a plate are left out where defects are planned for
    assert (group["left_out_of_visible_area"] > 0.0) is (shape != "plate" or objective == "detectability")


ONE_LIGHT = """lights:
  - {name: a, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45, elevation_range_deg: [30, 60]}
"""


def test_one_light_is_placed_for_defects_and_refused_by_objectives_that_compare_images(bench, cli):
    with_lights(bench, ONE_LIGHT)
    refused = cli("optimize", bench.rig, bench.part, "-o", bench.out)
    assert refused.status == 2
    assert "objective coverage requires each patch to be usable in 2 images, and there is one light only" in refused.err
    assert "use the objective detectability" in refused.err
    arguments = ("--step", "30", "--patches", "500", *BARE, "--posture", "0,0")
    ran = cli(
        "optimize",
        bench.rig,
        bench.part,
        "-o",
        bench.out,
        "--objective",
        "detectability",
        "--min-images",
        "1",
        *arguments,
    )
    assert ran.status == 0, ran.err
    (result,) = json.loads((bench.out / "result.json").read_text(encoding="utf-8"))["results"]
    (answer,) = result["objectives"]
    assert answer["min_images"] == 1
    assert answer["combinations"]["total"] == 2
    assert 0.0 < answer["share_of_inspectable_area"] < 1.0
    twice = cli("optimize", bench.rig, bench.part, "-o", bench.out, "--objective", "detectability", "--min-images", "2")
    assert twice.status == 2
    assert "2 images, and the rig has 1 light only; lower --min-images" in twice.err


@pytest.mark.slow
def test_with_two_lights_paper_is_left_out_unless_requested(bench, cli):
    lights = LIGHTS.split("  - name: light2")[0] + LIGHTS[LIGHTS.index("  - {name: light3") :]
    with_lights(bench, lights)
    command = ("optimize", bench.rig, bench.part, "-o", bench.out, *FEW, *BARE, "--posture", "0,0")
    ran = cli(*command, "--objective", "paper")
    assert ran.status == 2
    assert "with 2 lights nothing is left" in ran.err
    ran = cli(*command)
    assert ran.status == 0
    assert "warning: objective paper drops" in ran.err
    assert [a["objective"] for a in result_of(bench.out)["results"][0]["objectives"]] == ["coverage"]


@pytest.mark.parametrize(("R_d", "said"), [("0.5", "100 % are shaded"), ("1e7", "% saturated (from 255 on)")])
def test_nothing_usable_gives_no_optimum(three, cli, R_d, said):
    three.edit("part.yaml", "R_d: 45.0, R_s: 12500", f"R_d: {R_d}, R_s: 0")
    ran = cli("optimize", three.rig, three.part, "-o", three.out, *FEW, "--posture", "0,0", "--objective", "paper")
    assert ran.status == 1
    assert said in ran.err
    (answer,) = result_of(three.out)["results"][0]["objectives"]
    assert answer["lights"] is None
    assert said in answer["reason"]
    assert not list(three.out.rglob("rig.optimized.yaml"))


def test_black_level_is_no_light(three, cli):
    """Levels above 10 that are black only: no position is better than another, and none is named."""
    three.edit("rig.yaml", "{bit_depth: 8, read", "{bit_depth: 8, black_level: 20, read")
    three.edit("part.yaml", "R_d: 45.0, R_s: 12500", "R_d: 0.5, R_s: 0")
    ran = cli("optimize", three.rig, three.part, "-o", three.out, *FEW, "--posture", "0,0")
    assert ran.status == 1
    assert "100 % are shaded (below 30)" in ran.err
    for answer in result_of(three.out)["results"][0]["objectives"]:
        assert answer["lights"] is None


@pytest.mark.slow
def test_a_light_that_stands_in_the_part_and_can_leave_it(three, cli):
    """Where the rig has it now is in the part: that candidate is left out; one that cannot move is refused."""
    trimesh.creation.box((200, 20, 60)).export(three.folder / "knob.stl")
    three.edit("rig.yaml", "distance_mm: 330, elevation_deg: 60, azimuth_deg: 45", "@")
    three.edit("rig.yaml", "@, elevation_range", "distance_mm: 80, size_mm: [9, 9], @, elevation_range")
    three.edit("rig.yaml", "@, elevation_range_deg: [40, 60]", "elevation_deg: 30, azimuth_deg: 0@")
    three.edit("rig.yaml", "azimuth_deg: 0@", "azimuth_deg: 0, azimuth_range_deg: [0, 40]")
    command = ("optimize", three.rig, three.part, "-o", three.out, *FEW[:2], *BARE)
    ran = cli(*command, "--step", "20", "--posture", "0,0", "-v")
    assert "left out: light1 at elevation 30°, azimuth 0°: it is inside the part in posture (0°, 0°)" in ran.out
    assert ran.status == 0
    three.edit("rig.yaml", ", azimuth_range_deg: [0, 40]", "")
    ran = cli(*command, "--step", "20", "--posture", "0,0", "--force")
    assert ran.status == 2
    assert "light1's panel are inside the part" in ran.err


def test_overlap_wants_two_images_of_one_size(bench, cli):
    assert (
        cli("render", bench.rig, bench.part, "-o", bench.out, "--patches", "500", "--light", "light1", "-q").status == 0
    )
    ran = cli("overlap", bench.out)
    assert ran.status == 2
    assert "expected images under two lights or more, found one (light1)" in ran.err
    assert cli("overlap", bench.folder / "nowhere").status == 2


def test_an_anchor_that_shares_an_angle_is_reported(three, cli):
    three.edit("rig.yaml", "elevation_deg: 60,", "elevation_deg: &low 60,")
    three.edit("rig.yaml", "elevation_deg: 50.0 ", "elevation_deg: *low ")
    ran = cli("optimize", three.rig, three.part, "-o", three.out, *FEW, *BARE, "--posture", "0,0")
    assert ran.status == 2
    assert "write anchors and aliases out" in ran.err


DISTANT = """\
lights:
  - {name: light1, distance_mm: 250, elevation_deg: 60, azimuth_deg: 45, elevation_range_deg: [40, 60], \
distance_range_mm: [250, 330], distance_step_mm: 80}
  - name: light2
    distance_mm: 225    # the near one
    elevation_deg: 50
    azimuth_deg: 160
    distance_range_mm: [200, 300]
"""


def best_score(rig, part, folder, objective):
    options = OptimizeOptions(
        objectives=(objective,),
        step_deg=20.0,
        min_images=1,
        patch_budget=200,
        images=False,
        postures=(Posture(0.0, 0.0),),
    )
    result = optimize(rig, part, folder, options=options, run=RunContext(threads=1))
    return result, result.results[0].answers[0].found


@pytest.mark.parametrize("objective", ["coverage", pytest.param("detectability", marks=pytest.mark.slow)])
def test_the_best_distances_are_those_of_trying_all(objective, bench, tmp_path):
    with_lights(bench, DISTANT)
    rig, part = load_rig(bench.rig), load_part(bench.part)
    result, found = best_score(rig, part, tmp_path / "searched", objective)
    assert found.proven
    scores = {}
    for elevation, near, far in product((40.0, 60.0), (250.0, 330.0), (200.0, 225.0, 250.0, 275.0, 300.0)):
        moved = {"elevation_deg": elevation, "distance_mm": near}, {"distance_mm": far}
        fixed = dict.fromkeys(("elevation_range_deg", "distance_range_mm", "distance_step_mm"))
        lights = tuple(one.model_copy(update={**fixed, **own}) for one, own in zip(rig.lights, moved, strict=True))
        fixed_rig = rig.model_copy(update={"lights": lights})
        folder = tmp_path / f"{elevation:g}-{near:g}-{far:g}"
        scores[elevation, near, far] = best_score(fixed_rig, part, folder, objective)[1].best.score
    assert found.best.score == max(scores.values()) > min(scores.values())
    first, second = places_of(result.candidates, found.best)
    assert scores[first[0], first[2], second[2]] == found.best.score
    assert found.scored + found.excluded == len(scores)
    # tolerances start from there
    fixed = {"elevation_range_deg": None, "distance_range_mm": None, "distance_step_mm": None}
    best = ({**fixed, "elevation_deg": e, "azimuth_deg": a, "distance_mm": d} for e, a, d in (first, second))
    lights = tuple(one.model_copy(update=own) for one, own in zip(rig.lights, best, strict=True))
    there, _ = best_score(rig.model_copy(update={"lights": lights}), part, tmp_path / "there", objective)
    allowed = design_tolerances(result, run=RunContext(threads=1))
    assert allowed == design_tolerances(there, run=RunContext(threads=1))
    assert (allowed is None) == (objective == "coverage")


def test_results_name_the_distances(bench, cli):
    with_lights(bench, DISTANT)
    ran = cli("optimize", bench.rig, bench.part, "-o", bench.out, "--objective", "coverage", "--step", 20,
              "--posture", "0,0", "--patches", 200, "--no-images", "--verbose")  # fmt: skip
    assert ran.status == 0, ran.err
    result = result_of(bench.out)
    answer = result["results"][0]["objectives"][0]
    near, far = (light["distance_mm"] for light in answer["lights"])
    assert {near, far} != {250.0, 225.0}
    assert result["candidates"][1]["distances_mm"] == [200.0, 225.0, 250.0, 275.0, 300.0]
    assert f"50°, 160°, {far:g} mm" in ran.out
    best = load_rig(bench.out / "rig.optimized.yaml")
    assert [light.distance_mm for light in best.lights] == [near, far]
    text = (bench.out / "rig.optimized.yaml").read_text(encoding="utf-8")
    assert f"distance_mm: {far:g}    # the near one" in text
    with (bench.out / "ranking.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert (float(rows[0]["light1_distance_mm"]), float(rows[0]["light2_distance_mm"])) == (near, far)
    assert {curve["axis"] for curve in result["results"][0]["curves"]} == {"elevation", "distance"}
    (of_far,) = (curve for curve in result["results"][0]["curves"] if curve["light"] == "light2")
    assert max(of_far["scores"]) == answer["score"]
    assert of_far["distances_mm"] == [200.0, 225.0, 250.0, 275.0, 300.0]
    page = (bench.out / "report.html").read_text(encoding="utf-8")
    assert f"{far:g}\u00a0mm" in page
    assert "distance [mm]" in page or "Score against distance" in page
