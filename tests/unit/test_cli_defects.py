"""``lightopt defects`` and what ``render`` does with its files: labels, manifest, the good part, resumed runs."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

from lightopt import build_scene, load_part, load_rig
from lightopt.core.provenance import code_sha256
from lightopt.images import read_exr, read_image_set
from lightopt.inspection import place_random_defects

FEW = ("--patches", "500", "-q")
SMALL = """\
defect_catalogue:
  - {name: knock, kind: dent, size_mm: 3, slope_deg: 6}
  - {name: line, kind: scratch, size_mm: [4, 1], slope_deg: 8}
  - {name: "a spot: dark", kind: stain, size_mm: [3, 2], R_d_factor: 0.5}
"""


@pytest.fixture
def catalogue(bench):
    """The small bench, its part with a catalogue that its pixels of 0.44 mm can show."""
    bench.part.write_text("# mine\n" + bench.part.read_text(encoding="utf-8") + SMALL, encoding="utf-8")
    return bench


def scatter(cli, bench, name="bad.yaml", *options, seed=3, count=6):
    return cli("defects", bench.rig, bench.part, "--seed", seed, "--count", count, "-o", bench.folder / name, *options)


def test_a_catalogue_is_strewn_over_what_the_camera_sees(cli, catalogue):
    ran = scatter(cli, catalogue)
    assert (ran.status, ran.err) == (0, "")
    assert ran.out == f"6 defects: 2 × knock, 2 × line, 2 × a spot: dark\n{catalogue.folder / 'bad.yaml'}\n"
    text = (catalogue.folder / "bad.yaml").read_text(encoding="utf-8")
    assert text.startswith(
        catalogue.part.read_text(encoding="utf-8") + "\n# 6 defects, placed at random by: lightopt defects"
    )
    (line,) = (line for line in text.splitlines() if line.startswith("# provenance: "))
    found = json.loads(line.partition(": ")[2])
    assert found["options"] == {"seed": 3, "count": 6}
    assert found["code_sha256"] == code_sha256()
    assert set(found["inputs"]) == {"rig", "part", "mesh"}
    part = load_part(catalogue.folder / "bad.yaml")
    assert [d.name for d in part.defects][:4] == ["knock-1", "line-1", "a spot: dark-1", "knock-2"]
    scene = build_scene(catalogue.rig, part)
    for i, one in enumerate(scene.defects):
        assert np.linalg.norm(scene.placement.to_part(np.array(part.defects[i].at_mm)) - one.position) < 1e-3
        for other in scene.defects[:i]:
            assert np.linalg.norm(one.position - other.position) > (one.shape.length + other.shape.length) / 2
    assert cli("render", catalogue.rig, catalogue.folder / "bad.yaml", "-o", catalogue.out, *FEW).status == 0
    images = read_image_set(catalogue.out)
    seen = {
        int(label)
        for entry in images.manifest.geometry
        for label in np.unique(read_exr(images.path(entry.exr))["defect"])
    }
    assert seen == {-1, 0, 1, 2, 3, 4, 5}, "each is seen in a posture"
    facts = json.loads((catalogue.out / "manifest.json").read_text(encoding="utf-8"))["defects"]
    assert [f["name"] for f in facts] == [d.name for d in part.defects]
    assert facts[1]["kind"] == "scratch"
    assert facts[1]["slope_deg"] == 8
    assert facts[2]["R_d_factor"] == 0.5


def test_the_same_seed_gives_the_same_bytes_and_another_one_others(cli, catalogue):
    scatter(cli, catalogue, "one.yaml", "--threads", 1)
    scatter(cli, catalogue, "two.yaml", "--threads", 3)
    scatter(cli, catalogue, "three.yaml", seed=4)
    one, two, three = ((catalogue.folder / f"{n}.yaml").read_bytes() for n in ("one", "two", "three"))
    assert one == two
    assert one.replace(b"--seed 3", b"--seed 4") != three


@pytest.mark.slow
def test_sizes_and_slopes_are_drawn_from_the_ranges_of_the_catalogue(cli, bench):
    entry = "{name: dent, kind: dent, size_mm: 2, slope_deg: 3, size_range: [0.5, 1.5], slope_range: [0.5, 2]}"
    bench.part.write_text(bench.part.read_text(encoding="utf-8") + f"defect_catalogue: [{entry}]\n", encoding="utf-8")
    out = bench.folder / "dents.yaml"
    assert cli("defects", bench.rig, bench.part, "--seed", "3", "--count", "14", "-o", out).status == 0
    shapes = [defect.shape for defect in load_part(out).defects]
    sizes, slopes = (np.array([getattr(s, name) for s in shapes]) for name in ("length", "slope"))
    assert 1.0 <= sizes.min() < 1.5 < 2.0 < sizes.max() <= 3.0
    assert 1.5 <= np.degrees(slopes).min() < 2.5 < 4.0 < np.degrees(slopes).max() <= 6.0


@pytest.mark.parametrize(("count", "off"), [(60, 0.2), pytest.param(200, 0.11, marks=pytest.mark.nightly)])
def test_places_are_even_by_area(catalogue, count, off):
    """Of many small defects the halves of the knob on either side of its middle get about half each."""
    text = catalogue.part.read_text(encoding="utf-8").partition("defect_catalogue")[0]
    text += "defect_catalogue: [{name: dot, kind: stain, size_mm: 0.01, R_d_factor: 0.5}]\n"
    catalogue.part.write_text(text, encoding="utf-8")
    part = load_part(catalogue.part)
    rig = load_rig(catalogue.rig)
    found = place_random_defects(rig, part, count=count, seed=0)
    places = np.array([d.at_mm for d in found])
    middle = build_scene(rig, part).placement.to_file(np.zeros(3))
    for axis in (0, 1):
        assert abs(np.mean(places[:, axis] > middle[axis]) - 0.5) < off, "three standard deviations"


def test_no_defect_lies_across_an_edge(bench):
    """On the top of a box of 20 × 12 mm, the one face that is seen, dents of 3 mm stay 1.5 mm off its edges."""
    trimesh.creation.box((20, 12, 6)).export(bench.mesh)
    text = bench.part.read_text(encoding="utf-8").replace(", {elevation_deg: -10, rotation_deg: 170}", "")
    text += "defect_catalogue: [{name: knock, kind: dent, size_mm: 3, slope_deg: 6}]\n"
    bench.part.write_text(text, encoding="utf-8")
    found = place_random_defects(load_rig(bench.rig), load_part(bench.part), count=4, seed=1)
    places = np.abs([d.at_mm for d in found])
    assert np.allclose(places[:, 2], 3)
    assert places[:, 0].max() < 10 - 1.5
    assert places[:, 1].max() < 6 - 1.5


def test_defects_in_another_folder_still_find_the_mesh(cli, catalogue):
    ran = scatter(cli, catalogue, "sub/deep/bad.yaml", "-q", count=1)
    assert (ran.status, ran.out) == (0, "")
    part = load_part(catalogue.folder / "sub" / "deep" / "bad.yaml")
    assert part.mesh.file == "../../knob.stl"


def test_another_result_is_not_overwritten(cli, catalogue):
    assert scatter(cli, catalogue).status == 0
    assert scatter(cli, catalogue).status == 0
    ran = scatter(cli, catalogue, seed=9)
    assert ran.status == 2
    assert "bad.yaml: exists with other content; use --force to replace it" in ran.err
    assert scatter(cli, catalogue, "bad.yaml", "--force", seed=9).status == 0


@pytest.mark.slow
def test_too_many_too_few_and_those_already_there_are_refused(cli, catalogue):
    ran = scatter(cli, catalogue, seed=-1, count=0)
    assert ran.status == 2
    assert ran.err.splitlines() == [
        "error: count: expected 1 to 500 defects, found 0",
        "error: seed: expected 0 or more, found -1",
    ]
    ran = scatter(cli, catalogue, count=60)
    assert ran.status == 2
    assert "of 60 defects, each seen whole in a posture and apart from the others" in ran.err
    assert not (catalogue.folder / "bad.yaml").exists()
    scatter(cli, catalogue, count=1)
    ran = cli(
        "defects", catalogue.rig, catalogue.folder / "bad.yaml", "--seed", 1, "--count", 1, "-o", catalogue.folder / "x"
    )
    assert ran.status == 2
    assert "defects: this part file lists defects already" in ran.err
    ran = scatter(cli, catalogue, ".")
    assert "expected the name of a file to write, found a folder" in ran.err


def test_without_defects_the_images_are_those_of_the_good_part(cli, catalogue, snapshot):
    scatter(cli, catalogue)
    bad = catalogue.folder / "bad.yaml"
    sets = {"good": (catalogue.part,), "shown": (bad,), "hidden": (bad, "--no-defects")}
    for name, (part, *options) in sets.items():
        assert cli("render", catalogue.rig, part, "-o", catalogue.folder / name, *FEW, *options).status == 0
    good, shown, hidden = (snapshot(catalogue.folder / name) for name in sets)
    pngs = [name for name in good if name.endswith(".png")]
    assert pngs
    assert all(good[name] == hidden[name] for name in pngs)
    assert any(good[name] != shown[name] for name in pngs)
    for name in (n for n in good if n.endswith(".exr")):
        one, other = (read_exr(catalogue.folder / folder / name) for folder in ("good", "hidden"))
        assert one.keys() == other.keys()
        assert all(np.array_equal(one[channel], other[channel]) for channel in one)
    manifests = [json.loads((catalogue.folder / name / "manifest.json").read_text(encoding="utf-8")) for name in sets]
    assert ["defects" in m for m in manifests] == [False, True, False]
    assert ["defects" in m["provenance"]["options"] for m in manifests] == [False, False, True]
    geometry = "posture_0_0/geometry.exr"
    plain, labelled = (read_exr(catalogue.folder / name / geometry) for name in ("good", "shown"))
    assert labelled.keys() - plain.keys() == {"defect"}
    assert labelled["defect"].dtype == np.float32
    assert all(np.array_equal(plain[channel], labelled[channel]) for channel in plain)


def test_a_set_with_defects_is_resumed_and_not_mixed_with_the_good_one(cli, catalogue):
    scatter(cli, catalogue, count=2)
    bad = catalogue.folder / "bad.yaml"
    command = ("render", catalogue.rig, bad, "-o", catalogue.out, "--patches", "500")
    assert cli(*command).status == 0
    again = cli(*command)
    assert again.status == 0
    assert "4 of them existed already" in again.out
    ran = cli(*command, "--no-defects")
    assert ran.status == 2
    assert "holds the image set of another run" in ran.err


def test_a_defect_that_rays_may_miss_is_warned_of(cli, catalogue):
    hair = "{name: hair, kind: scratch, at_pixel: {posture: {elevation_deg: 0, rotation_deg: 0}, pixel: [80, 50]}, "
    text = catalogue.part.read_text(encoding="utf-8")
    catalogue.part.write_text(text + f"defects: [{hair}size_mm: [5, 0.1], slope_deg: 5}}]\n", encoding="utf-8")
    command = ("render", catalogue.rig, catalogue.part, *FEW, "--posture", "0,0", "--light", "light1")
    ran = cli(*command, "-o", catalogue.out)
    assert ran.status == 0
    assert "1 defect narrower than the 0.44 mm between rays (hair)" in ran.err
    assert "supersampling by 14 shows how far they fill each pixel" in ran.err
    assert cli(*command, "-o", catalogue.folder / "fine", "--supersample", "5").err == ""


def test_a_wrong_place_is_reported_before_anything_is_written(cli, catalogue):
    text = catalogue.part.read_text(encoding="utf-8")
    lost = "{name: lost, kind: dent, at_mm: [0, 0, 900], size_mm: 1, slope_deg: 5}"
    catalogue.part.write_text(f"{text}defects: [{lost}]\n", encoding="utf-8")
    for command in (("render", "-o", catalogue.out), ("check",)):
        ran = cli(command[0], catalogue.rig, catalogue.part, *command[1:])
        assert ran.status == 2 or command[0] == "check"
        assert "expected a place on the part's surface, within 0.5 mm" in ran.err + ran.out
    assert not catalogue.out.exists()
