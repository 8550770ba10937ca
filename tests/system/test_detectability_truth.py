"""What detectability predicts is what a plain contrast test counts on noisy renders.

The catalogue pixel by pixel, and each kind and strewn pits by nine pixels, within 5 points.
"""

from __future__ import annotations

from pathlib import Path

import pytest
import truth
from truth import SEEN_IN, compare, plot, table
from truth_case import Case

from lightopt import load_part, load_rig

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


@pytest.fixture
def small_rig(tmp_path):
    """The four panels with a camera of a sixteenth of the pixels."""
    text = (CONFIGS / "rigs" / "four-panel.yaml").read_text(encoding="utf-8")
    text = text.replace("[1600, 1200]", "[400, 300]").replace("pixel_size_um: 4.4 ", "pixel_size_um: 17.6 ")
    (tmp_path / "rig.yaml").write_text(text, encoding="utf-8")
    return load_rig(tmp_path / "rig.yaml")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "finishes", "patches", "pits"),
    [
        ("cover-knob", ("glossy",), 2_000, 0),  # pits in every run are those of test_random_defects_counted.py
        pytest.param("cover-knob", ("glossy", "satin"), 4_000, 24, marks=pytest.mark.nightly),
        pytest.param("spout", ("glossy", "satin"), 4_000, 24, marks=pytest.mark.nightly),
    ],
)
def test_predicted_shares_are_the_counted_ones(small_rig, part, finishes, patches, pits, tmp_path, monkeypatch):
    monkeypatch.setattr(truth, "FINISHES", {name: truth.FINISHES[name] for name in finishes})
    # as many pixels wide as pits of 1.5 mm under the whole camera
    monkeypatch.setattr("truth_pits.WIDTH_MM", 6.0)
    file = CONFIGS / "parts" / f"{part}.yaml"
    points = list(compare(small_rig, load_part(file), patches=patches, pits=pits))
    assert {(p.finish, p.min_images) for p in points} == {(f, k) for f in finishes for k in SEEN_IN}
    whole = [p for p in points if not p.kind.startswith("pits")]
    assert len(whole) == len(finishes) * 2 * 2 * 8
    for p in whole:
        if p.kind == "all" or p.pixels > 1:
            assert abs(p.predicted - p.measured) < 0.05, p
    strewn = [p for p in points if p.kind.startswith("pits")]
    assert len(strewn) == (len(finishes) * 2 * 2 * 2 if pits else 0)
    for p in strewn:
        # noise takes single pixels across the threshold
        assert abs(p.predicted - p.measured) < (0.05 if p.pixels > 1 else 0.1), p
    # something is seen and something is not
    assert min(p.measured for p in whole) < 0.1
    assert max(p.measured for p in whole) > 0.5
    assert table(points).count("the catalogue") == 4 * len(finishes)
    plot(points, tmp_path / "truth.png")
    assert (tmp_path / "truth.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_wrong_prediction_is_found_out(small_rig, monkeypatch):
    """The comparison can fail: with a quarter of the threshold in the prediction only, shares are off."""

    def too_sure(case, trials, own=Case.predict):
        from dataclasses import replace

        quarter = replace(case.contrast, threshold=0.25 * case.contrast.threshold)
        return own(replace(case, contrast=quarter), trials)

    monkeypatch.setattr(Case, "predict", too_sure)
    monkeypatch.setattr(truth, "FINISHES", {"glossy": {}})
    monkeypatch.setattr("truth_walls.EVERY", 5)
    points = list(truth.compare(small_rig, load_part(CONFIGS / "parts" / "cover-knob.yaml"), patches=2000, pits=0))
    assert max(p.predicted - p.measured for p in points) > 0.05
