"""The report of ``lightopt optimize``: what it shows is what result.json says; files of others stay."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lightopt.config import load_rig
from lightopt.design import (
    BLIND_CLASSES,
    BlindReason,
    Curve,
    LevelThresholds,
    OptimizeOptions,
    area_text,
    area_units,
    finish_design,
    optimize,
    share_text,
    write_design,
)
from lightopt.report._page import Answer, Facts, Gallery, Note, Picture, SurfaceView, Table, page_html
from lightopt.report.design import design_report
from lightopt.report.design._plan import posture_blocks
from lightopt.report.design._report import answer_blocks, design_page
from lightopt.report.design._surface import LEVEL_CLASSES, level_classes

LIGHTS = """\
lights:
  - {name: left, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45, elevation_range_deg: [40, 60]}
  - {name: light2, distance_mm: 330, elevation_deg: 50, azimuth_deg: 165, azimuth_range_deg: [155, 165]}
  - {name: light3, distance_mm: 330, elevation_deg: 45, azimuth_deg: 285, elevation_range_deg: [40, 60]}
"""
FEW = ("--patches", "400", "--step", "10", "-q")


def with_lights(bench):
    text = bench.rig.read_text(encoding="utf-8")
    head, rest = text.split("lights:\n", 1)
    bench.rig.write_text(head + LIGHTS + rest[rest.index("stage:") :], encoding="utf-8", newline="\n")
    bench.edit("part.yaml", "name: knob", "name: '</title><script>knob'")
    return bench


@pytest.fixture(scope="module")
def done(shared_bench, tmp_path_factory):
    """A small optimisation, what its report was made of, and its files."""
    bench = with_lights(type(shared_bench).make(tmp_path_factory.mktemp("report") / "bench"))
    options = OptimizeOptions(step_deg=10.0, patch_budget=400, common_lights=False, report=True)
    return bench, reported(bench, options)


def reported(bench, options):
    """A design that is written with its report."""
    output = write_design(optimize(bench.rig, bench.part, bench.out, options=options))
    finish_design(output, design_report(output))
    return output


@pytest.fixture(scope="module")
def blocks(done):
    page = design_page(done[1])
    return [*page.lead, *(block for section in page.sections for block in section.blocks)]


@pytest.fixture
def undrawn(monkeypatch):
    """Pages without drawings of the rig and without charts, which take longer than all the rest."""
    monkeypatch.setattr("lightopt.report.design._report.setting_blocks", lambda _: [])
    monkeypatch.setattr("lightopt.report.design._report.curve_blocks", lambda _: [])


@pytest.fixture
def three(bench):
    return with_lights(bench)


def result_of(folder: Path):
    return json.loads((folder / "result.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_figures_are_those_of_the_result(done, blocks):
    bench, output = done
    result = result_of(bench.out)
    answers = [block for block in blocks if isinstance(block, Answer)]
    angles, *_, areas, scores = (block for block in blocks if isinstance(block, Table))
    assert output.paths[-1] == bench.out / "report.html"
    assert result["files"] == [{"file": "report.html"}]
    for row, (answer, group) in enumerate(zip(answers, result["results"], strict=True)):
        best = group["objectives"][0]
        area = group["inspectable_area_um2"]
        digits = 1 if group["grain"] < 0.01 else 0
        share = f"{100 * best['score'] / area:.{digits}f} %"
        left_out = f"{100 * group['left_out_of_visible_area']:.{digits}f} %"
        score = area_text(best["score"], group["grain"] * area)
        assert "." not in score, "the patches are coarse"
        assert left_out in answer.text
        assert answer.figure == share
        assert score in answer.text
        expected = [f"{one['elevation_deg']:g}°,\u00a0{one['azimuth_deg']:g}°" for one in best["lights"]]
        assert list(angles.rows[row][1:4]) == expected
        assert angles.rows[row][4] == f"{score} ({share})"
        # the patches that coverage counts are those that are painted usable in two images
        assert areas.rows[row][1] == f"{score} ({share})"
        assert list(scores.rows[2 * row][2:5]) == expected
        assert scores.rows[2 * row][6] == f"{best['scores_under']['paper']:,}"
        assert scores.rows[2 * row][7] == left_out
        gap = area_text(best["gap"], group["grain"] * area).replace(" mm²", "\u00a0mm²")
        assert scores.rows[2 * row][8] == (gap if gap.startswith("<") else f"−{gap}")
        assert scores.rows[2 * row][9] == f"{best['ties']:,} / {best['near_best']['combinations']:,}"
    text = (bench.out / "report.html").read_text(encoding="utf-8")
    for row in angles.rows:
        assert all(f"<td class=number>{cell}</td>".replace(" %", "\u00a0%") in text for cell in row[1:])


def test_every_patch_is_painted_as_its_levels_say(done, blocks):
    _, output = done
    view = next(block for block in blocks if isinstance(block, SurfaceView))
    assert [layer.name for layer in view.surface.layers] == [
        "the best of all postures",
        "posture (0°, 0°)",
        "posture (-10°, 170°)",
    ]
    names = [label for label, _ in LEVEL_CLASSES]
    for layer, result, posture in zip(
        view.surface.layers[1:], output.result.results, output.patches.postures, strict=True
    ):
        row = output.patches.postures.index(posture)
        grazing = output.patches.grazing[row]
        visible = output.patches.visible[row] & ~grazing
        assert grazing.any()
        expected = []
        seen = iter(result.levels[0].T.tolist())
        for is_seen, is_left_out in zip(visible, grazing, strict=True):
            if not is_seen:
                left_out, unseen = "left out: at a grazing angle or an edge", "the camera does not see it"
                expected.append(left_out if is_left_out else unseen)
                continue
            levels = next(seen)
            usable = sum(10 <= level < 255 for level in levels)
            if sum(level >= 255 for level in levels) >= 2:
                expected.append("saturated in two images or more")
            elif usable >= 2:
                expected.append("usable in two images or more")
            else:
                expected.append("usable in one image only" if usable else "shaded: usable in no image")
        assert [names[k] for k in layer.of_face] == expected
        covered = np.array([name == "usable in two images or more" for name in expected])
        units = area_units(output.patches.patches.areas[visible])
        assert int(units[covered[visible]].sum()) == result.answers[0].scores["coverage"]
    together = np.min([layer.of_face for layer in view.surface.layers[1:]], axis=0)
    assert np.array_equal(view.surface.layers[0].of_face, together)


def test_classes_at_the_thresholds():
    levels = np.array([[9, 10, 254, 255, 10, 255], [9, 9, 10, 255, 255, 9]], np.uint8)
    classes = level_classes(levels, LevelThresholds(shade=10, saturation=255))
    assert classes.tolist() == [3, 1, 0, 2, 1, 3]


def test_curves_pass_through_the_best_set_and_are_in_the_result(done, blocks):
    bench, output = done
    result = result_of(bench.out)
    for group, found in zip(result["results"], output.result.results, strict=True):
        best = group["objectives"][0]
        at = {one["light"]: one for one in best["lights"]}
        assert [(c["light"], c["axis"], c["angles_deg"]) for c in group["curves"]] == [
            (None, "elevation", [40, 50, 60]),
            ("left", "elevation", [40, 50, 60]),
            ("light2", "azimuth", [155, 165]),
            ("light3", "elevation", [40, 50, 60]),
        ]
        for curve in group["curves"][1:]:
            assert max(curve["scores"]) == best["score"]
            here = at[curve["light"]][f"{curve['axis']}_deg"]
            assert curve["scores"][curve["angles_deg"].index(here)] == best["score"]
        assert all(isinstance(curve, Curve) for curve in found.curves)
    charts = [block for block in blocks if isinstance(block, Picture) and "Score against" in block.alt]
    assert len(charts) == 4, "elevation and azimuth of both postures"


def test_all_that_it_rests_on_is_reported(done, blocks):
    bench, output = done
    rows = dict(row for block in blocks if isinstance(block, Facts) for row in block.rows)
    assert rows["levels"].startswith("8 bit, black level 0; shaded below 10, saturated from 255 on")
    assert rows["sensor noise"] == "read noise 0.8 levels, 60 electrons per level; not part of the score"
    assert rows["reflectance"].startswith("R_d 45, R_s 12500, σ 0.0475 rad")
    assert rows["patches"] == output.patches.message
    result = result_of(bench.out)
    for name, found in result["provenance"]["inputs"].items():
        assert found["sha256"] in rows[name]
    assert result["provenance"]["code_sha256"] in rows["code"]
    assert f"numpy {result['provenance']['versions']['numpy']}" in rows["versions"]
    gallery = next(block for block in blocks if isinstance(block, Gallery))
    assert [len(pictures) for _, pictures in gallery.rows] == [4, 4]
    text = (bench.out / "report.html").read_text(encoding="utf-8")
    assert str(bench.folder) not in text, "the same files give the same report wherever they lie"
    assert f"<title>{html.escape('Light positions: </title><script>knob')}</title>" in text
    assert len(re.findall("<script", text)) == 4


@pytest.mark.slow
def test_again_it_is_the_same_and_reports_of_others_stay(three, cli, snapshot):
    command = ("optimize", three.rig, three.part, "-o", three.out, *FEW, "--no-images", "--posture", "0,0")
    three.out.mkdir()
    (three.out / "report.html").write_text("mine", encoding="utf-8")
    refused = cli(*command)
    assert refused.status == 2
    assert "report.html: exists with other content; use --force" in refused.err
    (three.out / "report.html").unlink()
    assert cli(*command).status == 0
    before = snapshot(three.out)
    assert cli(*command, "--threads", 1).status == 0
    assert snapshot(three.out) == before
    # a report that was spoilt is of this run, and made anew
    (three.out / "report.html").write_text("spoilt", encoding="utf-8")
    assert cli(*command).status == 0
    assert snapshot(three.out) == before
    assert "Not rendered: images were switched off" in (three.out / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_without_a_report_there_is_none_and_none_is_left(three, cli):
    command = ("optimize", three.rig, three.part, "-o", three.out, *FEW, "--no-images", "--posture", "0,0")
    assert cli(*command).status == 0
    ran = cli(*command, "--no-report")
    assert ran.status == 2
    assert "options.report: previously true, now false" in ran.err
    assert cli(*command, "--no-report", "--force").status == 0
    assert not (three.out / "report.html").exists()
    assert result_of(three.out)["files"] == []


def test_a_part_that_nothing_lights_has_a_report_that_says_so(three, cli):
    command = ("optimize", three.rig, three.part, "-o", three.out, *FEW, "--posture", "0,0")
    ran = cli(*command, "--shade-below", "0.99")
    assert ran.status == 1
    text = (three.out / "report.html").read_text(encoding="utf-8")
    assert "<strong>No answer</strong>" in text
    assert "every combination scores 0" in text


@pytest.mark.slow
def test_the_terminal_names_the_report(done, cli):
    bench, _ = done
    ran = cli("optimize", bench.rig, bench.part, "-o", bench.out, *FEW[:4], "--lights-per-posture")
    assert (ran.status, ran.err) == (0, "")
    assert ran.out.splitlines()[-1] == str(bench.out / "report.html")


def test_the_setting_sheet_is_a_page_of_its_own_with_one_drawing(done):
    bench, output = done
    (section,) = (s for s in design_page(output).sections if s.heading == "Set the lights")
    assert section.own_page
    assert sum(isinstance(block, Picture) for block in section.blocks) == 1
    tables = [block for block in section.blocks if isinstance(block, Table)]
    sets = {tuple(map(str, rig["postures"])) for rig in result_of(bench.out)["rigs"]}
    assert len(tables) == len(sets)
    assert any("move the lights between the postures" in getattr(b, "text", "") for b in section.blocks) == (
        len(sets) > 1
    )
    for table, rig in zip(tables, result_of(bench.out)["rigs"], strict=True):
        lights = load_rig(bench.out / rig["file"]).lights
        for row, light in zip(table.rows, lights, strict=True):
            elevation, azimuth = np.radians([light.elevation_deg, light.azimuth_deg])
            centre = light.distance_mm * np.array(
                [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
            )
            assert row[:2] == [light.name, f"{light.elevation_deg:g}°"]
            assert row[3] == f"{light.distance_mm:g} mm"
            np.testing.assert_allclose(
                [float(text) for text in row[4].replace("−", "-").split(", ")], centre, atol=0.06
            )


@pytest.fixture(scope="module")
def inspected(shared_bench, tmp_path_factory):
    """The same with defects to be seen."""
    bench = with_lights(type(shared_bench).make(tmp_path_factory.mktemp("inspected") / "bench"))
    options = OptimizeOptions(
        objectives=("detectability",), step_deg=20.0, common_lights=False, patch_budget=400, images=False, report=True
    )
    return bench, reported(bench, options)


@pytest.mark.slow
def test_blind_spots_are_painted_and_listed_as_they_were_found(inspected):
    bench, output = inspected
    spots = result_of(bench.out)["blind_spots"]
    page = design_page(output)
    first = next(block for block in answer_blocks(output) if isinstance(block, Answer))
    assert first.text.startswith("of the catalogue's defects, all kinds and places of the surface alike, are found ")
    assert "at ≤ 0.05 false alarms per posture (" in first.text
    assert " mm² by detectability). The surface is what the camera sees in posture (" in first.text
    (table,) = next(s for s in page.sections if s.heading == "Blind spots").blocks
    # the part stands in the page once, with all that it can be coloured by, defects first
    (view,) = (b for s in page.sections for b in s.blocks if isinstance(b, SurfaceView))
    assert page.sections[1].blocks[0] is view
    groups = [layer.group for layer in view.surface.layers]
    assert groups == ["Defects"] * 5 + ["Levels of the images"] * 3
    assert page_html(page).count('<figure class="surface">') == 1
    assert list(table.rows[0][:3]) == ["all postures", "chosen", share_text(spots["chosen"]["seen"], spots["grain"])]
    assert table.header[-1] == "left out"
    assert list(table.header[3:-1]) == list(
        dict.fromkeys(
            one["reason"]
            for group in (spots, *spots["postures"])
            for side in ("chosen", "any_position")
            for one in group[side]["blind"]
        )
    )
    for row, group in zip(table.rows[::2], (spots, *spots["postures"]), strict=True):
        shares = {one["reason"]: one["share"] for one in group["chosen"]["blind"]}
        assert list(row[3:-1]) == [share_text(shares.get(reason, 0.0), spots["grain"]) for reason in table.header[3:-1]]
        assert row[-1] == share_text(group["chosen"]["left_out_of_surface"], spots["grain"])
    shares, reasons, reachable, *single = view.surface.layers[:5]
    assert len(single) == 2
    labels = [kind.label for kind in reasons.classes]
    names = {
        BlindReason.SEEN: "found",
        BlindReason.CAMERA: "never seen by the camera",
        BlindReason.GRAZING: "left out: at a grazing angle or an edge",
        BlindReason.SHADOWED: "shadowed",
        BlindReason.CONTRAST: "contrast under noise",
    }
    _, chosen, possible = output.result.blind.parts[0]
    for layer, found in ((reasons, chosen), (reachable, possible)):
        expected = [
            names.get(code, "saturated by a light")
            + (", other defects found" if code != BlindReason.SEEN and share > 0.0 else "")
            for code, share in zip(found.codes.tolist(), found.share, strict=True)
        ]
        assert [labels[k] for k in layer.of_face] == expected
    # the legend has the table's shares
    amounts = {kind.label: kind.amount for kind in reasons.classes if kind.amount}
    assert amounts["found"] == share_text(spots["chosen"]["seen"], spots["grain"])
    for one in spots["chosen"]["blind"]:
        if not one["reason"].startswith("saturated"):
            assert amounts[one["reason"]] == share_text(one["share"], spots["grain"])
    # and the surface the colours of blind.ply
    colours = {one.label: "#{:02x}{:02x}{:02x}".format(*one.colour) for one in BLIND_CLASSES}
    assert {kind.label: kind.colour for kind in reasons.classes}.items() <= colours.items()
    for k, share in zip(shares.of_face, chosen.share, strict=True):
        label = shares.classes[k].label
        low, high = {
            "none": (0.0, 0.0),
            "up to a quarter": (1e-9, 0.25),
            "up to a half": (0.25, 0.5),
            "up to three quarters": (0.5, 0.75),
            "more, not all": (0.75, 1.0 - 1e-9),
            "all": (1.0, 1.0),
            "never seen by the camera": (0.0, 0.0),
            "left out: at a grazing angle or an edge": (0.0, 0.0),
        }[label]
        assert low <= share <= high


@pytest.mark.slow
def test_defects_seen_are_those_of_the_result(inspected, undrawn):
    bench, output = inspected
    section = next(s for s in design_page(output).sections if s.heading == "Defects")
    (table,) = section.blocks
    for row, group in zip(table.rows, result_of(bench.out)["results"], strict=True):
        answer = group["objectives"][0]
        shown = dict(zip(table.header, row, strict=True))
        for name, share in answer["defects"].items():
            assert shown[name] == share_text(share, group["grain"])
        assert shown["kind found worst"] == answer["worst_defect"]
        assert shown["orientation found worst"] == f"{answer['worst_direction_deg']:g}°"


def with_options(output, options):
    return {**output.document, "provenance": {**output.document["provenance"], "options": options}}


@pytest.mark.slow
def test_what_was_assumed_of_defects_and_tolerances_is_reported(inspected, done, undrawn):
    _, output = inspected
    tolerances = {"light_deg": 2.0, "pose_deg": 1.0, "target": 0.95, "draws": 100, "seed": 0}
    options = {**output.document["provenance"]["options"], "tolerances": tolerances}
    amounts = assumed(replace(output, document=with_options(output, options)))
    names = ", ".join(result_of(output.result.folder)["results"][0]["objectives"][0]["defects"])
    assert amounts["defect catalogue"].startswith(f"{names}: ")
    assert amounts["defect catalogue"].endswith("14 hypotheses")
    assert f"threshold of {options['false_alarms']:g} false alarms per posture" in amounts["a defect is found"]
    assert amounts["left out"] == "what the camera sees at more than 80° to the normal or at silhouettes and creases"
    assert amounts["tolerances"].startswith("lights 2°, part 1°; 100 draws with random seed 0")
    assert "not part of the score" not in amounts["sensor noise"]
    other = assumed(done[1])
    assert other["sensor noise"].endswith("not part of the score")
    assert not {"defect catalogue", "a defect is found", "tolerances"} & set(other)


def assumed(output):
    section = next(s for s in design_page(output).sections if s.heading == "Assumptions")
    return {name: text for block in section.blocks if isinstance(block, Facts) for name, text in block.rows}


def place(elevation: float, rotation: float) -> dict[str, float]:
    return {"elevation_deg": elevation, "rotation_deg": rotation}


PLANNED = {
    "chosen_postures": {
        "min_images": 2,
        "false_alarms": 0.05,
        "requested": 3,
        "target": 0.9,
        "share": 0.905,
        "bound": 0.931,
        "best_of_sets": None,
        "proven_with_these_lights": False,
        "bounds_with_any_of_exposures": [1.0, 0.25],
        "greedy_guarantee": 0.75,
        "fewest_possible": 2,
        "all_candidates": 0.97,
        "lights_as_they_stand": {"share": 0.85, "postures": 3, "share_of": "some patches, at exposure 1"},
        "postures_to_a_tenth_of_a_point": 1,
        "postures": [
            {**place(0, 0), "exposures": [1.0, 0.25], "gain": 0.7, "share": 0.7},
            {**place(20, 90), "exposures": [1.0], "gain": 0.205, "share": 0.905},
        ],
        "order_of_travel": [place(20, 90), place(0, 0)],
        "travel_s": 110.0,
        "travel_pace": "at 1°/s, as the stage says",
        "candidates": 12,
        "left_out": [{**place(45, 0), "kind": "view", "reason": "the part leaves the image"}],
        "shares_of": "all that is seen",
        "optimum": "local",
        "starts": 4,
        "iterations": 2,
        "every_combination_tried": True,
        "iterations_on_all_patches": True,
        "lights_best_for_postures": True,
        "patches": {"drawn": 100, "all": 800, "max_edge_mm": 1.25, "footprint_mm": 0.05, "grain": 0.0177},
        "inspectable_share_of_surface": 0.61,
        "left_out_share_of_surface": 0.05,
    },
    "exposures": {
        "share_without": 0.905,
        "share": 0.94,
        "least_gain": 0.01,
        "grain": 0.0177,
        "shots": [
            {"posture": place(0, 0), "exposure": 0.25, "gain": 0.035, "planned": True, "planned_for": "gain"},
            {"posture": place(20, 90), "exposure": 0.25, "gain": 0.002, "planned": False, "planned_for": None},
        ],
    },
    "tolerances": [
        {
            "postures": [place(0, 0)],
            "patches": 100,
            "grain": 0.0177,
            "score": 1000,
            "worst_corner": {"share_of_score": 0.91, "part": {}, "lights": []},
            "quantile_5_percent": 0.953,
            "least_drawn": 0.94,
            "widest": [{"what": "left", "angle": "elevation", "degrees": 3.25, "or_more": False}],
        },
        {
            "postures": [place(0, 0), place(20, 90)],
            "patches": 100,
            "grain": 0.0177,
            "score": 2000,
            "worst_corner": {"share_of_score": 0.93, "part": {}, "lights": []},
            "quantile_5_percent": 0.96,
            "least_drawn": 0.95,
            "widest": [{"what": "left", "angle": "elevation", "degrees": 10.0, "or_more": True}],
        },
    ],
    "commands": ["lightopt capture rig.optimized.yaml part.planned.yaml --exposure 1,0.25 -o captured"],
}


@pytest.mark.slow
def test_a_plan_is_shown_as_the_result_has_it(done, undrawn):
    tolerances = {"light_deg": 2.0, "pose_deg": 1.0, "target": 0.95, "draws": 100, "seed": 0}
    options = {**done[1].document["provenance"]["options"], "tolerances": tolerances}
    output = replace(done[1], document={**with_options(done[1], options), **PLANNED})
    sections = {section.heading: section.blocks for section in design_page(output).sections}
    table, facts, left, lead, command = sections["Postures"]
    assert "in the folder of this report" in lead.text
    # as they are captured
    assert table.rows == [["(20°, 90°)", "2", "1", "20 %", "90 %"], ["(0°, 0°)", "1", "1, 0.25", "70 %", "70 %"]]
    assert "Shares refer to all that is seen." in table.caption
    amounts = dict(facts.rows)
    assert amounts["maximum for the same number of postures"] == "93 %"
    assert amounts["travel from (0°, 0°)"] == "110.0 s at 1°/s, as the stage says"
    assert amounts["90 % needs at least"] == "2 postures"
    assert amounts["with the lights in their old positions"] == "85 % in 3 postures, of some patches, at exposure 1"
    assert amounts["the first 1 chosen show"] == "70 %"
    # the target was met by fewer than might be
    assert "postures requested" not in amounts
    untargeted = {**PLANNED["chosen_postures"], "target": None}
    facts = posture_blocks(replace(output, document={**output.document, "chosen_postures": untargeted}))[1]
    assert dict(facts.rows)["postures requested"] == "3"
    assert amounts["resolution"] == (
        "800 patches with edges up to 1.25 mm, where a pixel has 0.05 mm: shares may be off by some 2 points"
    )
    assert left.rows == [["(45°, 0°)", "the part leaves the image"]]
    assert command.text == PLANNED["commands"][0]
    assert amounts["these postures reach at least"] == "75 % of the maximum with these lights"
    assert "adds, the evidence that the posture adds" in table.caption
    lead = design_page(output).lead
    (answer,) = (block for block in lead if isinstance(block, Answer))
    assert answer.figure == "94 %"
    assert "(2 images must show each), in (20°, 90°), (0°, 0°)." in answer.text
    assert answer.text.endswith("With exposure 1 alone 90 %.")
    (proof,) = (block.text for block in lead if isinstance(block, Note) and "roven" in block.text)
    assert "with these lights no 2 postures of the 12 show more than 93 %, at any of the candidate exposures." in proof
    assert "in these postures no other positions of the lights show more" in proof
    assert "in 2 iterations, the best of 4 starts (every combination) on 100 patches, then on all 800 patches." in proof
    note, shots = sections["Exposures"]
    assert "94 % of the surface × defects is seen, with exposure 1 alone 90 %" in note.text
    assert [list(row) for row in shots.rows] == [
        ["(0°, 0°)", "0.25", "4 %", "yes"],
        ["(20°, 90°)", "0.25", "< 1 %", "no"],
    ]
    (trust,) = sections["Tolerances of the angles"]
    assert list(trust.header[1:]) == ["posture (0°, 0°)", "all 2 postures"]
    assert "lights are off by 2° and the part by 1°" in trust.caption
    assert "while at least 95 % remain" in trust.caption
    assert trust.rows == [
        ["worst corner keeps", "91 %", "93 %"],
        ["95 % of draws keep", "95 %", "96 %"],
        ["widest: left, elevation", "3.25°", "≥ 10.00°"],
    ]


def test_the_way_of_several_commands_is_reported_command_by_command(done, undrawn):
    rounds = [
        {"command": "one", "order_of_travel": [place(20, 90)], "travel_s": 90.0},
        {"command": "two", "order_of_travel": [place(0, 0)], "travel_s": 40.25},
    ]
    document = {**done[1].document, "chosen_postures": PLANNED["chosen_postures"], "rounds": rounds}
    _, facts, *_ = next(
        section
        for section in design_page(replace(done[1], document=document)).sections
        if section.heading == "Postures"
    ).blocks
    assert dict(facts.rows)["travel from (0°, 0°)"] == (
        "110.0 s at 1°/s, as the stage says, if all postures are captured in one round; the 2 capture commands below "
        "take 90.0 + 40.2 = 130.2 s, each starting at (0°, 0°): (20°, 90°); (0°, 0°)"
    )


@pytest.mark.parametrize(
    ("why", "expected"),
    [
        ("gain", "adds 1 % or more."),
        ("pair", "adds 1 % or more, or twice that together with another."),
        ("target", "adds 1 % or more, or if the target needs it."),
    ],
)
def test_exposures_that_the_target_takes_are_reported(done, undrawn, why, expected):
    planned = PLANNED["exposures"]
    first, other = planned["shots"]
    planned = {**planned, "shots": [first, {**other, "planned": True, "planned_for": why}]}
    output = replace(done[1], document={**done[1].document, "exposures": planned})
    note = next(s for s in design_page(output).sections if s.heading == "Exposures").blocks[0]
    assert note.text.endswith(expected)


def test_where_one_image_is_enough_the_greedy_bound_is_reported(done, undrawn):
    one = {**PLANNED["chosen_postures"], "min_images": 1, "every_combination_tried": False}
    one |= {"lights_best_for_postures": False, "iterations_on_all_patches": False}
    output = replace(done[1], document={**done[1].document, "chosen_postures": one})
    page = design_page(output)
    table, facts, *_ = next(s for s in page.sections if s.heading == "Postures").blocks
    assert dict(facts.rows)["these postures reach at least"] == "75 % of the maximum with these lights"
    assert "together, what is found in them" in table.caption
    (answer,) = (block for block in page.lead if isinstance(block, Answer))
    assert "(one image may decide), in" in answer.text
    (proof,) = (block.text for block in page.lead if isinstance(block, Note) and "roven" in block.text)
    assert "(one light moved at a time) on 100 of 800 patches." in proof
    assert "no other positions of the lights" not in proof


def test_the_best_of_all_sets_is_reported_and_whether_it_is_the_plan(done, undrawn):
    chosen = {**PLANNED["chosen_postures"], "best_of_sets": 66, "min_images": 1}

    def amounts(**more):
        output = replace(done[1], document={**done[1].document, "chosen_postures": {**chosen, **more}})
        (proof,) = (
            block.text for block in design_page(output).lead if isinstance(block, Note) and "roven" in block.text
        )
        return proof, dict(posture_blocks(output)[1].rows)["maximum for the same number of postures"]

    proof, bound = amounts()
    whatever = ", at any of the candidate exposures."
    assert f"with these lights none of the 66 sets of 2 postures shows more than 93 %{whatever}" in proof
    assert bound == "93 %: the maximum of all 66 sets with these lights"
    proof, bound = amounts(proven_with_these_lights=True, bounds_with_any_of_exposures=[1.0])
    assert "with these lights none of the 66 sets of 2 postures shows more." in proof
    assert bound == "93 %: these are the best of all 66 sets with these lights"


def test_nothing_is_shown_of_what_was_not_planned(done):
    headings = [section.heading for section in design_page(done[1]).sections if section.blocks]
    assert headings == [
        "Set the lights",
        "What the images show",
        "Images of the best set",
        "Score against the angles",
        "Scores",
        "Assumptions",
    ]
