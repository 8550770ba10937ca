"""Random defects counted on noisy images: narrow ones as often as predicted, and the benefit of the best lights."""

from __future__ import annotations

from pathlib import Path

import benefit
import narrow
import numpy as np
import pytest

from lightopt import load_part, load_rig
from lightopt.defects import PIXEL_RATIOS

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


@pytest.fixture
def small_rig(tmp_path):
    """The four panels with a camera of a sixteenth of the pixels."""
    text = (CONFIGS / "rigs" / "four-panel.yaml").read_text(encoding="utf-8")
    text = text.replace("[1600, 1200]", "[400, 300]").replace("pixel_size_um: 4.4 ", "pixel_size_um: 17.6 ")
    (tmp_path / "rig.yaml").write_text(text, encoding="utf-8")
    return load_rig(tmp_path / "rig.yaml")


@pytest.fixture
def knob():
    return load_part(CONFIGS / "parts" / "cover-knob.yaml")


@pytest.mark.slow
def test_narrow_pits_and_scratches_are_counted_as_often_as_predicted(small_rig, knob, monkeypatch):
    monkeypatch.setattr(narrow, "CASES", (("pit", 20.0, (1.0,)), ("scratch", 4.0, (1.0,))))
    rows = list(narrow.compare(small_rig, knob, patches=5000, count=60))
    assert len(rows) == 2 * 2 * 2
    differences = [abs(row.predicted - row.measured) for row in rows]
    # of 60 defects one is 1.7 points, and the standard error some 6
    assert np.mean(differences) < 0.06
    assert max(differences) < 0.2
    assert max(row.measured for row in rows) > 0.5
    assert narrow.table_of(rows).count("cover-knob") == 4


@pytest.mark.nightly
def test_one_wall_over_the_whole_width_is_found_out(small_rig, knob, monkeypatch):
    """The comparison can fail: it does where a pixel is taken to see no second wall."""
    whole = np.minimum(1.0, 1.0 / PIXEL_RATIOS)[:, None] ** 2 * np.ones(4)
    monkeypatch.setattr("lightopt.design.responses._detection.pixel_shares", lambda _shape: whole)
    monkeypatch.setattr(narrow, "CASES", (("pit", 20.0, (1.0,)),))
    rows = list(narrow.compare(small_rig, knob, patches=5000, count=60))
    assert max(row.predicted - row.measured for row in rows) > 0.15


@pytest.mark.nightly
def test_sets_of_lights_are_counted_beside_what_is_predicted_of_them(small_rig, knob, monkeypatch):
    monkeypatch.setattr("benefit_sets.FINISHES", {"glossy": {}})
    rows = list(benefit.sets(small_rig, knob, patches=3000, defects=28, step=15.0))
    assert [(row.min_images, row.what) for row in rows] == [
        (k, what) for k in (1, 2) for what in ("detectability", "paper")
    ]
    for own, paper in zip(rows[::2], rows[1::2], strict=True):
        assert own.share >= paper.share
    for row in rows:
        assert 0 < row.counted <= row.defects
        assert abs(row.counted - row.predicted) <= 0.25 * row.defects
    assert rows[0].counted > rows[2].counted
    assert benefit.table(rows).count("cover-knob") == 4


@pytest.mark.nightly
def test_plans_are_counted_with_shorter_and_longer_exposures(small_rig, knob, monkeypatch):
    for name, value in {"STEP": 30.0, "POSTURES": 1, "POSTURE_STEP": 180.0, "SEEN_IN": (1,)}.items():
        monkeypatch.setattr(f"benefit_plans.{name}", value)
    monkeypatch.setattr("benefit_plans.OFFERED", {1.0: "1", 16.0: "16"})
    own, own_more, chosen, chosen_more = benefit.plans(small_rig, knob, finish="glossy", patches=2000, defects=28)
    assert (own.what, chosen.what) == ("the part's own 1", "1 chosen")
    assert own_more.what == "the part's own 1, 1 further exposure (1 × 16)"
    # postures are chosen from more, and exposures come on top
    assert own.share < own_more.share <= chosen_more.share
    assert own.share <= chosen.share < chosen_more.share
    assert own.counted < own_more.counted
    for row in (own, own_more, chosen, chosen_more):
        assert abs(row.counted - row.predicted) <= 0.25 * row.defects
