"""Lights chosen from rendered samples, and images of several lights predicted from captured images of single ones."""

from __future__ import annotations

import itertools
import json
import math
import re
from pathlib import Path

import pytest

from lightopt.design import FromImagesOptions, optimize_from_images
from lightopt.design.from_images._choice import score
from lightopt.design.from_images._samples import ChosenImage, compare_captured, read_samples
from lightopt.images import read_image_set
from lightopt.rendering import RenderOptions, render_image_set

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
PROGRAMME = """
programme:
  - {name: three, lights: {ring-1: 1, ring-2: 0.5, ring-4: 0.75}, exposures: [0.4]}
  - {name: all-on, lights: {ring-1: 1, ring-2: 1, ring-3: 1, ring-4: 1}, exposures: [0.25]}
"""


def small_rig(folder: Path, name: str, **changes: str) -> Path:
    text = (CONFIGS / "rigs" / f"{name}.yaml").read_text(encoding="utf-8")
    text = text.replace("[640, 480]", "[96, 72]").replace("pixel_size_um: 11\n", "pixel_size_um: 73\n")
    for old, new in changes.items():
        text, count = re.subn(rf"{old}: [^,}}\n]+", f"{old}: {new}", text)
        assert count, old
    path = folder / f"{name}.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def one_posture(folder: Path) -> Path:
    text = (CONFIGS / "parts" / "cover-knob.yaml").read_text(encoding="utf-8")
    text = re.sub(r"  - \{elevation_deg: 0, rotation_deg: (82|180|278)\}\n", "", text)
    path = folder / "part.yaml"
    stl = (CONFIGS / "parts" / "cover-knob.stl").as_posix()
    path.write_text(text.replace("file: cover-knob.step", f"file: {stl}"), encoding="utf-8")
    return path


@pytest.mark.slow
def test_rendered_samples_need_no_masks_and_the_choice_is_the_best_of_all(tmp_path, cli):
    rig, part, bad = small_rig(tmp_path, "led-array"), one_posture(tmp_path), tmp_path / "bad.yaml"
    assert cli("defects", rig, part, "--seed", 3, "--count", 7, "-o", bad).status == 0
    sets = [tmp_path / f"good-{i}" for i in range(4)]
    for seed, target in enumerate(sets):
        render_image_set(rig, part, target, options=RenderOptions(noise=seed, exposures=(2.0,), patch_budget=100))
    shown = tmp_path / "shown"
    render_image_set(rig, bad, shown, options=RenderOptions(noise=9, exposures=(2.0,), patch_budget=100))
    for images in (1, 3):
        result = optimize_from_images([*sets, shown], options=FromImagesOptions(images=images))
        assert {name for name, _ in result.evidence.defects} == {"shown"}
        every = itertools.combinations(range(8), images)
        best = max(score(result.evidence.gains(list(choice))) for choice in every)
        assert result.choice.proven
        assert result.choice.score == pytest.approx(best, abs=1e-12)
        assert best > 0.1
        assert result.mixture.single_score <= result.mixture.score <= result.mixture.bound


@pytest.mark.slow
@pytest.mark.parametrize(
    ("read_noise", "electrons", "frames"), [("0.1", "100000", 1), ("0.8", "60", 1), ("0.8", "60", 4)]
)
def test_images_of_single_lights_predict_those_of_several(tmp_path, cli, read_noise, electrons, frames):
    sensor = {"read_noise_levels": read_noise, "electrons_per_level": electrons, "black_level": "12"}
    rig, part = small_rig(tmp_path, "ring-quadrants", **sensor), one_posture(tmp_path)
    mixed = tmp_path / "mixed.yaml"
    mixed.write_text(rig.read_text(encoding="utf-8") + PROGRAMME, encoding="utf-8")
    assert cli("capture", rig, part, "-o", tmp_path / "single", "--average", frames).status == 0
    assert cli("capture", mixed, part, "-o", tmp_path / "several", "--average", frames).status == 0
    images = [
        ChosenImage(name="three", weights={"ring-1": 1.0, "ring-2": 0.5, "ring-4": 0.75}, exposure=0.4),
        ChosenImage(name="all-on", weights={f"ring-{i}": 1.0 for i in range(1, 5)}, exposure=0.25),
    ]
    samples = read_samples([tmp_path / "single"])
    # a mean of frames is rounded to whole levels once more
    rounding = 1.0 / 12.0 / frames + (1.0 / 12.0 if frames > 1 else 0.0)
    variance = float(read_noise) ** 2 / frames + rounding, 1.0 / float(electrons) / frames
    name, found = compare_captured(samples, images, read_image_set(tmp_path / "several"), variance)
    assert name == "single"
    assert [one.image for one in found] == ["three", "all-on"]
    for one in found:
        assert one.pixels > 500
        # of one frame of an ordinary sensor, the noise of the images alone exceeds 1 level
        assert one.rms < 1.0 or one.noise > 1.0, one
        beyond = math.sqrt(max(0.0, one.rms**2 - one.noise**2))
        assert beyond < 0.25, one
        assert one.means_rms < 0.3, one


@pytest.mark.slow
def test_the_loop_from_samples_to_captured_images_of_the_programme(tmp_path, cli):
    rig, part = small_rig(tmp_path, "ring-quadrants"), one_posture(tmp_path)
    single, chosen, taken = tmp_path / "single", tmp_path / "chosen", tmp_path / "taken"
    assert cli("capture", rig, part, "-o", single).status == 0
    command = ("optimize", "--from-images", single, "-k", 2, "--mix", "--rig", rig, "--no-report")
    ran = cli(*command, "-o", chosen)
    assert ran.status == 0, ran.err
    assert "no defective sample" in ran.err
    assert cli("capture", chosen / "rig.optimized.yaml", part, "-o", taken).status == 0
    ran = cli(*command, "--compare", taken, "-o", tmp_path / "compared")
    assert ran.status == 0, ran.err
    assert "2 captured images against images synthesised from single" in ran.out
    compared = json.loads((tmp_path / "compared" / "result.json").read_text(encoding="utf-8"))["compared"]
    assert all(one["means_rms"] < 1.0 for one in compared["images"])
