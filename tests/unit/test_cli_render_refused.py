"""What ``lightopt check`` calls an error ``lightopt render`` refuses, in the same words and before it writes."""

from __future__ import annotations

import pytest


def errors_of(ran):
    """The findings that are errors: text, and where they come from."""
    found = [line.removeprefix("error:").strip() for line in ran.out.splitlines() if line.startswith("error:")]
    return [line.partition(": ")[2].rpartition(" (")[::2] for line in found]


def refuse(cli, bench, *options):
    checked = cli("check", bench.rig, bench.part)
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *options)
    assert ran.status == 2
    assert not bench.out.exists()
    assert "Traceback" not in ran.err
    return checked, ran


def test_a_panel_inside_the_part(cli, bench):
    bench.edit("rig.yaml", "distance_mm: 330, elevation_deg: 45", "distance_mm: 20, elevation_deg: 45")
    checked, ran = refuse(cli, bench)
    assert checked.status == 1
    texts = errors_of(checked)
    assert texts
    assert ran.err.splitlines() == [f"error: {where.removesuffix(')')}: {text}" for text, where in texts]
    assert "light3's panel are inside the part" in ran.err
    assert f"{bench.rig}:13: lights[1]" in ran.err


def test_a_panel_that_is_not_requested_does_not_matter(cli, bench):
    bench.edit("rig.yaml", "distance_mm: 330, elevation_deg: 45", "distance_mm: 20, elevation_deg: 45")
    options = ("--light", "light1", "--patches", "500", "-q")
    assert cli("render", bench.rig, bench.part, "-o", bench.out, *options).status == 0


@pytest.mark.parametrize(("unit", "reported"), [("um", "no pixel on the part at best"), ("m", "is inside the part")])
def test_a_part_a_thousand_times_too_small_or_large(cli, bench, unit, reported):
    bench.edit("part.yaml", "units: mm", f"units: {unit}")
    checked, ran = refuse(cli, bench)
    assert reported in checked.out + checked.err
    what, hint = ran.err.splitlines()
    assert reported in what
    assert f"{bench.part}:3: mesh.file" in what
    assert hint.startswith(f"error: {bench.part}:3: mesh.units: a wrong unit? Read as {unit}, ")
    assert "if the file were in mm (52 mm" in hint


def test_a_part_of_a_few_pixels_is_no_image_and_a_small_one_is(cli, bench):
    def seen_from(image_distance):
        rig = bench.folder / f"rig-{image_distance}.yaml"
        text = bench.rig.read_text(encoding="utf-8")
        text = text.replace("image_distance_mm: 55", f"image_distance_mm: {image_distance}")
        rig.write_text(text, encoding="utf-8")
        return cli("render", rig, bench.part, "-o", bench.folder / "out", "--patches", "500", "-q", "--force")

    few = seen_from(1)  # a footprint of 24 mm
    assert few.status == 2
    assert "pixels on the part at best, in any posture: it measures 52 × 45.99 × 18.49 mm" in few.err
    assert "a pixel's footprint is 24.2 mm" in few.err
    assert seen_from(3).status == 0
