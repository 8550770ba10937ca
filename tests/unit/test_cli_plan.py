"""``lightopt optimize`` with postures, exposures and tolerances to plan: what it writes and says, bad input."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest

from lightopt.cli._main import run
from lightopt.config import load_part, load_rig

LIGHTS = """\
lights:
  - {name: light1, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45, elevation_range_deg: [50, 60]}
  - {name: light2, distance_mm: 330, elevation_deg: 50, azimuth_deg: 225, elevation_range_deg: [40, 50]}
"""
CATALOGUE = """\
defect_catalogue:
  - {name: dent, kind: dent, size_mm: 0.6, slope_deg: 4}
  - {name: stain, kind: stain, size_mm: 1.5, R_d_factor: 0.7}
"""
FEW = ("--patches", "400", "--step", "10", "--no-images")
PLAN = (
    *FEW,
    "--choose-postures",
    "2",
    "--posture-step",
    "90",
    "--exposures",
    "1,1/16",
    "--tolerance-deg",
    "4",
)


def prepared(bench):
    head, rest = bench.rig.read_text(encoding="utf-8").split("lights:\n", 1)
    text = head + LIGHTS + rest[rest.index("stage:") :]
    bench.rig.write_text(text, encoding="utf-8", newline="\n")
    with bench.part.open("a", encoding="utf-8") as file:
        file.write(CATALOGUE)
    # tests want to see that comments stay, and what the two old postures become
    bench.edit("part.yaml", "postures: [", "# as before\npostures: [")
    return bench


@pytest.fixture(scope="module")
def planned(shared_bench, tmp_path_factory):
    """A plan that the tests of its content share."""
    bench = prepared(type(shared_bench).make(tmp_path_factory.mktemp("planned") / "bench"))
    assert run(["optimize", str(bench.rig), str(bench.part), "-o", str(bench.out), *PLAN]) == 0
    return bench


@pytest.fixture
def two(bench):
    return prepared(bench)


def result_of(folder: Path):
    return json.loads((folder / "result.json").read_text(encoding="utf-8"))


def test_the_result_says_postures_gains_and_bounds(planned):
    result = result_of(planned.out)
    chosen = result["chosen_postures"]
    assert len(chosen["postures"]) == 2
    first, second = chosen["postures"]
    assert first["gain"] == first["share"]
    assert second["share"] == pytest.approx(first["gain"] + second["gain"], abs=2e-6) == chosen["share"]
    assert chosen["share"] <= chosen["bound"] <= chosen["all_candidates"] + 1e-9
    assert chosen["greedy_guarantee"] == 0.75
    # 0° and ±45°, four turns, and the one of the part's own that is off this grid
    assert chosen["candidates"] + len(chosen["left_out"]) == 3 * 4 + 1
    assert chosen["every_combination_tried"] is True
    assert str(planned.folder) not in json.dumps(result)
    # the lights that go with them
    angles = result["results"][0]["objectives"][0]["lights"]
    rig = load_rig(planned.out / "rig.optimized.yaml")
    assert [light.elevation_deg for light in rig.lights] == [light["elevation_deg"] for light in angles]
    assert result["options"]["choose_postures"] == 2


def test_the_part_has_the_planned_postures_and_all_its_comments(planned):
    part = load_part(planned.out / "part.planned.yaml")
    order = result_of(planned.out)["chosen_postures"]["order_of_travel"]
    assert [p.model_dump() for p in part.postures] == order
    text = (planned.out / "part.planned.yaml").read_text(encoding="utf-8")
    assert (
        "# as before\n# planned by: lightopt optimize --choose-postures 2 --posture-step 90\npostures:\n"
        in text
    )
    assert CATALOGUE in text


def test_exposures_say_what_they_add(planned):
    exposures = result_of(planned.out)["exposures"]
    chosen = result_of(planned.out)["chosen_postures"]
    # postures and lights are chosen for what any of the exposures shows; not all of them are worth taking
    assert chosen["with_any_of_exposures"] == [1.0, 0.0625]
    assert exposures["share_without"] < exposures["share"] <= chosen["share"]
    assert [shot["exposure"] for shot in exposures["shots"]] == [0.0625, 0.0625]
    gains = sum(shot["gain"] for shot in exposures["shots"] if shot["planned"])
    assert exposures["share"] == pytest.approx(exposures["share_without"] + gains, abs=3e-6)
    assert all(shot["planned"] == (shot["gain"] >= 0.01) for shot in exposures["shots"])


def test_blind_spots_are_those_of_the_whole_plan(planned):
    result = result_of(planned.out)
    spots, chosen, exposures = result["blind_spots"], result["chosen_postures"], result["exposures"]
    # the same pairs, as a share of the whole surface; patches are cut anew for the chosen postures
    seen = exposures["share"] * chosen["visible_share_of_surface"]
    assert spots["chosen"]["seen"] == pytest.approx(seen, rel=0.05)
    # the lights stand where they were chosen to, and what other positions could show is still told
    assert spots["any_position"]["seen"] > spots["chosen"]["seen"]
    for part in (spots, *spots["postures"]):
        for lights in ("chosen", "any_position"):
            total = part[lights]["seen"] + sum(reason["share"] for reason in part[lights]["blind"])
            assert total == pytest.approx(1.0, abs=1e-5)


def test_trust_is_told_posture_by_posture_and_together(planned):
    trust = result_of(planned.out)["trust"]
    assert [len(one["postures"]) for one in trust] == [1, 1, 2]
    for one in trust:
        assert 0.0 < one["worst_corner"]["share_of_score"] <= 1.0
        assert one["worst_corner"]["part"] == {"tilt_deg": 0.0, "rotation_deg": 0.0}
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
        assert run([*arguments, "--patches", "400", "--quiet"]) == 0
    for arguments in captures:
        assert run([*arguments, "--dry-run"]) == 0


@pytest.mark.slow
def test_the_same_command_again_gives_the_same_bytes_and_another_is_refused(planned, snapshot, cli):
    before = snapshot(planned.out)
    assert (
        run(["optimize", str(planned.rig), str(planned.part), "-o", str(planned.out), *PLAN, "--quiet"]) == 0
    )
    assert {name: before[name] for name in before} == {name: snapshot(planned.out)[name] for name in before}
    other = [text if text != "2" else "3" for text in PLAN]
    ran = cli("optimize", planned.rig, planned.part, "-o", planned.out, *other)
    assert ran.status == 2
    assert "options.choose_postures: there 2, now 3" in ran.err


@pytest.mark.slow
def test_what_is_planned_goes_with_the_plan(two, cli):
    assert cli("optimize", two.rig, two.part, "-o", two.out, *FEW, "--exposures", "1/16").status == 0
    assert (two.out / "part.planned.yaml").is_file()
    options = result_of(two.out)["options"]
    assert (options["seen_in"], options["threshold"]) == (1, 5.0)  # exposures are planned for defects
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *FEW, "--force")
    assert ran.status == 0, ran.err
    assert not (two.out / "part.planned.yaml").exists()


@pytest.mark.slow
def test_lights_that_do_not_move_are_taken_as_they_stand(two, cli):
    text = two.rig.read_text(encoding="utf-8")
    for ends in (", elevation_range_deg: [50, 60]", ", elevation_range_deg: [40, 50]"):
        text = text.replace(ends, "")
    two.rig.write_text(text, encoding="utf-8", newline="\n")
    ran = cli(
        "optimize", two.rig, two.part, "-o", two.out, *FEW, "--choose-postures", "1", "--posture-step", "90"
    )
    assert ran.status == 0, ran.err
    assert "1 posture of 13" in ran.out
    assert [light.elevation_deg for light in load_rig(two.out / "rig.optimized.yaml").lights] == [60, 50]


@pytest.mark.slow
def test_a_target_beyond_reach_says_what_can_be_and_why(two, cli):
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *FEW, "--target", "0.999", "--posture-step", "90")
    assert ran.status == 1
    assert "99.9 % of the surface × defects cannot be reached" in ran.err
    assert "postures together show" in ran.err
    assert "contrast under noise" in ran.err
    assert not two.out.exists()


@pytest.mark.slow
def test_nothing_to_see_is_said(two, cli):
    asked = ("--choose-postures", "2", "--posture-step", "90", "--threshold", "1e6")
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *FEW, *asked)
    assert ran.status == 1
    assert "no posture of 13 shows any defect" in ran.err
    assert not two.out.exists()


@pytest.mark.slow
def test_a_target_within_reach_takes_no_more_than_it_needs(two, cli):
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *FEW, "--target", "0.3", "--posture-step", "90")
    assert ran.status == 0, ran.err
    chosen = result_of(two.out)["chosen_postures"]
    assert chosen["share"] >= 0.3
    assert 1 <= chosen["fewest_possible"] <= len(chosen["postures"])
    assert "30.0 % takes at least" in ran.out


@pytest.mark.slow
def test_tolerances_of_another_objective(two, cli):
    ran = cli(
        "optimize",
        two.rig,
        two.part,
        "-o",
        two.out,
        *FEW,
        "--tolerance-deg",
        "5",
        "--pose-tolerance-deg",
        "2",
    )
    assert ran.status == 0, ran.err
    trust = result_of(two.out)["trust"]
    areas = [result["objectives"][0]["score"] for result in result_of(two.out)["results"]]
    assert [one["score"] for one in trust] == [*areas, sum(areas)]
    assert "worst corner keeps" in ran.out
    assert "commands" not in result_of(two.out)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--choose-postures", "0"), "--choose-postures: expected 1 posture or more, found 0"),
        (
            ("--target", "0"),
            "--target: expected a share of the surface above 0 and up to 1, such as 0.95, found 0",
        ),
        (("--target", "95"), "found 95"),
        (
            ("--choose-postures", "1", "--posture-step", "0"),
            "--posture-step: expected degrees above 0, found 0",
        ),
        (("--choose-postures", "1", "--posture-step", "0.1"), "take a larger step"),
        (("--posture-step", "30"), "--posture-step: does nothing without --choose-postures or --target"),
        (("--exposure-gain", "2"), "--exposure-gain: does nothing without --exposures"),
        (("--tolerance-target", "0.9"), "does nothing without --tolerance-deg"),
        (("--exposures", "1,0"), "--exposures: expected a number from 1e-09 to 1e+09 or a fraction"),
        (("--exposures", "1,-1/4"), 'found "-1/4"'),
        (("--exposures", "1/4,1/4"), "--exposures: the same exposure was given twice"),
        (
            ("--exposures", "1/4", "--exposure-gain", "-1"),
            "--exposure-gain: expected points from 0 to 100, found -1",
        ),
        (("--tolerance-deg", "-2"), "--tolerance-deg: expected degrees from 0 to 16, found -2"),
        (("--pose-tolerance-deg", "nan"), "--pose-tolerance-deg: expected degrees from 0 to 16, found nan"),
        (
            ("--tolerance-deg", "2", "--tolerance-target", "1"),
            "--tolerance-target: expected a share of the score",
        ),
        (("--choose-postures", "1", "--posture", "0,0"), "leave --posture or --choose-postures out"),
        (("--choose-postures", "1", "--objective", "coverage"), "expected detectability first"),
        (("--choose-postures", "2", "--seen-in", "0"), "--seen-in: expected the number of images"),
        (("--exposures", "1/4", "--seen-in", "0"), "--seen-in: expected the number of images"),
        (("--choose-postures", "2", "--seen-in", "3"), "--seen-in: expected at most 2, the number of lights"),
        (
            ("--exposures", "1,1/4", "--seen-in", "9"),
            "2 lights × 2 postures, further exposures of the same light",
        ),
        (("--choose-postures", "1", "--threshold", "-1"), "--threshold: expected a number above 0"),
        (("--exposures", "1/4", "--threshold", "nan"), "--threshold: expected a number above 0"),
        (("--choose-postures", "1", "--rows", "0"), "ranking rows: expected at least 1, found 0"),
        (("--choose-postures", "1", "--patches", "0"), "patch budget: expected at least 1, found 0"),
        (("--choose-postures", "1", "--threads", "0"), "threads: expected at least 1, found 0"),
    ],
)
def test_bad_questions_are_refused_before_any_work(two, cli, arguments, expected, monkeypatch):
    monkeypatch.setattr("lightopt.plan._postures.cast_rays_at", work)
    monkeypatch.setattr("lightopt.optimize._run.cast_rays_at", work)
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *arguments)
    assert ran.status == 2
    assert expected in ran.err
    assert "Traceback" not in ran.err
    assert not two.out.exists()


def test_tolerances_of_many_lights_are_refused_before_any_work(two, cli, monkeypatch):
    monkeypatch.setattr("lightopt.optimize._run.cast_rays_at", work)
    more = "".join(
        f"  - {{name: more{i}, distance_mm: 330, elevation_deg: 30, azimuth_deg: {30 * i}}}\n"
        for i in range(10)
    )
    two.edit("rig.yaml", LIGHTS, LIGHTS + more)
    ran = cli("optimize", two.rig, two.part, "-o", two.out, "--tolerance-deg", "2")
    assert ran.status == 2
    assert "expected at most 10 lights (1,048,576 corners), found 12" in ran.err
    assert not two.out.exists()


def work(*_arguments, **_options):
    raise AssertionError("rays are cast")


def test_a_part_whose_postures_cannot_be_replaced_is_refused_before_any_work(two, cli):
    text = two.part.read_text(encoding="utf-8")
    two.part.write_text(braces(text), encoding="utf-8")
    ran = cli("optimize", two.rig, two.part, "-o", two.out, *FEW, "--choose-postures", "1")
    assert ran.status == 2
    assert "postures cannot be added at the end of the file" in ran.err
    assert not two.out.exists()


def braces(text):
    """A part file in braces, of the keys that it takes."""
    kept = [line for line in text.splitlines() if line.startswith(("format", "name", "mesh", "reflectance"))]
    return "{" + ", ".join(kept) + "}\n"
