"""Every sample rig is usable as it stands: checked, rendered, captured on simulated devices, inspected."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from lightopt import build_scene, load_part, load_rig, render
from lightopt.preflight import check_scene

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
PART = CONFIGS / "parts" / "cover-knob.yaml"
SYSTEMS = sorted(path.stem for path in (CONFIGS / "rigs").glob("*.yaml") if "kind:" in path.read_text(encoding="utf-8"))
STAIN = """\
defects:
  - name: stain
    kind: stain
    at_pixel: {posture: {elevation_deg: 0, rotation_deg: 0}, pixel: [62, 52]}
    size_mm: 5
    R_d_factor: 0.6
"""


def small(name: str, folder: Path, *, side: int = 1) -> Path:
    """The sample rig with 128 × 96 pixels of the same view, or with fewer, so many times as long."""
    text = (CONFIGS / "rigs" / f"{name}.yaml").read_text(encoding="utf-8")
    text, count = re.subn(r"resolution_px: \[640, 480\]", f"resolution_px: [{128 // side}, {96 // side}]", text)
    assert count == 1
    path = folder / f"{name}.yaml"
    path.write_text(text.replace("pixel_size_um: 11\n", f"pixel_size_um: {55 * side}\n"), encoding="utf-8")
    return path


def one_posture(folder: Path, defects: str = "") -> Path:
    text = PART.read_text(encoding="utf-8").replace("file: cover-knob.step", f"file: {PART.parent / 'cover-knob.step'}")
    text = re.sub(r"  - \{elevation_deg: 0, rotation_deg: (82|180|278)\}\n", "", text)
    path = folder / f"part{len(defects)}.yaml"
    path.write_text(text + defects, encoding="utf-8")
    return path


def test_the_systems_are_there():
    assert {"display-stripes", "spot", "led-array", "dome-quadrants", "ring-quadrants"} <= set(SYSTEMS)
    assert {"coaxial", "low-angle-ring", "flat-dome", "tunnel", "bars"} <= set(SYSTEMS)
    assert {"binary-stripes", "moving-grid", "dome-stripes", "silhouette"} <= set(SYSTEMS)


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_sample_rig_is_checked_and_rendered(name, tmp_path):
    rig, part = load_rig(small(name, tmp_path, side=2)), load_part(one_posture(tmp_path))
    found = check_scene(rig, part)
    # images a tenth as large show stripes that are a tenth as wide
    assert [f.text for f in found.findings if f.level in ("warning", "error") and f.topic != "stripes"] == []
    bright = [f for f in found.findings if f.topic == "bright field"]
    assert len(bright) == len({light.entry for light in rig.lights})
    (images,) = render(build_scene(rig, part))
    assert len(images.lights) == len(rig.lights)
    for light in images.lights:
        shown = ~images.geometry.hit if name == "silhouette" else images.geometry.hit
        assert np.median(light.level[shown]) > 0.5


@pytest.mark.slow
@pytest.mark.usefixtures("few_pixels_for_the_rest")
@pytest.mark.parametrize("name", ["dome-quadrants", "display-stripes"])
def test_a_stain_is_captured_and_found(name, tmp_path, cli):
    rig, good, stained = small(name, tmp_path), one_posture(tmp_path), one_posture(tmp_path, STAIN)
    captured, out = tmp_path / "captured", tmp_path / "inspected"
    ran = cli("capture", rig, stained, "-o", captured)
    assert ran.status == 0, ran.err
    ran = cli("inspect", rig, good, captured, "-o", out, "--detector", "residual", "--no-register", "--no-report")
    assert ran.status == 0, ran.err
    found = json.loads((out / "defects.json").read_text(encoding="utf-8"))
    (defect,) = found["defects"]
    assert defect["sightings"][0]["centre_px"] == pytest.approx([62, 52], abs=1.5)
    assert defect["area_mm2"] == pytest.approx(np.pi * 2.5**2, rel=0.35)
