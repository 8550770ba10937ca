"""Defects in part files: what is accepted, and what every mistake is told."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import get_args

import jsonschema
import pytest
from test_config_models import KNOWN_ERRORS, PROBES, error_kinds, paths, with_value

from lightopt.config import PartConfig, json_schema, load_part, with_list
from lightopt.core.errors import InputError
from lightopt.defects import BUILT_IN_CATALOGUE, DefectKind, depth_of_slope
from lightopt.scene import build_catalogue

GOOD = [
    {"name": "a", "kind": "scratch", "at_mm": [1, 2, 3], "size_mm": [5, 0.2], "slope_deg": 4, "direction_deg": 30},
    {"name": "b", "kind": "dent", "at_mm": [1, 2, 3], "size_mm": 2, "depth_mm": 0.02},
    {
        "name": "c",
        "kind": "stain",
        "at_pixel": {"posture": {"elevation_deg": 0, "rotation_deg": 82}, "pixel": [800, 600]},
        "size_mm": [2, 1],
        "R_d_factor": 0.5,
    },
    {"name": "d", "kind": "haze", "at_mm": [1, 2, 3], "size_mm": 2, "sigma_factor": 2},
]


def part_with(bench, **lists):
    text = bench.part.read_text(encoding="utf-8")
    bench.part.write_text(text + "".join(f"{k}: {json.dumps(v)}\n" for k, v in lists.items()), encoding="utf-8")
    return load_part(bench.part)


def refused(bench, **lists) -> str:
    with pytest.raises(InputError) as error:
        part_with(bench, **lists)
    return str(error.value)


def changed(number, **values):
    entry = {**GOOD[number], **values}
    return [{k: v for k, v in entry.items() if v is not None}]


def test_what_the_documents_show_is_read(bench):
    part = part_with(bench, defects=GOOD)
    scratch, dent, stain, haze = (defect.shape for defect in part.defects)
    assert (scratch.length, scratch.width) == (5, 0.2)
    assert math.degrees(scratch.slope) == pytest.approx(4)
    assert depth_of_slope("dent", 2.0, dent.slope) == pytest.approx(0.02)
    assert dent.depth == pytest.approx(0.02)
    assert (stain.R_d_factor, stain.slope, stain.depth) == (0.5, 0, 0)
    assert haze.sigma_factor == 2
    assert part.defects[2].at_pixel.pixel == (800, 600)
    assert part.defect_catalogue is None
    jsonschema.Draft202012Validator(json_schema("part")).validate({**minimal(), "defects": GOOD})


def minimal():
    return {
        "format": "lightopt-part/1",
        "name": "x",
        "mesh": {"file": "a.step"},
        "reflectance": {"R_d": 1, "R_s": 1, "sigma_rad": 0.1},
    }


def test_a_part_without_defects_has_none(bench):
    assert load_part(bench.part).defects == ()
    assert part_with(bench, defects=[]).defects == ()


def test_an_empty_catalogue_is_refused(bench):
    assert "defect_catalogue: expected at least one entry, found none" in refused(bench, defect_catalogue=[])


CASES = [
    (changed(0, slope_deg=0), "slope_deg: expected a number above 0, up to 60 (degrees), found 0"),
    (changed(0, slope_deg=61), "slope_deg: expected a number above 0, up to 60 (degrees), found 61"),
    (changed(0, slope_deg=None), 'missing key "slope_deg" or "depth_mm"'),
    (changed(0, depth_mm=0.01), "depth_mm: given together with slope_deg"),
    (changed(0, size_mm=2), "size_mm: expected [length, width] of a scratch"),
    (changed(0, size_mm=[0.2, 5]), "expected [length, width] with the length at least the width"),
    (changed(0, size_mm=[5, 0]), "expected a diameter, or [length, width], in mm from 0.001 to 1000, found [5, 0]"),
    (changed(1, size_mm=0), "expected a diameter, or [length, width], in mm from 0.001 to 1000, found 0"),
    (changed(1, depth_mm=0), "depth_mm: expected a number above 0, up to 1000 (mm), found 0"),
    (changed(1, depth_mm=2), "a dent 2 mm wide and 2 mm deep has walls of 72 degrees; expected at most 1.1 mm"),
    (changed(1, R_d_factor=0.5), "R_d_factor: kind dent has no such key; it belongs to stain"),
    (changed(1, kind="hole"), 'kind: expected scratch, dent, bump, pit, blister, stain or haze, found "hole"'),
    (changed(1, at_mm=None), 'missing key "at_mm" or "at_pixel": expected one of them'),
    (changed(2, at_mm=[0, 0, 0]), "at_pixel: given together with at_mm"),
    (changed(2, R_d_factor=None), 'missing key "R_d_factor": Stains: factor on R_d; not 1. Kind stain needs it'),
    (changed(2, R_d_factor=1), "expected a number other than 1: with 1 there is no defect"),
    (changed(2, slope_deg=3), "slope_deg: kind stain has no such key; it belongs to scratch, dent, bump, pit, blister"),
    (changed(2, at_pixel={"pixel": [1, 2]}), 'missing key "posture"'),
    (
        changed(2, at_pixel={**GOOD[2]["at_pixel"], "pixel": [-1, 2]}),
        "pixel: expected [column, row], two whole numbers from 0 to 65535",
    ),
    (changed(3, sigma_factor=None), 'missing key "sigma_factor": Hazes'),
    (changed(3, sigma_factor=1), "expected a number other than 1: with 1 there is no defect"),
    (changed(3, direction_deg=400), "expected a number from -360 to 360 (degrees), found 400"),
    (changed(3, colour=1), 'unknown key "colour"'),
    ([GOOD[0], GOOD[0]], 'defects[1].name: the name "a" is already that of defects[0]'),
]


@pytest.mark.parametrize(("defects", "message"), CASES, ids=[m[:40] for _, m in CASES])
def test_every_mistake_is_named_with_its_line(bench, defects, message):
    text = refused(bench, defects=defects)
    assert message in text
    assert text.startswith(f"{bench.part}:7: defects[")
    assert len(text.splitlines()) == 1


def test_all_mistakes_come_at_once(bench):
    text = refused(bench, defects=[case[0][0] for case in CASES[:3]])
    assert [f"defects[{i}]" in line for i, line in enumerate(text.splitlines()) if line.count("defects[")]
    assert len(text.splitlines()) >= 3


def test_a_catalogue_names_kinds_and_no_places(bench):
    entry = {k: v for k, v in GOOD[0].items() if k not in ("at_mm", "direction_deg")}
    assert part_with(bench, defect_catalogue=[entry]).defect_catalogue[0].shape.kind == "scratch"
    bench.part.write_text(bench.part.read_text(encoding="utf-8").rpartition("defect_cat")[0], encoding="utf-8")
    said = refused(bench, defect_catalogue=[GOOD[0]])
    assert 'unknown key "at_mm"; it belongs to the entries of defects: remove it, or move the entry there' in said
    assert "depth_mm" not in said


PIT = {"name": "pit", "kind": "pit", "size_mm": 1, "slope_deg": 20}


def test_a_catalogue_may_have_ranges_of_sizes_and_slopes(bench):
    entries = [{**PIT, "size_range": [0.5, 2], "slope_range": [0.1, 3]}, {**GOOD[3], "size_range": [1, 4]}]
    entries[1].pop("at_mm")
    pit, haze = build_catalogue(part_with(bench, defect_catalogue=entries))
    assert (pit.sizes, pit.slopes, haze.sizes, haze.slopes) == ((0.5, 2), (0.1, 3), (1, 4), (1, 1))
    assert build_catalogue(load_part(bench.part))[0].shape.slope == pytest.approx(math.radians(20))


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (
            {**PIT, "size_range": [2, 0.5]},
            "size_range: expected [low, high], found the low end 2 above the high end 0.5",
        ),
        ({**PIT, "size_range": 2}, "size_range: expected [least, greatest], two numbers from 0.1 to 10"),
        ({**PIT, "slope_range": [1, 3.1]}, "slope_range: the steepest walls would be 62 degrees; expected at most 60"),
        (
            {**PIT, "slope_deg": None, "depth_mm": 0.2, "slope_range": [1, 9]},
            "slope_range: the steepest walls would be 239 degrees",
        ),
        (
            {"name": "s", "kind": "stain", "size_mm": 2, "R_d_factor": 0.5, "slope_range": [1, 2]},
            "slope_range: a stain has no slope; remove this key",
        ),
    ],
)
def test_a_wrong_range_is_named_with_its_line(bench, entry, message):
    text = refused(bench, defect_catalogue=[{k: v for k, v in entry.items() if v is not None}])
    assert message in text
    assert text.startswith(f"{bench.part}:7: defect_catalogue[0].")


def test_no_kind_of_error_falls_through(tmp_path):
    data = {
        **minimal(),
        "defects": GOOD,
        "defect_catalogue": [{**PIT, "size_range": [0.5, 2], "slope_range": [0.5, 2]}],
    }
    places = [path for path in paths(data) if str(path[0]).startswith("defect")]
    kinds = {
        kind
        for path in places
        for probe in PROBES
        for kind in error_kinds(PartConfig, with_value(data, path, probe), tmp_path)
    }
    assert kinds <= KNOWN_ERRORS


def test_a_list_is_added_at_the_end_and_nothing_else_changes():
    text = "# top\na: 1  # one\n\n\n"
    longer = with_list(text, "defects", ["{name: x}", "{name: y}"], comment="two")
    assert longer == "# top\na: 1  # one\n\n# two\ndefects:\n  - {name: x}\n  - {name: y}\n"


@pytest.mark.parametrize("text", ["{a: 1}\n", "a: 1\n...\n", "defects: []\n", "a: |\n  text\n \n  more: [\n..."])
def test_a_file_that_nothing_can_be_added_to_is_refused(text):
    with pytest.raises(InputError, match="defects cannot be added at the end"):
        with_list(text, "defects", ["{name: x}"], comment="c")


def test_what_the_documentation_shows_is_read(bench):
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "defects.md").read_text(encoding="utf-8")
    snippets = re.findall(r"^```yaml\n(.*?)^```", page, re.M | re.S)
    bench.part.write_text(bench.part.read_text(encoding="utf-8") + "".join(snippets), encoding="utf-8")
    part = load_part(bench.part)
    assert [d.shape.kind for d in part.defects] == ["scratch", "dent", "stain"]
    assert [one.shape.kind for one in part.defect_catalogue or ()] == ["scratch", "dent", "stain", "dent"]
    for entry in BUILT_IN_CATALOGUE:
        row = next(line for line in page.splitlines() if line.startswith(f"| {entry.name} |") and "why" not in line)
        assert row
        depth = f"{entry.shape.depth * 1000:.2g} µm"
        assert not entry.shape.slope or depth in page


def test_kinds_are_reported_in_words():
    assert all(kind in json.dumps(json_schema("part")) for kind in get_args(DefectKind))
