"""Lighting systems compared on the same part: order, Pareto, files, systems that cannot be used, presets."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from lightopt.comparison import PRESETS, answer_text, preset_files, systems_table
from lightopt.comparison._results import LightingComparison, SystemResult, comparison_csv
from lightopt.config import load_rig
from lightopt.core.errors import InputError
from lightopt.design import OptimizeOptions, WidestTolerance
from lightopt.scene import build_camera, pixel_footprint

CAMERA = (
    "{distance_mm: 550, elevation_deg: 90, resolution_px: [80, 60], pixel_size_um: 88, image_distance_mm: 55, "
    "sensor: {bit_depth: 8, read_noise_levels: 0.8}}"
)
RIGS = {
    "panels": """
light_source: {size_mm: [60, 60], points: 1}
lights:
  - {name: a, distance_mm: 330, elevation_deg: 60, azimuth_deg: 0, elevation_range_deg: [50, 60]}
  - {name: b, distance_mm: 330, elevation_deg: 60, azimuth_deg: 180}
""",
    "ring": """
lights:
  - {name: ring, kind: ring, inner_radius_mm: 50, outer_radius_mm: 80, distance_mm: 250, segments: 2,
     distance_range_mm: [150, 250], distance_step_mm: 100}
""",
    "blocked": """
lights:
  - {name: plate, kind: bar, size_mm: [100, 100], distance_mm: 250}
""",
}


def rig_file(folder: Path, name: str) -> Path:
    path = folder / f"{name}.yaml"
    path.write_text(f"format: lightopt-rig/1\nname: {name}\ncamera: {CAMERA}\n{RIGS[name]}", encoding="utf-8")
    return path


def system(name, share, seconds, **facts):
    given = {"grain": 0.001, "defects": {"dent": share}, "reasons": {}, "moved": (), "images": 4, "pictures": ()}
    given |= {"size_mm": (1.0, 2.0, 3.0), "footprint_mm": 0.1, "folder": Path(name), "rig": SimpleNamespace()}
    return SystemResult(name=name, share=share, seconds=seconds, **{**given, **facts})


def comparison_of(*systems):
    part, options = SimpleNamespace(), OptimizeOptions()
    facts = {"provenance": {}, "unusable": {}, "warnings": (), "paths": ()}
    return LightingComparison(part=part, options=options, systems=systems, **facts)


def test_no_other_system_finds_as_much_in_less_time():
    found = comparison_of(
        system("a", 0.9, 8.0),
        system("b", 0.8, 5.0),
        system("c", 0.8, 6.0),
        system("d", 0.2, 1.0),
        system("e", 0.1, 9.0),
    )
    assert [one.name for one in found.best] == ["a", "b", "d"]
    # equal systems are both among the best
    assert len(comparison_of(system("a", 0.5, 1.0), system("b", 0.5, 1.0)).best) == 2
    rows = list(csv.DictReader(comparison_csv(found).splitlines()))
    shown = [(row["system"], row["pareto"], row["dent"]) for row in rows[1:3]]
    assert shown == [("b", "1", "0.800000"), ("c", "0", "0.800000")]
    assert answer_text(found).startswith("a finds most: 90.0 % of the catalogue's defects")


def test_tolerances_are_in_the_table_and_the_csv_file():
    def widest(degrees, open_ended=False):
        return WidestTolerance(what="part", angle="both angles at once", degrees=degrees, open_ended=open_ended)

    found = comparison_of(
        system("a", 0.9, 8.0, mounting=widest(1.35), pose=widest(16.0, True)),
        system("b", 0.8, 5.0, mounting=widest(0.0), pose=widest(12.5)),
        system("c", 0.7, 6.0),
    )
    table = systems_table(found)
    columns = [table.header.index(name) for name in ("lights ±°", "part ±°")]
    assert [[row[i] for i in columns] for row in table.rows] == [["1.4", "≥ 16"], ["< 0.05", "12"], ["-", "-"]]
    rows = list(csv.DictReader(comparison_csv(found).splitlines()))
    assert [row["mounting_tolerance_deg"] for row in rows] == ["1.35", "0", ""]
    assert [row["pose_tolerance_deg"] for row in rows] == ["16", "12.5", ""]


def test_what_lights_find_between_the_candidates_is_in_the_table_and_the_csv_file():
    found = comparison_of(system("a", 0.9, 8.0, most=0.925), system("b", 0.8, 5.0))
    table = systems_table(found)
    column = table.header.index("found")
    assert [row[column] for row in table.rows] == ["90.0 % (≤ 92.5 %)", "80.0 %"]
    rows = list(csv.DictReader(comparison_csv(found).splitlines()))
    assert [row["share_between_candidates"] for row in rows] == ["0.925000", ""]


def test_presets_have_the_pixels_and_the_sensor_of_the_rig_they_are_compared_with(tmp_path):
    rig = load_rig(rig_file(tmp_path, "panels"))
    own = pixel_footprint(build_camera(rig), 550.0)
    names = list(PRESETS)
    for name, path in zip(names, preset_files(names, tmp_path / "presets", camera_of=rig), strict=True):
        preset = load_rig(path)
        assert path.stem == name
        assert preset.camera.resolution_px == (80, 60)
        assert preset.camera.sensor == rig.camera.sensor
        assert pixel_footprint(build_camera(preset), preset.camera.distance_mm) == pytest.approx(own, rel=1e-6)
    assert preset_files(names[:1], tmp_path / "presets", camera_of=rig) == [tmp_path / "presets" / f"{names[0]}.yaml"]
    path.write_text(path.read_text(encoding="utf-8") + "\n# mine\n", encoding="utf-8")
    with pytest.raises(InputError, match="differs from the preset; give it as a rig file without the preset"):
        preset_files([name], tmp_path / "presets", camera_of=rig)
    with pytest.raises(InputError, match=f'no preset "dom"; presets are {", ".join(PRESETS)}'):
        preset_files(["dom"], tmp_path / "presets")


@pytest.mark.slow
def test_systems_are_designed_compared_and_reported(bench, tmp_path, cli):
    rigs = [rig_file(tmp_path, name) for name in RIGS]
    out = tmp_path / "compared"
    command = ("compare-lighting", bench.part, *rigs, "-o", out, "--patches", 200, "--step", 10, "--posture", "0,0")
    ran = cli(*command)
    assert ran.status == 0, ran.err
    assert "finds most" in ran.out
    assert "blocked cannot be used" in ran.err
    assert "stands in the camera's view" in ran.err
    found = json.loads((out / "comparison.json").read_text(encoding="utf-8"))
    assert {one["system"] for one in found["systems"]} == {"panels", "ring"}
    shares = [one["share"] for one in found["systems"]]
    assert shares == sorted(shares, reverse=True)
    assert [one["name"] for one in found["unusable"]] == ["blocked"]
    assert any(one["share_between_candidates"] for one in found["systems"])
    for one in found["systems"]:
        own = json.loads((out / one["folder"] / "result.json").read_text(encoding="utf-8"))
        (objective,) = own["results"][0]["objectives"]
        assert one["share"] == objective["share_of_inspectable_area"]
        between = objective["between_candidates"]
        assert one["share_between_candidates"] == (between and between["share_of_inspectable_area"])
        assert one["share"] <= (one["share_between_candidates"] or 1.0)
        assert one["defects"] == objective["defects"]
        assert one["images"] == 2
        assert 0.0 < one["seconds"] < 60.0
        for name in ("mounting_tolerance", "pose_tolerance"):
            assert 0.0 < one[name]["degrees"] <= 16.0
            assert one[name]["or_more"] is (one[name]["degrees"] == 16.0)
        # of what the camera sees, what is not found has a reason
        assert one["share"] + sum(one["not_found"].values()) == pytest.approx(1.0, abs=0.02)
    page = (out / "report.html").read_text(encoding="utf-8")
    chosen = load_rig(out / "ring" / "rig.optimized.yaml").lights
    assert len({light.distance_mm for light in chosen}) == 1
    assert (f"ring to 90°, 270°, {chosen[0].distance_mm:g} mm" in page) is (chosen[0].distance_mm != 250.0)
    for text in ("panels/report.html", "ring/report.html", "Systems that cannot be used", "Why defects are missed"):
        assert text in page
    again = cli(*command, "--min-images", 1)
    assert again.status == 2
    assert "of a comparison of other inputs" in again.err
    assert "--force" in again.err
    assert cli(*command, "--force", "-q", "--no-tolerances").status == 0
    found = json.loads((out / "comparison.json").read_text(encoding="utf-8"))
    assert [one["pose_tolerance"] for one in found["systems"]] == [None, None]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["panels"], "expected two lighting systems or more to compare, found 1"),
        (["panels", "panels"], "another rig file is named panels.yaml, too; give each a name of its own"),
        (["panels", "gone"], "gone.yaml"),
    ],
)
def test_too_few_equal_or_missing_files(names, message, bench, tmp_path, cli):
    rig_file(tmp_path, "panels")
    ran = cli("compare-lighting", bench.part, *(tmp_path / f"{name}.yaml" for name in names), "-o", tmp_path / "out")
    assert ran.status == 2
    assert message in ran.err


def test_help_names_all_presets(cli):
    # names are broken at their hyphens
    words = "".join(cli("compare-lighting", "--help").out.split())
    assert f"{','.join(PRESETS)}." in words


SIZED = """
lights:
  - name: ring
    kind: ring
    inner_radius_mm: 40
    outer_radius_mm: 60
    distance_mm: 250
    segments: 2
    sizes:                        # of the catalogue
      - {inner_radius_mm: 50, outer_radius_mm: 80}
      - {outer_radius_mm: 61, distance_mm: 300}
"""


@pytest.mark.slow
def test_the_best_size_of_a_light_stands_for_its_system(bench, tmp_path, cli, monkeypatch):
    monkeypatch.setitem(RIGS, "ring", SIZED)
    out = tmp_path / "compared"
    command = ("compare-lighting", bench.part, rig_file(tmp_path, "ring"), "-o", out, "--posture", "0,0")
    ran = cli(*command, "--patches", 200, "--no-tolerances")
    assert ran.status == 0, ran.err
    (found,) = json.loads((out / "comparison.json").read_text(encoding="utf-8"))["systems"]
    texts = [
        "as in the file",
        "ring inner_radius_mm 50, outer_radius_mm 80",
        "ring distance_mm 300, outer_radius_mm 61",
    ]
    assert [one["size"] for one in found["sizes"]] == texts
    # each is what the same rig file without other sizes finds
    for number, one in enumerate(found["sizes"], start=1):
        own = json.loads((out / one["folder"] / "result.json").read_text(encoding="utf-8"))
        (objective,) = own["results"][0]["objectives"]
        assert one["share"] == objective["share_of_inspectable_area"]
        assert one["folder"] == ("ring" if number == 1 else f"ring-size-{number}")
    best = max(found["sizes"], key=lambda one: one["share"])
    assert (found["share"], found["chosen_size"], found["folder"]) == (best["share"], best["size"], best["folder"])
    assert best["size"] == texts[1]
    assert ran.out.startswith(f"ring with {texts[1]} finds most")
    light = load_rig(out / "sizes" / "ring-size-3.yaml").lights[0]
    assert (light.inner_radius_mm, light.outer_radius_mm, light.distance_mm, light.sizes) == (40.0, 61.0, 300.0, None)
    page = (out / "report.html").read_text(encoding="utf-8")
    for text in ("Sizes of lights", "ring-size-2/report.html", *texts):
        assert text in page


def test_sizes_that_no_light_can_have(tmp_path, monkeypatch):
    wrong = (
        SIZED + "      - {inner_radius_mm: 70}\n      - {radius_mm: 30}\n      - {}\n      - {outer_radius_mm: -3}\n"
    )
    monkeypatch.setitem(RIGS, "ring", wrong)
    with pytest.raises(InputError) as refused:
        load_rig(rig_file(tmp_path, "ring"))
    for number, key, text in (
        (2, ".inner_radius_mm", "expected less than outer_radius_mm"),
        (3, ".radius_mm", "kind ring has no such key; it belongs to low_angle_ring, dome, tunnel"),
        (4, "", "expected a value that differs, such as radius_mm: 120"),
        (5, ".outer_radius_mm", "expected a length between 0.001 and 1000000 (a number), found -3"),
    ):
        place = f"ring.yaml:{number + 13}: lights[0].sizes[{number}]{key}: {text}"
        assert any(place in message for message in refused.value.messages), (place, refused.value.messages)


def test_too_many_combinations_of_sizes(bench, tmp_path, cli, monkeypatch):
    many = "".join(f"      - {{outer_radius_mm: {61 + i}}}\n" for i in range(32))
    monkeypatch.setitem(RIGS, "ring", SIZED + many)
    ran = cli("compare-lighting", bench.part, rig_file(tmp_path, "ring"), "-o", tmp_path / "out")
    assert ran.status == 2
    assert "35 combinations of the sizes of its lights; at most 32 are compared" in ran.err
    assert not (tmp_path / "out" / "ring").exists()
