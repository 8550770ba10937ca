"""What report pictures are made of: thumbnails, text, views, labels."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from PIL import Image

from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture, direction
from lightopt.design import LegendRow
from lightopt.report._pictures import (
    DPI,
    SATURATED_COLOUR,
    chart,
    check_png_path,
    figure_image,
    fixed_style,
    label_whole_numbers,
    shortened,
    thumbnail,
    write_picture,
)
from lightopt.report._rig_elements import ParallelView, arc
from lightopt.report.design._surface import _with_legend
from lightopt.report.rig import _gallery


@given(st.integers(1, 300), st.integers(1, 300), st.integers(8, 120))
def test_thumbnail_fits_and_keeps_shape_and_mean(width: int, height: int, limit: int) -> None:
    rng = np.random.default_rng(width * 1000 + height)
    level = rng.random((height, width)).astype(np.float32)
    small = thumbnail(level, np.zeros(level.shape, bool), limit=limit)
    rows, columns, _ = small.picture.shape
    longest = max(width, height)
    shrink, enlarge = max(1, math.ceil(longest / limit)), max(1, limit // longest)
    assert (columns, rows) == (math.ceil(width / shrink) * enlarge, math.ceil(height / shrink) * enlarge)
    assert max(rows, columns) <= limit
    assert 2 * max(rows, columns) > limit or max(rows, columns) == 1 or limit > 2 * max(width, height) / 1.0 - 1
    assert small.picture[..., 0].min() >= math.floor(255 * level.min())
    assert small.picture[..., 0].max() <= math.ceil(255 * level.max())


def test_thumbnail_averages_areas() -> None:
    level = np.array([[0.0, 1.0, 0.5], [1.0, 0.0, 0.5], [0.2, 0.2, 0.4]])
    small = thumbnail(level, np.zeros((3, 3), bool), limit=2)
    # the last row and column are averaged over what there is of them
    assert small.picture[..., 1].tolist() == [[128, 128], [51, 102]]


def test_thumbnail_repeats_pixels_of_small_images() -> None:
    small = thumbnail(np.array([[0.0, 1.0]]), np.zeros((1, 2), bool), limit=9)
    assert small.picture.shape == (4, 8, 3)
    assert (small.picture[:, :4] == 0).all()
    assert (small.picture[:, 4:] == 255).all()


def test_thumbnail_clips_what_the_camera_would() -> None:
    level = np.array([[-1.0, np.nan, np.inf, 7.0]])
    assert thumbnail(level, np.zeros((1, 4), bool), limit=4).picture[0, :, 0].tolist() == [0, 0, 255, 255]


def test_one_saturated_pixel_shows_in_its_cell() -> None:
    saturated = np.zeros((80, 80), bool)
    saturated[41, 13] = True
    small = thumbnail(np.zeros((80, 80), np.float32), saturated, limit=8)
    assert (small.saturated, small.pixels) == (1, 6400)
    marked = small.picture[..., 0] > 0
    assert np.argwhere(marked).tolist() == [[4, 1]]
    red, green, blue = (int(v) for v in small.picture[4, 1])
    assert red > 80
    assert red > 2 * max(green, blue)


@given(st.integers(0, 16))
def test_more_saturation_is_redder(count: int) -> None:
    def redness(n: int) -> float:
        saturated = np.zeros(16, bool)
        saturated[:n] = True
        picture = thumbnail(np.full((4, 4), 0.5), saturated.reshape(4, 4), limit=1).picture
        return float(np.abs(picture[0, 0].astype(float) - SATURATED_COLOUR).sum())

    if count:
        assert redness(count) < redness(count - 1)
    if count == 16:
        assert redness(16) == 0


@given(st.text(max_size=40), st.integers(5, 50))
@fixed_style()
def test_any_name_can_be_written_on_a_line(text: str, most: int) -> None:
    from matplotlib.figure import Figure

    name = shortened(text, most)
    assert len(name) <= most
    assert name.isprintable()
    figure = Figure(figsize=(60 / DPI, 60 / DPI), dpi=DPI)
    figure.text(0.1, 0.5, name, fontsize=16)
    picture = np.asarray(figure_image(figure))
    assert picture[:8].min() == picture[52:].min() == 255


def test_a_users_style_changes_nothing() -> None:
    def drawn() -> bytes:
        with fixed_style():
            figure, (panel,) = chart(title="t", x_label="x", labels=["y"])
            panel.plot([1, 2], [3, 5])
            return figure_image(figure).tobytes()

    import matplotlib as mpl

    first = drawn()
    with mpl.rc_context({"font.size": 30, "axes.grid": True, "lines.linewidth": 9, "savefig.dpi": 10}):
        assert drawn() == first


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(0.2, 3.0, [0.2, 0.5, 1.0, 2.0]), (1e-3, 10.0, [1e-3, 1e-2, 0.1, 1.0, 10.0]), (1.0, 1.5, None)],
)
@fixed_style()
def test_a_logarithmic_axis_has_ticks_within_a_decade(low, high, expected) -> None:
    figure, (panel,) = chart(title="t", x_label="x", labels=["y"], log_x=True)
    panel.plot([low, high], [1.0, 2.0])
    figure_image(figure)
    ends = panel.get_xlim()
    shown = [tick for tick in panel.get_xticks() if ends[0] <= tick <= ends[1]]
    assert shown == pytest.approx(expected) if expected else len(shown) > 3


def test_a_picture_must_be_called_png() -> None:
    assert check_png_path("a/b.PNG").name == "b.PNG"
    with pytest.raises(InputError, match=r"rig\.jpg: .*expected a name that ends in \.png"):
        check_png_path("rig.jpg")


def test_a_picture_that_cannot_be_written_leaves_nothing(tmp_path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write_picture(tmp_path / "missing" / "a.png", Image.new("RGB", (2, 2)))
    assert list(tmp_path.iterdir()) == []


def test_view_keeps_right_up_and_nearness() -> None:
    view = ParallelView(elevation=0.3, azimuth=-1.2)
    assert np.allclose(view.place(3.0 * view.right + 5.0 * view.up + 7.0 * view.toward), [3.0, 5.0])
    assert view.nearness(2 * view.toward) == pytest.approx(2.0)


def test_arc_of_elevation_ends_at_the_direction() -> None:
    foot = np.array([math.cos(0.7), math.sin(0.7), 0.0])
    for elevation in (0.4, math.pi / 2, math.radians(105)):
        path = arc(np.zeros(3), foot, np.array([0.0, 0.0, 1.0]), elevation, 3.0)
        assert np.allclose(path[-1], 3.0 * direction(elevation=elevation, azimuth=0.7))
        assert np.allclose(np.linalg.norm(path, axis=1), 3.0)


# ---- legends


@pytest.mark.parametrize(("height", "width"), [(30, 40), (600, 1600)])
def test_a_legend_stands_below_the_picture_which_stays(height: int, width: int) -> None:
    picture = np.random.default_rng(1).integers(0, 255, (height, width, 3), dtype=np.uint8)
    rows = (
        LegendRow(label="seen", amount="25.0 %", colours=((86, 180, 233),)),
        LegendRow(label="contrast under noise", amount="75.0 %", colours=((240, 228, 66), (247, 241, 160))),
    )
    found = _with_legend(picture, "a title that is wider than a small picture", rows)
    np.testing.assert_array_equal(found[:height, :width], picture)
    assert (found[:height, width:] == 255).all()
    below = found[height:]
    for row in rows:
        for colour in row.colours:
            assert (below == colour).all(axis=2).sum() > 100
    # nothing is cut off
    margin = np.concatenate([below[:, -4:].reshape(-1, 3), below[-4:].reshape(-1, 3)])
    assert (margin == 255).all()
    assert (below < 128).all(axis=2).any()


def test_differences_of_a_verification_stand_below_the_names_of_their_lights():
    differences = {
        (Posture(0.0, turn), light, 1.0): np.zeros((2, 4, 5), np.float32)
        for turn in (0.0, 180.0)
        for light in ("left", "right")
    }
    del differences[Posture(0.0, 180.0), "left", 1.0]
    gallery = _gallery(SimpleNamespace(differences=differences), 0, "as the rig file has it")
    assert gallery.header == ["left", "right"]
    assert [name for name, _ in gallery.rows] == ["posture (0°, 0°)", "posture (0°, 180°)"]
    assert [picture and picture.alt for picture in gallery.rows[1][1]] == [None, "captured minus predicted, right"]


def test_the_runs_of_a_history_are_whole_numbers():
    with fixed_style():
        _, (panel,) = chart(title="one run", x_label="run", labels=["offset"])
        panel.plot([1], [0.02], ".")
        label_whole_numbers(panel.xaxis)
        low, high = panel.get_xlim()
        assert [tick for tick in panel.get_xticks() if low <= tick <= high] == [1.0]
