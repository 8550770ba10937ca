"""Shape or stain: by what lights show of it, in numbers and on a rendered part."""

from __future__ import annotations

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

from lightopt import load_part, load_rig
from lightopt.core.transforms import Posture
from lightopt.images import read_image_set
from lightopt.inspection import InspectOptions, inspect_set
from lightopt.inspection.detection._regions import _kind
from lightopt.rendering import RenderOptions, render_image_set

LEVEL = 50.0


def kind(*lights):
    """Of a region of 40 pixels: of each light what is brighter and darker [standard deviations], and whether it is lit
    by a highlight; the level changes by the larger of both."""
    n = len(lights)
    z = np.zeros((3, n, 40), np.float32)
    share = np.array([0.01 * (up if up > down else -down) for up, down, _ in lights], np.float32)
    for i, (up, down, _) in enumerate(lights):
        z[0, i, :20], z[0, i, 20:] = up, -down
    row, column = np.zeros(40, np.intp), np.arange(40)
    predicted = np.full((n, 1, 40), LEVEL, np.float32)
    highlight = np.array([lit for _, _, lit in lights])
    view = SimpleNamespace(
        lights=[f"light{i}" for i in range(n)],
        predicted=predicted,
        level=predicted * (1.0 + share[:, None, None]),
        specular=predicted * highlight[:, None, None],
        saturated=predicted < 0.0,
    )
    contrast = {f"light{i}": float(share[i]) for i, (up, down, _) in enumerate(lights) if max(up, down) >= 4.0}
    return _kind(z, row, column, view, contrast)


@pytest.mark.parametrize(
    ("lights", "expected"),
    [
        # both walls of a dent, in diffuse light
        ([(6, 7, False), (7, 6, False), (1, 1, False)], "shape"),
        # a glint beside which a small share is what another wall loses, which no noise does
        ([(200, 0, False), (0, 9, False), (1, 1, False)], "shape"),
        # a loss in a highlight, and both walls in two images of diffuse light
        ([(0, 160, True), (5, 5.5, False), (5, 4.5, False)], "shape"),
        ([(0, 30, False), (0, 32, False), (0, 29, False), (0, 30, False)], "stain"),
        ([(0, 30, False), (0, 32, False), (0, 150, True), (2, 30, False)], "stain"),
        # one glint, as that of a haze, a hair or a dent; and lights that contradict a stain
        ([(200, 0, False), (2, 2, False), (1, 3, False)], "unknown"),
        ([(0, 150, True), (5, 0, False), (5, 0, False)], "unknown"),
        ([(0, 30, False), (0, 12, False), (0, 29, False)], "unknown"),
        ([(2, 2, False), (3, 1, False)], "unknown"),
    ],
)
def test_the_kind_is_that_of_what_the_lights_show(lights, expected):
    assert kind(*lights) == expected


PLACES = ((58, 60), (92, 72), (88, 38), (60, 40), (100, 54), (74, 84))
KINDS = (
    *("stain, size_mm: 3, R_d_factor: 0.8", "dent, size_mm: 5, slope_deg: 8"),
    *("dent, size_mm: 4, slope_deg: 15", "stain, size_mm: 4, R_d_factor: 0.6"),
    *("bump, size_mm: 4, slope_deg: 12", "stain, size_mm: [5, 2], R_d_factor: 0.5"),
)


@pytest.mark.slow
def test_rendered_dents_are_shapes_and_stains_are_stains(bench):
    lights = "".join(
        f"  - {{name: light{i + 1}, distance_mm: 330, elevation_deg: 60, azimuth_deg: {45 + 90 * i}}}\n"
        for i in range(4)
    )
    rig = bench.rig.read_text(encoding="utf-8")
    bench.rig.write_text(re.sub(r"lights:\n(  - .*\n)+", f"lights:\n{lights}", rig), encoding="utf-8")
    flat = "posture: {elevation_deg: 0, rotation_deg: 0}"
    strewn = "".join(
        f"  - {{name: d{i}, at_pixel: {{{flat}, pixel: [{x}, {y}]}}, kind: {kind}}}\n"
        for i, ((x, y), kind) in enumerate(zip(PLACES, KINDS, strict=True))
    )
    bad = bench.part.with_name("bad.yaml")
    bad.write_text(bench.part.read_text(encoding="utf-8") + f"defects:\n{strewn}", encoding="utf-8")
    options = RenderOptions(noise=7, postures=(Posture(0.0, 0.0),), patch_budget=500)
    images = bench.folder / "bad"
    render_image_set(load_rig(bench.rig), load_part(bad), images, options=options)
    found = inspect_set(
        load_rig(bench.rig),
        load_part(bench.part),
        read_image_set(images),
        options=InspectOptions(fusion=None, register=False),
    )
    reported = []
    for one in read_image_set(images).manifest.extra["defects"]:
        near = [d for d in found.defects if math.dist(d.best.position, one["position_mm"]) < 2.0]
        assert near, one["name"]
        reported.append((one["kind"], near[0].best.kind))
    wrong = [pair for pair in reported if pair[1] not in ("unknown", "stain" if pair[0] == "stain" else "shape")]
    assert not wrong
    assert sum(answer == "unknown" for _, answer in reported) <= 1
