"""Dark field: a polished cap of a sphere under a low ring, whose images are black but for defects.

Such images cannot say where the part is, which is no reason to refuse them: the part is taken to lie where its file has
it, and a scratch is found. They are refused where the part's file predicts light.
"""

import math

import numpy as np
import pytest
import trimesh

from lightopt import load_part, load_rig
from lightopt.comparison import preset_files
from lightopt.core.errors import InputError
from lightopt.images import read_image_set
from lightopt.inspection import InspectOptions, inspect_set
from lightopt.rendering import RenderOptions, render_image_set

PART = """\
format: lightopt-part/1
name: cap
mesh: {file: cap.stl, units: mm}
placement: {anchor: rest_on_table}
reflectance: {R_d: 1, R_s: 12500, sigma_rad: 0.0475}
postures: [{elevation_deg: 0, rotation_deg: 0}]
defect_catalogue:
  - {name: scratch, kind: scratch, size_mm: [6, 1], slope_deg: 35}
"""
SCRATCH = """\
defects:
  - {name: scratch, kind: scratch, at_mm: [6, 4, 60], size_mm: [6, 1], slope_deg: 35}
"""


@pytest.fixture
def dark(bench):
    """The rig under its low ring, the cap's file, and a function that renders a cap, with or without a scratch."""
    angles = np.radians(np.linspace(-90.0, -68.5, 65))
    curve = 60.0 * np.stack([np.cos(angles), -np.sin(angles)], axis=1)
    bottom = curve[-1, 1] - 2.0
    outline = np.concatenate([[[0.0, bottom], [curve[-1, 0], bottom]], curve[::-1]])
    trimesh.creation.revolve(outline, sections=128).export(bench.folder / "cap.stl")
    (rig,) = map(load_rig, preset_files(["low-ring"], bench.folder / "presets", camera_of=load_rig(bench.rig)))
    path = bench.folder / "cap.yaml"

    def render(defects=""):
        path.write_text(PART + defects, encoding="utf-8")
        render_image_set(rig, load_part(path), bench.out, options=RenderOptions(noise=3, patch_budget=500))
        path.write_text(PART, encoding="utf-8")
        return read_image_set(bench.out)

    return rig, path, render


def test_a_scratch_is_found_in_images_that_are_black_as_predicted(dark):
    rig, path, render = dark
    images = render(SCRATCH)
    result = inspect_set(rig, load_part(path), images, options=InspectOptions(fusion=None, min_images=1))
    assert result.registration is None
    assert result.placement is None
    assert any("predicted to be black" in text for text in result.warnings)
    (found,) = result.defects
    assert math.dist(found.best.position[:2], (6.0, 4.0)) < 1.0


def test_black_images_are_refused_where_light_is_predicted(dark):
    rig, path, render = dark
    images = render()
    path.write_text(PART.replace("R_d: 1", "R_d: 250"), encoding="utf-8")
    with pytest.raises(InputError, match="black where the part is expected"):
        inspect_set(rig, load_part(path), images)
