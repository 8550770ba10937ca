"""A part that lies off its place: its defects are found where they are on it, better than without a model."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from lightopt import load_part, load_rig
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.images import read_exr, read_image_set
from lightopt.inspection import InspectOptions, SyntheticImage, inspect_set
from lightopt.inspection.detection._matched_filter import score_templates
from lightopt.inspection.evaluation._evaluation import area_under_roc
from lightopt.inspection.fusion._gradient_fusion import FUSIONS, pixel_weights
from lightopt.inspection.fusion._synthetic_image import fuse_images
from lightopt.rendering import RenderOptions, render_image_set

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
FIRST = "elevation_deg: 0, rotation_deg: 0"
FLAT = f"posture: {{{FIRST}}}"
DEFECTS = f"""\
defects:
  - {{name: stain, kind: stain, at_pixel: {{{FLAT}, pixel: [58, 60]}}, size_mm: 3, R_d_factor: 0.8}}
  - {{name: dent, kind: dent, at_pixel: {{{FLAT}, pixel: [92, 72]}}, size_mm: 5, slope_deg: 8}}
  - {{name: scratch, kind: scratch, at_pixel: {{{FLAT}, pixel: [88, 38]}}, size_mm: [6, 1.2], slope_deg: 8}}
"""
OPTIONS = RenderOptions(noise=7, postures=(Posture(0.0, 0.0),), patch_budget=500, layers=True)


def four_lights(bench):
    """Text of the small rig with a light in each corner."""
    lights = "".join(
        f"  - {{name: light{i + 1}, distance_mm: 330, elevation_deg: 60, azimuth_deg: {45 + 90 * i}}}\n"
        for i in range(4)
    )
    text = bench.rig.read_text(encoding="utf-8")
    return re.sub(r"lights:\n(  - .*\n)+", f"lights:\n{lights}", text)


@pytest.fixture(scope="module")
def trial(shared_bench, tmp_path_factory):
    """Rig and part, and the images of a part with defects that lies 0.4 mm, 0.3 mm and 0.5° off."""
    folder = tmp_path_factory.mktemp("trial")
    text = shared_bench.part.read_text(encoding="utf-8") + DEFECTS
    nominal = "translate_mm: [0, 0, 0]"
    assert nominal in text
    path = shared_bench.part.with_name("off.yaml")
    path.write_text(text.replace(nominal, "translate_mm: [0.4, -0.3, 0], rotate_deg: [0, 0, 0.5]"), encoding="utf-8")
    four = shared_bench.rig.with_name("four.yaml")
    four.write_text(four_lights(shared_bench), encoding="utf-8")
    rig = load_rig(four)
    render_image_set(rig, load_part(path), folder / "bad", options=OPTIONS)
    return rig, load_part(shared_bench.part), read_image_set(folder / "bad")


@pytest.fixture(scope="module")
def found(trial):
    rig, part, bad = trial
    return inspect_set(rig, part, bad, run=RunContext(threads=2))


@pytest.mark.slow
def test_defects_are_where_they_are_on_the_part_wherever_it_lies(trial, found):
    truth = trial[2].manifest.extra["defects"]
    assert found.placement is not None
    assert math.degrees(found.placement.turn) == pytest.approx(0.5, abs=0.1)
    for one in truth:
        near = min(math.dist(d.best.position, one["position_mm"]) for d in found.defects)
        assert near < 0.5 * max(one["size_mm"]), one["name"]
    for defect in found.defects:
        near = min(math.dist(defect.best.position, one["position_mm"]) for one in truth)
        assert near < 6.0  # no false alarm


@pytest.mark.slow
@pytest.mark.parametrize(("rays", "bounces"), [(1, 0), (4, 0), (1, 1)])
def test_a_good_part_has_no_defects_whether_pixels_show_means_or_centres(tmp_path, rays, bounces):
    """The spout's hard shadows: predicted at the centres alone, means over pixels look like a dozen defects.

    And its light on itself: what few rays say of it differs from place to place, over as many pixels as a defect has.
    """
    sample = (CONFIGS / "rigs" / "four-panel.yaml").read_text(encoding="utf-8")
    rig = tmp_path / "rig.yaml"
    rig.write_text(sample.replace("[1600, 1200]", "[320, 240]").replace("4.4  ", "22  "), encoding="utf-8")
    text = (CONFIGS / "parts" / "spout.yaml").read_text(encoding="utf-8").replace("spout.step", "spout.stl")
    text = text.replace("spout.stl", str(CONFIGS / "parts" / "spout.stl"))
    place = "anchor: rest_on_table\n  translate_mm: [0.4, -0.3, 0]\n  rotate_deg: [0, 0, 0.3]\n"
    for name, moved in (("part", text), ("off", re.sub(r"anchor: rest_on_table.*\n", place, text))):
        moved += f"inspection: {{bounces: {bounces}}}\n"
        (tmp_path / f"{name}.yaml").write_text(moved, encoding="utf-8")
    how = {"noise": 1, "postures": (Posture(0.0, 0.0),), "patch_budget": 500}
    options = RenderOptions(**how, supersample=rays, bounces=bounces)
    render_image_set(load_rig(rig), load_part(tmp_path / "off.yaml"), tmp_path / "good", options=options)
    detector = {"detector": "residual", "min_images": 1} if bounces == 0 else {}
    inspection = InspectOptions(**detector, fusion=None)
    found = inspect_set(
        load_rig(rig), load_part(tmp_path / "part.yaml"), read_image_set(tmp_path / "good"), options=inspection
    )
    assert found.defects == ()


@pytest.mark.slow
def test_the_default_beats_every_image_alone_and_the_pixelwise_minimum(trial, found):
    posture = found.postures[0]
    view = posture.view
    truth = trial[2].load_geometry(trial[2].geometry[0])["defect"][view.clean] >= 0

    def area(score):
        return area_under_roc(score[view.clean].astype(np.float64), truth)

    seen = np.minimum(view.level, view.limit)
    none = np.zeros(view.clean.shape, bool)
    baselines = [
        area(score_templates(SyntheticImage(level, 0 * level, none, view.clean))) for level in (*seen, seen.min(axis=0))
    ]
    assert area(posture.score) > max(baselines)


PARTS = Path(__file__).parents[2] / "configs" / "parts"


@pytest.fixture(scope="module", params=["cover-knob", "spout"])
def good_part_seen(request, shared_bench, tmp_path_factory):
    """A good sample part under four lights, and the diffuse light of its images."""
    text = four_lights(shared_bench)
    text = text.replace("[160, 120]", "[240, 180]").replace("pixel_size_um: 44", f"pixel_size_um: {44 * 2 / 3}")
    finer = shared_bench.rig.with_name("finer.yaml")
    finer.write_text(text, encoding="utf-8")
    rig = load_rig(finer)
    text = (PARTS / f"{request.param}.yaml").read_text(encoding="utf-8")
    text = re.sub(r"file: \S+", f"file: '{(PARTS / f'{request.param}.step').as_posix()}'", text)
    text = re.sub(r"postures:.*?\nreflectance:", f"postures: [{{{FIRST}}}]\n\nreflectance:", text, flags=re.DOTALL)
    folder = tmp_path_factory.mktemp(request.param)
    path = folder / "part.yaml"
    path.write_text(text, encoding="utf-8")
    # the mean over each pixel, as of a camera
    render_image_set(rig, load_part(path), folder / "images", options=replace(OPTIONS, supersample=3))
    images = read_image_set(folder / "images")
    result = inspect_set(rig, load_part(path), images, options=InspectOptions(fusion=None, register=False))
    assert result.defects == ()
    diffuse = np.stack([read_exr(images.path(e.exr))["diffuse.Y"] for e in images.images])
    return result.postures[0].view, diffuse


@pytest.mark.slow
@pytest.mark.parametrize("fusion", FUSIONS)
def test_former_highlights_differ_from_what_is_around_by_less_than_the_uncertainty(good_part_seen, fusion):
    view, diffuse = good_part_seen
    weights = pixel_weights(view.saturated, view.predicted, view.specular, view.deviation, view.limit)
    image = fuse_images(
        view.level, view.deviation, weights, view.clean, fusion=fusion, predicted=view.predicted,
        specular=view.specular,
    )  # fmt: skip
    # against the same images without highlights and without noise
    lit = (diffuse >= 3.0 * view.deviation).astype(np.float32)
    plain = fuse_images(diffuse, view.deviation, lit, view.clean, fusion=fusion, probes=0)
    off = image.level - plain.level
    full = ndimage.binary_dilation(view.saturated.any(axis=0), iterations=2) & view.clean
    pieces, count = ndimage.label(full)
    reported = 0
    for piece in range(1, count + 1):
        inside = (pieces == piece) & ~image.filled
        ring = ndimage.binary_dilation(pieces == piece, iterations=6) & view.clean & ~full
        if min(inside.sum(), ring.sum()) < 60:
            continue
        reported += 1
        step = abs(off[inside].mean() - off[ring].mean())
        assert step < image.deviation[inside].mean()
    assert reported >= 1
