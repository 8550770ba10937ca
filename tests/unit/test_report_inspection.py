"""The blocks of an inspection's report: what is said of the truth, and the balls on the part."""

from __future__ import annotations

import io
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from lightopt.config import InspectionConfig
from lightopt.core.transforms import Posture
from lightopt.inspection import KIND_COLOURS, BatchRow, FoundDefect, SetEvaluation, Verdict, grey_picture, summarise
from lightopt.inspection.detection._defects import Detection
from lightopt.inspection.evaluation._evaluation import KnownDefect
from lightopt.report._page import Facts, Note, Picture, Table
from lightopt.report.inspection import batch_report
from lightopt.report.inspection._pictures import LABEL_COLOURS, _ball, overlay_image
from lightopt.report.inspection._report import truth_blocks


def true_set(sizes, found):
    defects = tuple(
        KnownDefect(
            name=f"d{i}", kind=("dent", "stain")[i % 2], size=size, pixels=20, posture=Posture(0.0, 0.0), found=hit
        )
        for i, (size, hit) in enumerate(zip(sizes, found, strict=True))
    )
    return SetEvaluation(defects=defects, hidden=("behind",), false_alarms=3, postures=2, areas=(0.9, 0.92))


def test_the_truth_is_reported_with_curves_where_hits_and_misses_give_them():
    rng = np.random.default_rng(2)
    sizes = rng.uniform(0.2, 3.0, 60)
    found = rng.random(60) < 1.0 / (1.0 + np.exp(-4.0 * np.log(sizes / 0.8)))
    blocks = truth_blocks(summarise([true_set(sizes.tolist(), found.tolist())]))
    facts, recall, curves, chart = blocks
    assert isinstance(facts, Facts)
    assert dict(facts.rows) == {
        "found": f"{found.sum()} of 60 defects in view",
        "missed": "; ".join(f"d{i} ({('dent', 'stain')[i % 2]}, {sizes[i]:.2g} mm)" for i in np.flatnonzero(~found)),
        "without an evaluable pixel": "behind: out of view, at an edge, or narrower than a pixel",
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
    nothing = summarise([SetEvaluation(defects=(), hidden=(), false_alarms=0, postures=1, areas=())])
    assert isinstance(truth_blocks(nothing)[-1], Note)
    assert ("area under the pixels' ROC", "-") in truth_blocks(nothing)[0].rows


def detection(kind, box, *, score=10.0, rotation=0.0):
    return Detection(
        posture=Posture(0.0, rotation), pixels=4, centre_px=(1.0, 1.0), box_px=box, position=(0.0, 0.0, 0.0),
        normal=(0.0, 0.0, 1.0), size=(1.0, 1.0), area=1.0, score=score, contrast={}, kind=kind, points=np.zeros((1, 3)),
    )  # fmt: skip


def posture_of(level, boxes):
    """What the pictures look at: a part that fills the image, with defects at boxes of kinds."""
    detections = tuple(detection(kind, box) for kind, box in boxes)
    labels = np.zeros(level.shape, np.int32)
    for i, (_, (left, top, right, bottom)) in enumerate(boxes, start=1):
        labels[top:bottom, left:right] = i
    image = SimpleNamespace(level=level.astype(np.float32), mask=np.ones(level.shape, bool))
    return SimpleNamespace(synthetic=image, labels=labels, detections=detections)


def region_pixels(picture, colour):
    return np.argwhere((np.asarray(picture) == colour).all(axis=2))


@pytest.mark.parametrize("enlarge", [1, 5])
def test_marks_have_the_colour_of_the_defect_and_numbers_stay_inside(enlarge):
    corners = [(0, 0, 6, 6), (154, 0, 160, 6), (0, 114, 6, 120), (154, 114, 160, 120)]
    posture = posture_of(np.full((120, 160), 50.0), [("unknown", box) for box in corners])
    defects = [
        FoundDefect(number=100 + i, detections=(detection("stain", (0, 0, 1, 1), score=90.0, rotation=9.0), one))
        for i, one in enumerate(posture.detections)
    ]
    picture, _ = overlay_image(posture, defects, enlarge=enlarge)
    assert picture.size == (160 * enlarge, 120 * enlarge)
    assert not len(region_pixels(picture, KIND_COLOURS["unknown"]))
    assert len(region_pixels(picture, KIND_COLOURS["stain"])) > 30
    places = region_pixels(picture, LABEL_COLOURS["stain"])
    height, width = 120 * enlarge, 160 * enlarge
    for y in (places[:, 0] < height / 2, places[:, 0] >= height / 2):
        for x in (places[:, 1] < width / 2, places[:, 1] >= width / 2):
            corner = places[x & y]
            assert len(corner) > 10
            assert corner.min() > 0
            assert corner[:, 0].max() < height - 1
            assert corner[:, 1].max() < width - 1
            # three digits, whole
            assert np.ptp(corner[:, 1]) > 1.5 * np.ptp(corner[:, 0])
    for colour in LABEL_COLOURS.values():
        assert min(colour) >= 70
        assert np.dot(colour, (0.2126, 0.7152, 0.0722)) > 140  # on black


def test_a_dark_field_is_stretched_until_the_part_shows():
    level = np.full((40, 40), 0.4)
    level[:2, :4] = 200.0
    picture, shown = overlay_image(posture_of(level, []), [])
    assert 50 < np.asarray(picture)[20, 20, 0] < 80
    assert "white: 200 grey levels; stretched by a power of 0." in shown.legend
    level = np.linspace(0.0, 10.0, 1600).reshape(40, 40)
    picture, shown = overlay_image(posture_of(level, []), [])
    assert shown.legend.startswith("white: 9.9")
    assert "stretched" not in shown.legend
    assert abs(int(np.asarray(picture)[20, 20, 0]) - 128) <= 3
    below = posture_of(level - 5.0, [])
    below.synthetic.mask[:, :5] = False
    picture, shown = overlay_image(below, [])
    assert shown.legend.startswith("black: -4.")
    assert np.asarray(picture)[20, 20, 0] > 100
    assert not np.asarray(picture)[:, :5].any()


@pytest.mark.parametrize("width", [640, 1600, 2448])
def test_numbers_are_read_on_wide_pictures_as_on_small_ones(width):
    posture = posture_of(np.full((60, width), 50.0), [("stain", (300, 20, 306, 26))])
    defects = [FoundDefect(number=88, detections=posture.detections)]
    halo = region_pixels(overlay_image(posture, defects)[0], (0, 0, 0))
    # as the page shows it, 896 px wide
    assert np.ptp(halo[:, 0]) * 896 / width > 12.0


def test_the_synthetic_png_of_a_dark_part_shows_it_and_says_how(tmp_path):
    level = np.full((40, 40), 0.4, np.float32)
    level[:2, :4] = 200.0
    shown = grey_picture(level, np.ones(level.shape, bool))
    assert shown.grey[20, 20] > 50
    reported = shown.as_dict()
    assert reported["power"] < 1.0
    share = (level[20, 20] - reported["black_level"]) / (reported["white_level"] - reported["black_level"])
    assert 255.0 * share ** reported["power"] == pytest.approx(shown.grey[20, 20], abs=0.51)
    even = grey_picture(100.0 * level, level < 1.0).as_dict()
    assert even == {"black_level": 0.0, "white_level": 40.0, "power": 1.0}


def test_rows_of_a_batch_lead_to_reports_whatever_their_names():
    verdict = Verdict(
        good=True, counting=(1,), inspected=0.7, reasons=(), finds=0.25, limits=InspectionConfig(most_defects=2)
    )
    rows = [
        BatchRow(name="a #1 <&>", report="a #1 <&>/report.html", defects=1, verdict=verdict),
        BatchRow(name="b", defects=1, verdict=verdict),
    ]
    page = batch_report(rows, part="p", rig="r", version="1", truth=None)
    assert '<a href="a%20%231%20%3C%26%3E/report.html">a #1 &lt;&amp;&gt;</a>' in page
    assert "<td>b</td><td>OK</td><td>1 defect that counts, 2 allowed</td>" in page
    assert "<td class=number>70.0\u00a0%</td><td class=number>25.0\u00a0%</td>" in page
    heads, last_row = page.index("<thead>"), page.index("<td>b</td>")
    assert page.count("</th>", heads, last_row) == page.count("</td>", last_row, page.index("</tbody>", last_row)) == 8


def test_a_ball_is_closed_and_faces_outwards():
    points, faces = _ball()
    assert np.allclose(np.linalg.norm(points, axis=1), 1.0)
    a, b, c = (points[faces[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0
    assert volume == pytest.approx(4.19, rel=0.15)
    assert np.all(np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) >= -1e-12)
