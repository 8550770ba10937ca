"""Exposures longer than 1, from the plan to the images: planned where they show more, rendered, captured, clipped."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from lightopt.cli._main import run
from lightopt.images import read_exr, read_image_set, read_png

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


@pytest.fixture
def small(tmp_path):
    """The four panels with a camera of 80 × 60 pixels, and the sample knob of two postures."""
    text = (CONFIGS / "rigs" / "four-panel.yaml").read_text(encoding="utf-8")
    text = text.replace("[1600, 1200]", "[80, 60]").replace("pixel_size_um: 4.4 ", "pixel_size_um: 88 ")
    (tmp_path / "rig.yaml").write_text(text, encoding="utf-8")
    knob = CONFIGS / "parts" / "cover-knob.stl"
    text = (CONFIGS / "parts" / "cover-knob.yaml").read_text(encoding="utf-8")
    text = text.replace("file: cover-knob.step", f"file: {knob.as_posix()}")
    (tmp_path / "part.yaml").write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.slow
def test_a_long_exposure_is_planned_and_its_commands_make_its_images(small, monkeypatch):
    monkeypatch.chdir(small)
    plan = "optimize rig.yaml part.yaml -o plan --objective detectability --posture 0,0 --posture 0,82 --step 30"
    words = [*plan.split(), "--exposure", "1,16", "--min-images", "1", "--patches", "1000", "--no-images", "--quiet"]
    assert run(words) == 0
    result = json.loads(Path("plan/result.json").read_text(encoding="utf-8"))
    shots = result["exposures"]["shots"]
    # what is lit at a slant is dark: 16 times as much light lifts its defects above the noise
    assert {shot["exposure"] for shot in shots if shot["planned"]} == {16.0}
    assert result["exposures"]["share"] > result["exposures"]["share_without"] + 0.05
    monkeypatch.chdir("plan")
    for command in result["commands"]:
        words = shlex.split(command)[1:]
        assert run([*words, *(["--patches", "1000"] if words[0] == "render" else []), "--quiet"]) == 0
    rendered, captured = (read_image_set(folder) for folder in ("rendered", "captured"))
    requested = {(e.light, e.posture, e.exposure): e for e in rendered.images}
    assert {exposure for _, _, exposure in requested} == {1.0, 16.0}
    assert {(e.light, e.posture, e.exposure) for e in captured.images} == requested.keys()
    for taken in captured.images:
        made = requested[taken.light, taken.posture, taken.exposure]
        linear = read_exr(rendered.path(made.exr))["Y"].astype(np.float64)
        levels = read_png(rendered.path(made.png))
        np.testing.assert_array_equal(levels, np.minimum(np.floor(made.exposure * linear + 0.5), 255.0))
        # the virtual bench's camera has noise: 0.8 levels of read-out, and 2.1 of photons at full scale
        found = read_png(captured.path(taken.png)).astype(np.float64)
        assert np.abs(found - levels).max() < 6.0 * np.hypot(0.8, 2.1) + 1.0
        # the linear image is from the longest exposure that is not saturated
        channels = read_exr(captured.path(taken.exr))
        if taken.exposure == 16.0:
            assert set(np.unique(channels["exposure"])) == {1.0, 16.0}
            assert (levels == 255).mean() > 0.05
            lit = (linear > 0.0) & (channels["exposure"] == 16.0)
            assert np.abs(channels["Y"][lit] - linear[lit]).max() < 1.0
