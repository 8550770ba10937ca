"""``lightopt optimize`` with postures, exposures and tolerances to plan: what it writes and says, bad input."""

from __future__ import annotations

import json
import math
import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from planned import CATALOGUE, FEW, LIGHTS, PLAN, made_once, prepared

from lightopt.cli._main import run
from lightopt.cli._optimize import show_plan
from lightopt.cli._terminal import VERBOSE
from lightopt.config import load_part, load_rig
from lightopt.core.transforms import Posture
from lightopt.design import PlanResult, share_text
from lightopt.design.postures._exposures import Brackets, FurtherExposure
from lightopt.images import read_image_set


@pytest.fixture(scope="module")
def planned(shared_bench, tmp_path_factory):
    """A plan that the tests of its content share."""
    return made_once(tmp_path_factory, type(shared_bench))


@pytest.fixture
def two(bench):
    return prepared(bench)


def plan(cli, two, *requested):
    """Plan without the report, which takes longer than a small plan."""
    return cli("optimize", two.rig, two.part, "-o", two.out, *FEW, "--no-report", *requested)


def result_of(folder: Path):
    return json.loads((folder / "result.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_the_result_says_postures_gains_and_bounds(planned):
    result = result_of(planned.out)
    chosen = result["chosen_postures"]
    assert len(chosen["postures"]) == 2
    first, second = chosen["postures"]
    # gains are of evidence: what is found has all that it needs, other defects have a part
    assert 0.0 < second["gain"] < first["gain"]
    assert first["share"] <= first["gain"]
    assert first["share"] <= second["share"] == chosen["share"] <= first["gain"] + second["gain"]
    assert chosen["share"] <= chosen["bound"] <= chosen["all_candidates"] + 1e-9
    assert chosen["greedy_guarantee"] == pytest.approx(chosen["share"] / chosen["bound"], abs=2e-6)
    assert chosen["optimum"] == "local"
    # all sets were searched, at any of the exposures
    assert chosen["best_of_sets"] == math.comb(chosen["candidates"], 2)
    assert chosen["proven_with_these_lights"] is (chosen["share"] == chosen["bound"])
    # 0° and ±45°, four turns, and the one of the part's own that is off this grid
    assert chosen["candidates"] + len(chosen["left_out"]) == 3 * 4 + 1
    assert chosen["every_combination_tried"] is True
    assert str(planned.folder) not in json.dumps(result)
    # the lights that go with them
    answer = result["results"][0]["objectives"][0]
    angles = answer["lights"]
    rig = load_rig(planned.out / "rig.optimized.yaml")
    assert [light.elevation_deg for light in rig.lights] == [light["elevation_deg"] for light in angles]
    assert result["provenance"]["options"]["choose_postures"] == 2
    # proven of the lights in these postures only, as the postures' own section has it; others were not counted
    assert answer["proven"] is chosen["lights_best_for_postures"]
    assert answer["proven_of"].startswith("positions of the lights in these postures")
    assert (answer["bound"] == answer["score"]) is answer["proven"]
    assert (answer["ties"], answer["runner_up"], answer["combinations"]) == (None, None, None)
    assert "complete" not in answer


def test_the_part_has_the_planned_postures_and_all_its_comments(planned):
    part = load_part(planned.out / "part.planned.yaml")
    order = result_of(planned.out)["chosen_postures"]["order_of_travel"]
    assert [p.model_dump() for p in part.postures] == order
    text = (planned.out / "part.planned.yaml").read_text(encoding="utf-8")
    (requested,) = (line for line in text.splitlines() if line.startswith("# planned by: "))
    assert f"# as before\n{requested}\npostures:\n" in text
    # the whole command, but for where the files lie
    words = shlex.split(requested.removeprefix("# planned by: "))
    assert words[:4] == ["lightopt", "optimize", "rig.yaml", "part.yaml"]
    assert sorted(words[4:]) == sorted(word.replace("1/16", "0.0625") for word in PLAN)
    assert CATALOGUE in text


def test_the_way_takes_as_long_as_the_capture_says(planned, cli):
    chosen = result_of(planned.out)["chosen_postures"]
    assert chosen["travel_pace"].startswith("at 90°/s of the virtual bench")
    ran = cli("capture", planned.out / "rig.optimized.yaml", planned.out / "part.planned.yaml", "--dry-run")
    assert f", {chosen['travel_s']:.1f} s of them travel" in ran.out
    moves = [line for line in ran.out.splitlines() if "  move to " in line]
    reported = [f"({p['elevation_deg']:g}°, {p['rotation_deg']:g}°)" for p in chosen["order_of_travel"]]
    assert [line.split("move to ")[1] for line in moves] == reported
    assert sum(float(line.split()[1]) for line in moves) == pytest.approx(chosen["travel_s"], abs=0.02)


def test_exposures_say_what_they_add(planned):
    exposures = result_of(planned.out)["exposures"]
    chosen = result_of(planned.out)["chosen_postures"]
    # bounds are of what any of the exposures shows, the share of what is planned and of nothing else
    assert chosen["bounds_with_any_of_exposures"] == [1.0, 0.0625]
    assert exposures["share_without"] <= exposures["share"] == chosen["share"] == chosen["postures"][-1]["share"]
    for one in chosen["postures"]:
        posture = {axis: one[axis] for axis in ("elevation_deg", "rotation_deg")}
        planned_ones = [s["exposure"] for s in exposures["shots"] if s["planned"] and s["posture"] == posture]
        assert one["exposures"] == [1.0, *planned_ones]
    assert [shot["exposure"] for shot in exposures["shots"]] == [0.0625, 0.0625]
    gains = sum(shot["gain"] for shot in exposures["shots"] if shot["planned"])
    assert exposures["share"] == pytest.approx(exposures["share_without"] + gains, abs=3e-6)
    assert all(shot["planned"] == (shot["gain"] >= 0.01) for shot in exposures["shots"])


def test_there_is_one_share_of_the_plan_and_it_is_said_of_what(planned):
    result = result_of(planned.out)
    chosen, exposures = result["chosen_postures"], result["exposures"]
    first = result["results"][0]["objectives"][0]
    assert first["share_of_inspectable_area"] == chosen["share"] == exposures["share"]
    assert first["share_of"] == chosen["shares_of"] == exposures["shares_of"]
    # entries of the catalogue weigh the same
    assert first["share_of_inspectable_area"] == pytest.approx(sum(first["defects"].values()) / 2, abs=2e-6)
    page = (planned.out / "report.html").read_text(encoding="utf-8").replace("\u00a0", " ")
    assert f"({share_text(chosen['share'], result['results'][0]['grain'])})" in page
    assert min(chosen["patches"]["grain"], exposures["grain"], result["blind_spots"]["grain"]) > 0.01
    words = re.sub(r"<(script|style).*?</\1>|<[^>]+>", " ", page, flags=re.DOTALL)
    assert not re.search(r"\d\.\d+\s%", words)


def test_other_objectives_are_searched_in_the_chosen_postures(planned):
    result = result_of(planned.out)
    first, other = result["results"][0]["objectives"]
    assert (other["objective"], other["combinations"]["scored"], other["proven"]) == ("coverage", 4, True)
    assert other["score"] >= first["scores_under"]["coverage"]
    assert other["runner_up"]["score"] <= other["score"]
    # where the lights serve the plan best, those of another objective show no more
    assert result["chosen_postures"]["lights_best_for_postures"]
    assert other["scores_under"]["detectability"] <= first["score"] == first["scores_under"]["detectability"]
    assert [light["positions_deg"] for light in result["candidates"]] == [
        [[50.0, 45.0], [60.0, 45.0]],
        [[40.0, 225.0], [50.0, 225.0]],
    ]


def test_curves_go_through_the_plan(planned):
    group = result_of(planned.out)["results"][0]
    best = group["objectives"][0]
    angles = {light["light"]: light["elevation_deg"] for light in best["lights"]}
    alone = [curve for curve in group["curves"] if curve["light"] is not None]
    assert [curve["light"] for curve in alone] == ["light1", "light2"]
    for curve in alone:
        at = dict(zip(curve["angles_deg"], curve["scores"], strict=True))
        assert at[angles[curve["light"]]] == best["score"] == max(at.values())


def test_blind_spots_are_those_of_the_whole_plan(planned):
    result = result_of(planned.out)
    spots, chosen, exposures = result["blind_spots"], result["chosen_postures"], result["exposures"]
    # the same pairs of the same patches, as a share of the whole surface
    seen = exposures["share"] * chosen["inspectable_share_of_surface"]
    # but for what the camera sees at a grazing angle only
    assert spots["chosen"]["seen"] * (1.0 - spots["chosen"]["left_out_of_surface"]) == pytest.approx(seen, abs=3e-6)
    # the lights stand where they were chosen to, and what other positions could show is still told
    assert spots["any_position"]["seen"] > spots["chosen"]["seen"]
    for part in (spots, *spots["postures"]):
        for lights in ("chosen", "any_position"):
            total = part[lights]["seen"] + sum(reason["share"] for reason in part[lights]["blind"])
            assert total == pytest.approx(1.0, abs=1e-5)


def test_tolerances_are_reported_posture_by_posture_and_together(planned):
    tolerances = result_of(planned.out)["tolerances"]
    assert [len(one["postures"]) for one in tolerances] == [1, 1, 2]
    for one in tolerances:
        assert 0.0 < one["worst_corner"]["share_of_score"] <= 1.0
        assert {angle: abs(by) for angle, by in one["worst_corner"]["part"].items()} == {
            "tilt_deg": 1.0,
            "rotation_deg": 1.0,
        }
        assert {abs(light["elevation_deg"]) for light in one["worst_corner"]["lights"]} == {4.0}
        assert [w["what"] for w in one["widest"]][-3:] == ["all lights", "part", "part"]
        assert len(one["widest"]) == 2 * 2 + 3


def test_the_commands_run_as_they_are(planned, monkeypatch):
    monkeypatch.chdir(planned.out)
    commands = result_of(planned.out)["commands"]
    renders = [shlex.split(command)[1:] for command in commands if command.startswith("lightopt render")]
    captures = [shlex.split(command)[1:] for command in commands if command.startswith("lightopt capture")]
    assert len(renders) == len(captures) >= 1
    for arguments in renders:
        assert arguments[arguments.index("--patches") + 1] == FEW[1]  # the patches of the plan
        assert run([*arguments, "--quiet"]) == 0
    for arguments in captures:
        assert run([*arguments, "--dry-run"]) == 0


@pytest.mark.nightly
def test_the_same_command_again_gives_the_same_bytes_and_another_is_refused(planned, snapshot, cli):
    before = snapshot(planned.out)
    assert run(["optimize", str(planned.rig), str(planned.part), "-o", str(planned.out), *PLAN, "--quiet"]) == 0
    assert {name: before[name] for name in before} == {name: snapshot(planned.out)[name] for name in before}
    brief = cli("optimize", planned.rig, planned.part, "-o", planned.out, *PLAN).out.splitlines()
    assert brief[0].startswith("2 postures of ")
    assert len(brief) <= 20
    assert re.fullmatch(rf"and \d+ more files in {re.escape(str(planned.out))}; --verbose lists them", brief[-4])
    other = [text if text != "2" else "3" for text in PLAN]
    ran = cli("optimize", planned.rig, planned.part, "-o", planned.out, *other)
    assert ran.status == 2
    assert "options.choose_postures: previously 2, now 3" in ran.err


@pytest.mark.slow
def test_what_is_planned_goes_with_the_plan(two, cli):
    assert cli("optimize", two.rig, two.part, "-o", two.out, *FEW, "--exposure", "1/16").status == 0
    assert (two.out / "part.planned.yaml").is_file()
    options = result_of(two.out)["provenance"]["options"]
    assert (options["min_images"], options["false_alarms"]) == (2, 0.05)  # exposures are planned for defects
    ran = plan(cli, two, "--force")
    assert ran.status == 0, ran.err
    assert not (two.out / "part.planned.yaml").exists()


@pytest.mark.slow
def test_lights_that_do_not_move_are_taken_as_they_stand(two, cli):
    text = two.rig.read_text(encoding="utf-8")
    for ends in (", elevation_range_deg: [50, 60]", ", elevation_range_deg: [40, 50]"):
        text = text.replace(ends, "")
    two.rig.write_text(text, encoding="utf-8", newline="\n")
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *FEW, "--choose-postures", "1", "--posture-step", "90")
    assert ran.status == 0, ran.err
    assert "1 posture of 13" in ran.out
    assert [light.elevation_deg for light in load_rig(two.out / "rig.optimized.yaml").lights] == [60, 50]


@pytest.mark.slow
@pytest.mark.parametrize("reach", [pytest.param("", marks=pytest.mark.nightly), ", elevation_range_deg: [50, 60]"])
def test_one_light_is_enough_where_postures_are_chosen(two, cli, reach):
    first, *_, last = LIGHTS.splitlines(keepends=True)
    alone = first + last.replace("light2", "light1").replace(", elevation_range_deg: [40, 50]", reach)
    two.edit("rig.yaml", LIGHTS, alone)
    requested = ("--patches", "200", "--step", "10", "--choose-postures", "2", "--posture-step", "90")
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *requested, "--min-images", "2", "--light-tolerance", "1")
    assert ran.status == 0, ran.err
    assert "2 postures of 13: " in ran.out
    result = result_of(two.out)
    # either posture confirms what the other shows
    assert result["chosen_postures"]["share"] > 0.0
    first = result["results"][0]["objectives"][0]
    assert first["share_of_inspectable_area"] == result["chosen_postures"]["share"]
    assert [light["light"] for light in first["lights"]] == ["light1"]
    seen = result["chosen_postures"]["share"] * result["chosen_postures"]["inspectable_share_of_surface"]
    spots = result["blind_spots"]["chosen"]
    assert spots["seen"] * (1.0 - spots["left_out_of_surface"]) == pytest.approx(seen, abs=3e-6)
    assert [len(one["postures"]) for one in result["tolerances"]] == [2]
    assert result["overlaps"] == []
    page = (two.out / "report.html").read_text(encoding="utf-8")
    assert "highlights together" not in page
    # the positions that there were to choose from, not only the chosen one
    positions = 2 if reach else 1
    assert [len(light["positions_deg"]) for light in result["candidates"]] == [positions]
    assert re.search(rf"positions</th><td>{positions}, step 10°", page)


@pytest.mark.slow
def test_a_target_beyond_reach_says_what_can_be_and_why(two, cli):
    ran = plan(cli, two, "--target", "0.999", "--posture-step", "90")
    assert ran.status == 1
    assert (
        "99.9 % of the surface × defects is not reached: with the best lights found (others may show more)" in ran.err
    )
    assert "postures together show" in ran.err
    assert "contrast under noise" in ran.err
    # 400 patches are fewer than are drawn: what no posture shows is there, and no part of what the shares are of
    assert "never seen by the camera" not in ran.err
    assert not two.out.exists()
    # what can be had: so many postures, and what they show
    shown = re.findall(r"\d+: ([\d.]+) % \(at most ([\d.]+) %\)", ran.err)
    shares, bounds = ([float(pair[i]) for pair in shown] for i in (0, 1))
    assert len(shares) >= 2
    assert shares == sorted(shares)
    assert all(share <= bound for share, bound in zip(shares, bounds, strict=True))
    # 400 patches support whole percents
    assert f"postures together show {shares[-1]:.0f} %" in ran.err


@pytest.mark.slow
def test_a_number_of_postures_shows_at_least_what_a_target_beyond_reach_says(two, cli):
    few = ("--patches", "100", "--step", "10", "--no-images", "--posture-step", "90", "--no-report")
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *few, "--target", "1", "--quiet")
    assert ran.status == 1
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *few, "--target", "1")
    reported = float(re.search(r" 2: ([\d.]+) % \(at most", ran.err)[1])
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *few, "--choose-postures", "2")
    assert ran.status == 0, ran.err
    assert 100.0 * result_of(two.out)["chosen_postures"]["share"] >= reported - 0.5


@pytest.mark.slow
def test_more_postures_than_there_are_and_such_as_add_next_to_nothing_are_reported(two, cli):
    few = ("--patches", "100", "--step", "10", "--no-images", "--posture-step", "90", "--no-report", "-v")
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *few, "--choose-postures", "30")
    assert ran.status == 0, ran.err
    assert "13 postures to choose from, fewer than the 30 requested, 0 left out" in ran.out
    chosen = result_of(two.out)["chosen_postures"]
    assert chosen["requested"] == 30
    number, first = len(chosen["postures"]), chosen["postures_to_a_tenth_of_a_point"]
    why = "there are no others" if number == 13 else "no other adds anything with these lights"
    assert f"30 postures requested, {number} chosen: {why}" in ran.out
    shares = [one["share"] for one in chosen["postures"]]
    assert shares[first - 1] >= shares[-1] - 0.001 - 1e-6
    assert first == 1 or shares[first - 2] < shares[-1] - 0.001 + 1e-6
    assert (first < number) == (f"--choose-postures {first} is nearly as good" in ran.out)
    # how large the patches are that all this is told on
    assert chosen["patches"]["max_edge_mm"] > 1.0
    # no digit that the patches do not support, in any table
    assert not re.search(r"\d\.\d+ %", ran.out)
    points = f"{100.0 * chosen['patches']['grain']:.1g} points"
    assert "resolution: " in ran.out
    assert f"shares may be off by some {points}" in ran.out
    assert 0.01 < chosen["patches"]["grain"] < 0.1


@pytest.mark.slow
def test_images_of_chosen_postures_have_the_planned_exposures(two, cli):
    requested = ("--patches", "150", "--step", "15", "--choose-postures", "2", "--posture-step", "90")
    offer = ("--exposure", "1,1/16,8", "--exposure-gain", "0.2")
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *requested, *offer, "--no-report")
    assert ran.status == 0, ran.err
    result = result_of(two.out)
    expected = {
        (Posture.from_dict(one), exposure)
        for one in result["chosen_postures"]["postures"]
        for exposure in one["exposures"]
    }
    assert len(expected) > 2, "exposures are planned beside 1"
    taken = [
        (entry.posture, entry.exposure)
        for listed in result["images"]
        for entry in read_image_set(two.out / listed["folder"]).images
    ]
    assert set(taken) == expected
    assert len(taken) == 2 * len(expected)


@pytest.mark.slow
def test_what_is_planned_is_rendered_as_it_is_planned(two, cli):
    requested = ("--patches", "150", "--step", "10", "--common-lights")
    offer = ("--exposure", "1,8", "--exposure-gain", "2")
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *requested, *offer, "-v")
    assert ran.status == 0, ran.err
    result = result_of(two.out)
    planned_ones: dict[Posture, list[float]] = {p: [1.0] for p in (Posture(0.0, 0.0), Posture(-10.0, 170.0))}
    for shot in result["exposures"]["shots"]:
        planned_ones[Posture.from_dict(shot["posture"])] += [shot["exposure"]] * shot["planned"]
    assert sorted(map(len, planned_ones.values())) == [1, 2], "their exposures differ"
    taken: dict[Posture, set[float]] = {}
    for listed in result["images"]:
        for entry in read_image_set(two.out / listed["folder"]).images:
            taken.setdefault(entry.posture, set()).add(entry.exposure)
            assert entry.exposure in listed["exposures"]
    assert {posture: set(levels) for posture, levels in planned_ones.items()} == taken
    assert len(result["overlaps"]) == sum(map(len, planned_ones.values()))
    for overlap in result["overlaps"]:
        assert (two.out / overlap["map"]).is_file()
        assert overlap["exposure"] in planned_ones[Posture.from_dict(overlap["posture"])]
    page = (two.out / "report.html").read_text(encoding="utf-8")
    assert "What the camera would deliver at the planned exposures" in page
    for exposure in (0.0625, 8.0):
        pictures = sum(exposure in levels for levels in planned_ones.values())
        assert page.count(f", exposure {exposure:g}<") == pictures
    # each command begins at (0°, 0°) and takes its own postures
    captures = [one["command"] for one in result["rounds"]]
    assert captures == [text for text in result["commands"] if text.startswith("lightopt capture")]
    assert len(captures) == 2
    for number, one in enumerate(result["rounds"], start=1):
        words = shlex.split(one["command"])[2:]
        words[:2] = [str(two.out / word) for word in words[:2]]
        ran_dry = cli("capture", *words, "--dry-run")
        assert f", {one['travel_s']:.1f} s of them travel" in ran_dry.out
        assert f"stage, capture {number}: " in ran.out
    total = sum(one["travel_s"] for one in result["rounds"])
    assert f"total travel {total:.1f} s, without" in ran.out
    # nothing of it stays where another plan has other image sets
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *requested, "--force")
    assert ran.status == 0, ran.err
    assert sorted(path.name for path in two.out.glob("images*")) == ["images"]


@pytest.mark.slow
def test_nothing_to_see_is_said(two, cli):
    requested = ("--choose-postures", "2", "--posture-step", "90", "--false-alarms", "1e-9")
    two.edit(
        "part.yaml", CATALOGUE, "defect_catalogue: [{name: faint, kind: stain, size_mm: 0.2, R_d_factor: 0.999}]\n"
    )
    ran = plan(cli, two, *requested)
    assert ran.status == 1
    assert "no posture of 13 shows any defect" in ran.err
    assert not two.out.exists()


@pytest.mark.slow
def test_an_objective_that_is_only_scored_is_not_said_to_be_proven_among_all(two, cli, monkeypatch):
    monkeypatch.setattr("lightopt.design.responses._posture_matrices.PostureMatrices.fits_memory", lambda *_: False)
    requested = ("--choose-postures", "1", "--posture-step", "90", "--objective", "detectability")
    ran = plan(cli, two, *requested, "--objective", "coverage")
    assert ran.status == 0, ran.err
    assert "positions only: they are too many for memory" in ran.err
    first, second = result_of(two.out)["results"][0]["objectives"]
    assert second["lights"] == first["lights"]
    assert second["proven_of"].startswith("the positions that the first objective chose")
    assert (second["ties"], second["combinations"]) == (None, None)


@pytest.mark.slow
def test_a_target_within_reach_takes_no_more_than_it_needs(two, cli):
    ran = plan(cli, two, "--target", "30%", "--posture-step", "90", "-v")
    assert ran.status == 0, ran.err
    chosen = result_of(two.out)["chosen_postures"]
    assert chosen["share"] >= 0.3
    assert 1 <= chosen["fewest_possible"] <= len(chosen["postures"])
    assert "30 % needs at least" in ran.out
    assert "1 combination at most" not in ran.out, "nothing is searched a second time"


@pytest.mark.parametrize(
    ("why", "expected"),
    [
        ("gain", "adds 1 % or more."),
        ("pair", "adds 1 % or more, or twice that together with another."),
        ("target", "adds 1 % or more, or if the target needs it."),
    ],
)
def test_exposures_that_the_target_takes_are_reported(capsys, why, expected):
    shots = (FurtherExposure(posture=Posture(0.0, 0.0), exposure=0.25, gain=0.004, reason=why),)
    brackets = Brackets(before=0.9, after=0.904, further=shots, least_gain=0.01, grain=0.005)
    show_plan(PlanResult(brackets=brackets))
    reported = capsys.readouterr().out
    assert "with exposure 1 alone 90.0 %" in reported
    assert f"An exposure is planned if it {expected}" in reported
    assert "0.4 % " in reported
    # no digit that the patches do not support
    told = VERBOSE.set(True)
    show_plan(PlanResult(brackets=replace(brackets, grain=0.02)))
    VERBOSE.reset(told)
    reported = capsys.readouterr().out
    assert "< 1 % " in reported
    assert not re.search(r"\d\.\d+ %", reported)


@pytest.mark.nightly
def test_tolerances_of_another_objective(two, cli):
    ran = plan(cli, two, "--lights-per-posture", "--light-tolerance", "5", "--pose-tolerance", "2")
    assert ran.status == 0, ran.err
    tolerances = result_of(two.out)["tolerances"]
    areas = [result["objectives"][0]["score"] for result in result_of(two.out)["results"]]
    assert [one["score"] for one in tolerances] == [*areas, sum(areas)]
    assert "worst corner keeps" in ran.out
    assert "commands" not in result_of(two.out)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--choose-postures", "0"), "--choose-postures: expected at least 1, found 0"),
        (("--target", "0"), "--target: expected a share of the surface above 0 and up to 1, such as 0.95, found 0"),
        (
            ("--target", "95 of"),
            '--target: expected a share of the surface above 0 and up to 1, such as 0.95, found "95 of"',
        ),
        (("--target", "95"), "such as 0.95, found 95"),
        (("--target", "950"), "such as 0.95, found 950\n"),
        (("--choose-postures", "1", "--posture-step", "0"), "--posture-step: expected degrees above 0, found 0"),
        (("--choose-postures", "1", "--posture-step", "0.1"), "take a larger step"),
        (("--posture-step", "30"), "--posture-step: has no effect without --choose-postures or --target"),
        (("--allow-outside", "3"), "--allow-outside: has no effect without --choose-postures or --target"),
        (("--choose-postures", "1", "--allow-outside=-1"), "--allow-outside: expected pixels, 0 or more, found -1"),
        (("--exposure-gain", "2"), "--exposure-gain: has no effect without --exposure"),
        (("--tolerance-target", "0.9"), "has no effect without --light-tolerance"),
        (("--exposure", "1,0"), "--exposure: expected a number from 1e-09 to 1e+09 or a fraction"),
        (("--exposure", "1,-1/4"), 'found "-1/4"'),
        (("--exposure", "1/4,1/4"), "--exposure: the same exposure was given twice"),
        (("--exposure", "1/4", "--exposure-gain", "-1"), "--exposure-gain: expected points from 0 to 100, found -1"),
        (("--light-tolerance", "-2"), "--light-tolerance: expected degrees from 0 to 16, found -2"),
        (("--pose-tolerance", "nan"), "--pose-tolerance: expected degrees from 0 to 16, found nan"),
        (("--light-tolerance", "2", "--tolerance-target", "1"), "--tolerance-target: expected a share of the score"),
        (("--choose-postures", "1", "--posture", "0,0"), "omit one or the other"),
        (("--target", "0.5", "--posture", "0,0"), "--posture: cannot be combined with --choose-postures or --target"),
        (("--choose-postures", "1", "--objective", "coverage"), "expected detectability first"),
        (
            ("--choose-postures", "1", "--lights-per-posture"),
            "--lights-per-posture: postures are chosen for one set of",
        ),
        (("--choose-postures", "2", "--min-images", "0"), "--min-images: expected"),
        (("--exposure", "1/4", "--min-images", "0"), "--min-images: expected"),
        (
            ("--choose-postures", "2", "--min-images", "5"),
            "--min-images: expected at most 4, the number of images of the plan: 2 lights × 2 postures at most",
        ),
        (
            ("--target", "0.5", "--posture-step", "90", "--min-images", "27"),
            "--min-images: expected at most 26, the number of images of the plan: 2 lights × 13 postures at most",
        ),
        (
            ("--choose-postures", "1", "--objective", "detectability", "--objective", "paper"),
            "objective paper drops each patch's highest and lowest level, and with 2 lights nothing is left",
        ),
        (("--exposure", "1,1/4", "--min-images", "9"), "2 lights × 2 postures at most"),
        (("--choose-postures", "1", "--false-alarms", "-1"), "--false-alarms: expected a number from 1e-9 to 1"),
        (("--exposure", "1/4", "--false-alarms", "nan"), "--false-alarms: expected a number from 1e-9 to 1"),
        (("--choose-postures", "1", "--ranking-rows", "0"), "--ranking-rows: expected at least 1, found 0"),
        (("--choose-postures", "1", "--patches", "0"), "--patches: expected"),
        (("--choose-postures", "1", "--threads", "0"), "--threads: expected"),
    ],
)
def test_bad_questions_are_refused_before_any_work(two, cli, arguments, expected, monkeypatch):
    monkeypatch.setattr("lightopt.design.postures._plan_postures.cast_rays_at", work)
    monkeypatch.setattr("lightopt.design._optimize.cast_rays_at", work)
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *arguments)
    assert ran.status == 2
    assert expected in ran.err
    assert "Traceback" not in ran.err
    assert not two.out.exists()


def test_tolerances_of_many_lights_are_refused_before_any_work(two, cli, monkeypatch):
    monkeypatch.setattr("lightopt.design._optimize.cast_rays_at", work)
    more = "".join(
        f"  - {{name: more{i}, distance_mm: 330, elevation_deg: 30, azimuth_deg: {30 * i}}}\n" for i in range(10)
    )
    two.edit("rig.yaml", LIGHTS, LIGHTS + more)
    ran = cli("optimize", two.rig, two.part, "-o", two.out, "--light-tolerance", "2")
    assert ran.status == 2
    assert "expected at most 10 lights (1,048,576 corners), found 12" in ran.err
    assert not two.out.exists()


def work(*_arguments, **_options):
    raise AssertionError("rays are cast")


def test_a_part_whose_postures_cannot_be_replaced_is_refused_before_any_work(two, cli):
    text = two.part.read_text(encoding="utf-8")
    two.part.write_text(braces(text), encoding="utf-8")
    ran = plan(cli, two, "--choose-postures", "1")
    assert ran.status == 2
    assert "postures cannot be added at the end of the file" in ran.err
    assert not two.out.exists()


def braces(text):
    """A part file in braces, of the keys that it takes."""
    kept = [line for line in text.splitlines() if line.startswith(("format", "name", "mesh", "reflectance"))]
    return "{" + ", ".join(kept) + "}\n"
