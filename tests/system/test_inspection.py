"""A part that lies off its place: its defects are found where they are on it, better than without a model."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from scipy import ndimage

from lightopt import load_part, load_rig
from lightopt.images import read_exr, read_image_set
from lightopt.inspection import (
    FUSIONS,
    InspectOptions,
    Predictions,
    SyntheticImage,
    area_under_roc,
    fuse_images,
    inspect_set,
    score_templates,
    trust_weights,
)
from lightopt.rendering import RenderOptions, render_image_set
from lightopt.transforms import Posture

FLAT = "posture: {elevation_deg: 0, rotation_deg: 0}"
DEFECTS = f"""\
defects:
  - {{name: stain, kind: stain, at_pixel: {{{FLAT}, pixel: [58, 60]}}, size_mm: 3, R_d_factor: 0.8}}
  - {{name: dent, kind: dent, at_pixel: {{{FLAT}, pixel: [92, 72]}}, size_mm: 5, slope_deg: 8}}
  - {{name: scratch, kind: scratch, at_pixel: {{{FLAT}, pixel: [88, 38]}}, size_mm: [6, 1.2], slope_deg: 8}}
"""
OPTIONS = RenderOptions(noise=7, postures=(Posture(0.0, 0.0),), patch_budget=500, layers=True)


@pytest.fixture(scope="module")
def trial(shared_bench, tmp_path_factory):
    """Rig and part, and image sets of parts 0.4 mm, 0.3 mm and 0.5° off: with defects, and a good one."""
    folder = tmp_path_factory.mktemp("trial")
    text = shared_bench.part.read_text(encoding="utf-8") + DEFECTS
    nominal = "translate_mm: [0, 0, 0]"
    assert nominal in text
    path = shared_bench.part.with_name("off.yaml")
    path.write_text(
        text.replace(nominal, "translate_mm: [0.4, -0.3, 0], rotate_deg: [0, 0, 0.5]"), encoding="utf-8"
    )
    lights = "".join(
        f"  - {{name: light{i + 1}, distance_mm: 330, elevation_deg: 60, azimuth_deg: {45 + 90 * i}}}\n"
        for i in range(4)
    )
    four = shared_bench.rig.with_name("four.yaml")
    text = shared_bench.rig.read_text(encoding="utf-8")
    four.write_text(re.sub(r"lights:\n(  - .*\n)+", f"lights:\n{lights}", text), encoding="utf-8")
    rig = load_rig(four)
    render_image_set(rig, load_part(path), folder / "bad", options=OPTIONS)
    good = RenderOptions(**{**vars(OPTIONS), "defects": False})
    render_image_set(rig, load_part(path), folder / "good", options=good)
    return (
        rig,
        load_part(shared_bench.part),
        read_image_set(folder / "bad"),
        read_image_set(folder / "good"),
    )


@pytest.fixture(scope="module")
def found(trial):
    rig, part, bad, _ = trial
    return inspect_set(rig, part, bad, options=InspectOptions(threads=2))


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
def test_the_default_beats_every_image_alone_and_the_pixelwise_minimum(trial, found):
    posture = found.postures[0]
    view = posture.view
    truth = trial[2].load_geometry(trial[2].geometry[0])["defect"][view.clean] >= 0

    def area(score):
        return area_under_roc(score[view.clean].astype(np.float64), truth)

    seen = np.minimum(view.level, view.limit)
    none = np.zeros(view.clean.shape, bool)
    baselines = [
        area(score_templates(SyntheticImage(level, 0 * level, none, view.clean)))
        for level in (*seen, seen.min(axis=0))
    ]
    assert area(posture.score) > max(baselines)


@pytest.mark.slow
@pytest.mark.parametrize("fusion", FUSIONS)
def test_former_highlights_differ_from_what_is_around_by_less_than_the_uncertainty(trial, fusion):
    rig, part, _, good = trial
    options = InspectOptions(fusion=fusion, threads=2)
    result = inspect_set(rig, part, good, options=options, predictions=Predictions())
    assert result.defects == ()
    view, image = result.postures[0].view, result.postures[0].synthetic
    assert image is not None
    diffuse = np.stack([read_exr(good.path(e.exr))["diffuse.Y"] for e in good.images])
    lit = trust_weights(view.saturated, view.predicted, 0 * view.specular, view.deviation, view.limit)
    plain = fuse_images(
        diffuse, view.deviation, (lit > 0).astype(np.float32), view.clean, fusion=fusion, probes=0
    )
    off = image.level - plain.level
    inside = ndimage.binary_dilation(view.saturated.any(axis=0), iterations=2) & view.clean & ~image.filled
    ring = ndimage.binary_dilation(inside, iterations=6) & view.clean & ~inside
    assert inside.sum() > 100
    step = abs(off[inside].mean() - off[ring].mean())
    assert step < image.deviation[inside].mean()
    before = np.minimum(view.level, view.limit).max(axis=0)
    assert before[inside].mean() - before[ring].mean() > 20 * step
