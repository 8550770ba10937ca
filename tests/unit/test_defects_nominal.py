"""A part file's defects are of one piece: what commands answer about the nominal part does not depend on them."""

from __future__ import annotations

import json

import pytest

from lightopt.cli._main import run
from lightopt.images import read_image_set

pytestmark = pytest.mark.usefixtures("few_pixels_for_the_rest")
DEFECTS = """\
defects:
  - {name: stain, kind: stain, at_pixel: {posture: {elevation_deg: 0, rotation_deg: 0}, pixel: [58, 60]}, \
size_mm: 8, R_d_factor: 0.3}
  - {name: dent, kind: dent, at_pixel: {posture: {elevation_deg: 0, rotation_deg: 0}, pixel: [92, 72]}, \
size_mm: 8, slope_deg: 20}
"""
SOME = ("--pixels", "1500")
FEW = ("--patches", "500", "-q")


@pytest.fixture(scope="module")
def shop(shared_bench, tmp_path_factory):
    """A rig, a part with and without defects, and images of the piece that has them."""
    bench = type(shared_bench).make(tmp_path_factory.mktemp("shop"))
    text = bench.rig.read_text(encoding="utf-8")
    moving = text.replace("azimuth_deg: 45}", "azimuth_deg: 45, elevation_range_deg: [40, 60]}")
    (bench.folder / "moving.yaml").write_text(moving, encoding="utf-8")
    part = bench.part.read_text(encoding="utf-8")
    (bench.folder / "bad").mkdir()
    (bench.folder / "bad" / "part.yaml").write_text(part.replace("knob.stl", "../knob.stl") + DEFECTS, encoding="utf-8")
    (bench.folder / "good").mkdir()
    (bench.folder / "good" / "part.yaml").write_text(part.replace("knob.stl", "../knob.stl"), encoding="utf-8")
    bad = bench.folder / "bad" / "part.yaml"
    command = ["render", bench.rig, bad, "-o", bench.folder / "images", "--posture", "0,0", "--noise", "3", *FEW]
    assert run([str(word) for word in command]) == 0
    return bench


def parts(shop):
    return [shop.folder / name / "part.yaml" for name in ("good", "bad")]


def without_provenance(path):
    found = json.loads(path.read_text(encoding="utf-8"))
    assert found.pop("provenance")["inputs"]["part"]
    return found


def test_the_images_show_the_defects(shop):
    assert [d["name"] for d in read_image_set(shop.folder / "images").manifest.extra["defects"]] == ["stain", "dent"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "name"),
    [
        pytest.param(("fit-diffuse", *SOME), "fit.json", marks=pytest.mark.nightly),
        pytest.param(("fit-specular", "--joint", *SOME), "fit.json", marks=pytest.mark.nightly),
        pytest.param(("inspect", "--min-images", "1", "--no-report"), "defects.json", marks=pytest.mark.slow),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_images_are_judged_by_the_nominal_part(cli, shop, tmp_path, command, name):
    found = []
    for k, part in enumerate(parts(shop)):
        out = tmp_path / str(k)
        ran = cli(command[0], shop.rig, part, shop.folder / "images", "-o", out, "-q", *command[1:])
        assert ran.status == 0, ran.err
        found.append(without_provenance(out / name))
        for picture in (out / "left-out").glob("*.png"):
            assert (tmp_path / "0" / "left-out" / picture.name).read_bytes() == picture.read_bytes()
    assert found[0] == found[1]


def compared(cli, shop, tmp_path, *options):
    found = []
    for k, part in enumerate(parts(shop)):
        out = tmp_path / str(k)
        ran = cli(
            "optimize", shop.folder / "moving.yaml", part, "-o", out, "--step", "20", "--no-report", *FEW, *options
        )
        assert ran.status == 0, ran.err
        found.append(without_provenance(out / "result.json"))
    assert found[0] == found[1]
    pictures = sorted(path.relative_to(tmp_path / "0") for path in (tmp_path / "0").rglob("*.exr"))
    for path in pictures:
        assert (tmp_path / "0" / path).read_bytes() == (tmp_path / "1" / path).read_bytes()
    assert (tmp_path / "0" / "ranking.csv").read_bytes() == (tmp_path / "1" / "ranking.csv").read_bytes()
    return pictures


def test_lights_are_optimised_for_the_nominal_part(cli, shop, tmp_path):
    pictures = compared(cli, shop, tmp_path, "--posture", "0,0")
    assert any(path.name == "light1.exr" for path in pictures)


@pytest.mark.slow
def test_plans_are_made_for_the_nominal_part_and_the_catalogue(cli, shop, tmp_path):
    compared(cli, shop, tmp_path, "--choose-postures", "1", "--posture-step", "45", "--no-images")


def test_a_kept_matrix_serves_both(cli, shop, tmp_path):
    good, bad = parts(shop)
    command = (shop.folder / "moving.yaml", "-o", tmp_path, "--step", "20", "--no-images", "--no-report")
    more = ("--patches", "500", "--posture", "0,0", "--keep-matrix", "--force")
    assert cli("optimize", command[0], good, *command[1:], *more).status == 0
    ran = cli("optimize", command[0], bad, *command[1:], *more, "--verbose")
    assert "1 stored luminance matrix reused" in ran.out


@pytest.mark.slow
def test_a_list_that_cannot_be_placed_stops_only_what_shows_it(cli, shop, tmp_path):
    text = parts(shop)[1].read_text(encoding="utf-8").replace("pixel: [58, 60]", "pixel: [1, 1]")
    part = parts(shop)[1].with_name("misplaced.yaml")
    part.write_text(text, encoding="utf-8")
    images = shop.folder / "images"
    assert cli("fit-diffuse", shop.rig, part, images, "-o", tmp_path / "fit", "-q", *SOME).status == 0
    assert cli("render", shop.rig, part, "-o", tmp_path / "render", *FEW).status == 2
    assert cli("check", shop.rig, part).status == 2
