"""Truth of images without labels: cast from the defects that the part's file names, where the part was found."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from lightopt import load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.images import ImageSet, SourceFile, read_image_set
from lightopt.inspection import InspectOptions, inspect_set
from lightopt.inspection.evaluation._evaluation import true_labels, truth_source
from lightopt.rendering import RenderOptions, render_image_set
from lightopt.scene import place_defects

FLAT = "posture: {elevation_deg: 0, rotation_deg: 0}"
DEFECTS = f"""\
defects:
  - {{name: stain, kind: stain, at_pixel: {{{FLAT}, pixel: [58, 60]}}, size_mm: 3.5, R_d_factor: 0.6}}
  - {{name: dent, kind: dent, at_pixel: {{{FLAT}, pixel: [92, 72]}}, size_mm: 5, slope_deg: 12}}
"""
QUICK = InspectOptions(fusion=None)


def unlabelled(image_set):
    extra = {key: value for key, value in image_set.manifest.extra.items() if key != "defects"}
    return ImageSet(image_set.folder, replace(image_set.manifest, extra=extra))


def both(bench, folder, *, rendered, register):
    """Labels that a set was rendered with, and those cast from the part's file."""
    rig, part = load_rig(bench.rig), load_part(bench.part)
    render_image_set(rig, load_part(rendered), folder, options=RenderOptions(noise=3, patch_budget=500))
    image_set = read_image_set(folder)
    result = inspect_set(rig, part, image_set, options=replace(QUICK, register=register), run=RunContext(threads=2))
    known = place_defects(result.nominal, rig, part)
    listed, stored, source = true_labels(image_set, result, known=known)
    cast_list, cast, cast_source = true_labels(unlabelled(image_set), result, known=known)
    assert (source, cast_source) == ("images", "part file")
    assert [one["name"] for one in cast_list] == [one["name"] for one in listed]
    assert [one["position_mm"] for one in cast_list] == [one["position_mm"] for one in listed]
    return stored, cast


def test_cast_labels_are_those_of_the_renderer_in_every_posture(bench, tmp_path):
    bench.part.write_text(bench.part.read_text(encoding="utf-8") + DEFECTS, encoding="utf-8")
    stored, cast = both(bench, tmp_path / "images", rendered=bench.part, register=False)
    assert len(cast) == 2
    for one, other in zip(stored, cast, strict=True):
        assert set(np.unique(one)) == {-1, 0, 1}
        assert (one != other).sum() == 0


@pytest.mark.nightly
def test_cast_labels_lie_where_the_part_was_found(bench, tmp_path):
    bench.part.write_text(bench.part.read_text(encoding="utf-8") + DEFECTS, encoding="utf-8")
    text = bench.part.read_text(encoding="utf-8").replace("at_pixel", "at_mm")
    listed = place_defects_of(bench)
    for (x, y, z), pixel in zip(listed, ("[58, 60]", "[92, 72]"), strict=True):
        text = text.replace(f"at_mm: {{{FLAT}, pixel: {pixel}}}", f"at_mm: [{x}, {y}, {z}]")
    bench.part.write_text(text, encoding="utf-8")
    moved = bench.part.with_name("moved.yaml")
    nominal = "translate_mm: [0, 0, 0]"
    assert nominal in text
    turned = "translate_mm: [1.5, -0.8, 0], rotate_deg: [0, 0, 2]"
    moved.write_text(text.replace(nominal, turned), encoding="utf-8")
    stored, cast = both(bench, tmp_path / "images", rendered=moved, register=True)
    for one, other in zip(stored, cast, strict=True):
        size = (one >= 0).sum()
        assert size > 60
        assert (one != other).sum() < 0.1 * size


def place_defects_of(bench):
    """Centres of the part's defects in the mesh file's coordinates."""
    from lightopt import build_scene

    rig, part = load_rig(bench.rig), load_part(bench.part)
    scene = build_scene(rig, part)
    return [[round(float(x), 4) for x in scene.placement.to_file(d.position)] for d in scene.defects]


@pytest.mark.nightly
def test_a_captured_set_is_held_against_the_defects_of_its_part(cli, bench, request):
    good = bench.part.read_text(encoding="utf-8")
    bench.part.write_text(good + DEFECTS, encoding="utf-8")
    request.getfixturevalue("take")(bench.folder / "captured")
    options = ("--no-register", "--fusion", "none", "--evaluate")
    ran = cli("inspect", bench.rig, bench.part, bench.folder / "captured", "-o", bench.folder / "found", *options)
    assert ran.status == 0, ran.err
    assert "2 of 2 known defects found" in ran.out
    reported = json.loads((bench.folder / "found" / "truth.json").read_text(encoding="utf-8"))
    assert reported["labels"] == ["part file"]
    assert (reported["found"], reported["hidden"], reported["false_alarms_per_posture"]) == (2, [], 0)

    # edited since: nothing is known of what is not named
    bench.part.write_text(good, encoding="utf-8")
    ran = cli("inspect", bench.rig, bench.part, bench.folder / "captured", "-o", bench.folder / "none", *options)
    assert ran.status == 2
    assert "no ground truth for this part" in ran.err
    assert not (bench.folder / "none").exists()


def test_what_is_on_a_captured_part_is_in_the_file_that_it_was_taken_by(bench, request):
    good = load_part(bench.part)
    request.getfixturevalue("take")(bench.folder / "captured")
    image_set = read_image_set(bench.folder / "captured")
    named = bench.part.with_name("named.yaml")
    named.write_text(bench.part.read_text(encoding="utf-8") + DEFECTS, encoding="utf-8")
    for requested in (good, load_part(named)):
        source = truth_source(image_set, requested)
        assert source.part is not None
        assert source.part.defects == ()
        assert "lists no defects; the part counts as good" in source.warnings[0]
    by_named = replace(image_set.manifest, part=SourceFile(named.name, load_part(named).source.sha256))
    source = truth_source(ImageSet(image_set.folder, by_named), good)
    assert [d.name for d in source.part.defects] == ["stain", "dent"]
    # not as it was then
    named.write_text(named.read_text(encoding="utf-8") + "# edited\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"part file named\.yaml is not beside .* or has changed"):
        truth_source(ImageSet(image_set.folder, by_named), good)
    # edited, and it is the one that is given
    assert len(truth_source(ImageSet(image_set.folder, by_named), load_part(named)).part.defects) == 2
