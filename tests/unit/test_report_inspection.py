"""The blocks of an inspection's report: what is said of the truth, and the balls on the part."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from lightopt.inspection import KnownDefect, TrueSet, summarise
from lightopt.report._inspection_surface import _ball
from lightopt.report._page import Facts, Note, Picture, Table
from lightopt.report._truth_blocks import truth_blocks


def true_set(sizes, found):
    defects = tuple(
        KnownDefect(name=f"d{i}", kind=("dent", "stain")[i % 2], size=size, pixels=20, found=hit)
        for i, (size, hit) in enumerate(zip(sizes, found, strict=True))
    )
    return TrueSet(defects=defects, hidden=("behind",), false_alarms=3, postures=2, areas=(0.9, 0.92))


def test_the_truth_is_told_with_curves_where_hits_and_misses_tell_them():
    rng = np.random.default_rng(2)
    sizes = rng.uniform(0.2, 3.0, 60)
    found = rng.random(60) < 1.0 / (1.0 + np.exp(-4.0 * np.log(sizes / 0.8)))
    blocks = truth_blocks(summarise([true_set(sizes.tolist(), found.tolist())]))
    facts, recall, curves, chart = blocks
    assert isinstance(facts, Facts)
    assert dict(facts.rows) == {
        "found": f"{found.sum()} of 60 defects in view",
        "out of view": "behind",
        "false alarms": "1.5 per posture",
        "area under the pixels' ROC": "0.9100",
    }
    assert isinstance(recall, Table)
    assert sum(int(row[2]) for row in recall.rows) == 60
    assert sum(int(row[3]) for row in recall.rows) == found.sum()
    assert isinstance(curves, Table)
    assert [row[0] for row in curves.rows] == ["all", "dent", "stain"]
    assert 0.8 < float(curves.rows[0][3]) < float(curves.rows[0][4])
    assert isinstance(chart, Picture)
    assert "all, dent, stain" in chart.alt
    pixels = np.asarray(Image.open(io.BytesIO(chart.png)).convert("RGB"))
    for colour in ((213, 94, 0), (0, 158, 115), (204, 121, 167)):
        assert np.count_nonzero((pixels == colour).all(axis=2)) > 200


def test_what_few_defects_do_not_tell_is_said():
    summary = summarise([true_set([1.0, 2.0], [True, True])])
    assert isinstance(truth_blocks(summary)[-1], Note)
    nothing = summarise([TrueSet(defects=(), hidden=(), false_alarms=0, postures=1, areas=())])
    assert isinstance(truth_blocks(nothing)[-1], Note)
    assert ("area under the pixels' ROC", "-") in truth_blocks(nothing)[0].rows


def test_a_ball_is_closed_and_faces_outwards():
    points, faces = _ball()
    assert np.allclose(np.linalg.norm(points, axis=1), 1.0)
    a, b, c = (points[faces[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0
    assert volume == pytest.approx(4.19, rel=0.15)
    assert np.all(np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) >= -1e-12)
