"""What report pictures are made of: thumbnails, text, views, labels."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from PIL import Image

from lightopt.core.errors import InputError
from lightopt.core.transforms import direction
from lightopt.design import LegendRow
from lightopt.report._drawing import (
    Drawing,
    Label,
    _best_box,
    _ink,
    chart,
    figure_image,
    fit_text,
    fixed_style,
    sub,
    text_width,
)
from lightopt.report._images import SATURATED_COLOUR, check_png_path, thumbnail, write_picture
from lightopt.report._view import arc, fit_view
from lightopt.report.design._surface import _with_legend


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


@fixed_style()
def written(text: str, size: int = 24, **options: str) -> np.ndarray:
    """Where there is ink of a text that starts, ends or has its middle at column 100."""
    drawing = Drawing(400, 80)
    drawing.text(100, 50, text, size=size, **options)  # pyright: ignore[reportArgumentType]
    return np.asarray(drawing.image())[..., 0] < 128


def test_width_is_what_is_written() -> None:
    for text in ("light1", "θ 60°, φ −45°", sub("e", "θ") + " × " + sub("e", "φ"), "a$b$c 薬"):
        inked = np.argwhere(written(text))
        assert abs((inked[:, 1].max() + 1 - 100) - text_width(text, 24)) <= 5


def test_subscript_is_lower_and_smaller() -> None:
    plain, lowered = np.argwhere(written("xx")), np.argwhere(written(sub("x", "x")))
    assert lowered[:, 0].max() > plain[:, 0].max()
    assert lowered[:, 1].max() < plain[:, 1].max()


def test_alignment() -> None:
    columns = [np.argwhere(written("word", align=align))[:, 1] for align in ("left", "center", "right")]
    assert columns[0].min() > columns[1].min()
    assert abs(columns[1].mean() - 100) <= 4
    assert columns[0].min() >= 100
    assert columns[2].max() <= 100


@given(st.text(max_size=40), st.integers(5, 300))
@fixed_style()
def test_any_name_fits_and_can_be_written(text: str, width: int) -> None:
    fitted = fit_text(text, 16, width)
    assert text_width(fitted, 16) <= width or fitted == "…"
    drawing = Drawing(60, 60)
    drawing.text(5, 30, text, size=16, halo="#ffffff")
    picture = np.asarray(drawing.image())
    assert picture[:8].min() == picture[52:].min() == 255


def test_line_breaks_in_a_name_do_not_break_the_line() -> None:
    inked = np.argwhere(written("a\nb"))
    assert inked[:, 0].max() < 60
    assert text_width("a\nb", 24) > text_width("ab", 24)


@fixed_style()
def test_lines_are_where_they_are_requested() -> None:
    drawing = Drawing(40, 30)
    drawing.line(np.array([[10.0, 5.0], [10.0, 25.0]]), colour="#000000", width=1.0)
    picture = np.asarray(drawing.image())[..., 0].astype(float)
    assert abs((255 - picture).sum(axis=1)[15] / 255 - 1.0) < 0.35
    assert np.argmin(picture[15]) in (9, 10)
    assert picture[2].min() == 255
    assert picture[27].min() == 255


@fixed_style()
def test_an_arrow_of_no_length_draws_nothing() -> None:
    drawing = Drawing(20, 20)
    drawing.arrow(np.array([[10.0, 10.0], [10.0, 10.0]]), colour="#000000")
    assert np.asarray(drawing.image()).min() == 255


@fixed_style()
@pytest.mark.parametrize("size", [(40, 30), (1777, 907), (53, 2111)])
def test_pictures_lie_pixel_on_pixel(size: tuple[int, int]) -> None:
    width, height = size
    picture = np.random.default_rng(1).integers(0, 255, (height - 9, width - 7, 3), dtype=np.uint8)
    drawing = Drawing(width, height)
    drawing.picture(picture, 4, 3)
    found = np.asarray(drawing.image())
    assert found.shape == (height, width, 3)
    np.testing.assert_array_equal(found[3:-6, 4:-3], picture)


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


points3 = st.lists(st.tuples(*[st.floats(-500, 500)] * 3), min_size=2, max_size=12)


@given(points3, st.floats(0, 1.5), st.floats(0, 6.3))
def test_fitted_view_shows_all_points(points, elevation: float, azimuth: float) -> None:
    box = (10.0, 20.0, 400.0, 300.0)
    view = fit_view(np.array(points), elevation=elevation, azimuth=azimuth, box=box)
    flat = view.place(np.array(points))
    assert (flat >= np.array(box[:2]) - 1e-3).all()
    assert (flat <= np.array(box[2:]) + 1e-3).all()


def test_view_keeps_right_up_and_nearness() -> None:
    view = fit_view(np.diag([100.0, 100.0, 100.0]), elevation=0.3, azimuth=-1.2, box=(0, 0, 100, 100))
    origin = view.place(np.zeros(3))
    step = np.array([1.0, -1.0]) * (view.place(view.right + view.up) - origin)
    assert np.allclose(step, view.scale)
    assert np.allclose(view.place(7 * view.toward), origin)
    assert view.nearness(2 * view.toward) == pytest.approx(2.0)


def test_arc_of_elevation_ends_at_the_direction() -> None:
    foot = np.array([math.cos(0.7), math.sin(0.7), 0.0])
    for elevation in (0.4, math.pi / 2, math.radians(105)):
        path = arc(np.zeros(3), foot, np.array([0.0, 0.0, 1.0]), elevation, 3.0)
        assert np.allclose(path[-1], 3.0 * direction(elevation=elevation, azimuth=0.7))
        assert np.allclose(np.linalg.norm(path, axis=1), 3.0)


anchors = st.lists(st.tuples(st.floats(150, 450), st.floats(150, 350)), min_size=1, max_size=14)


@given(anchors, st.integers(0, 1000))
@settings(max_examples=20)
@fixed_style()
def test_labels_never_overlap(places, seed: int) -> None:
    drawing = Drawing(600, 500)
    for start, end in np.random.default_rng(seed).uniform(0, 500, (12, 2, 2)):
        drawing.line(np.stack([start, end]), colour="#000000")
    labels = [Label(text=f"light {i}", anchor=place, colour="#000000") for i, place in enumerate(places)]
    bounds = (5.0, 5.0, 595.0, 495.0)
    boxes = drawing.labels(labels, size=18, bounds=bounds)
    assert len(boxes) == len(labels)
    for i, a in enumerate(boxes):
        assert min(a[0] - bounds[0], a[1] - bounds[1], bounds[2] - a[2], bounds[3] - a[3]) >= 0
        for b in boxes[i + 1 :]:
            assert a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]


def place(label: Label, ink: np.ndarray):
    sums = np.pad(ink.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    return _best_box(label, 20, sums, (0, 0, ink.shape[1], ink.shape[0]), [])


def test_a_label_avoids_lines_and_takes_its_side() -> None:
    ink = np.zeros((200, 300))
    free = Label(text="name", anchor=(150.0, 100.0), colour="#000000", away=(0.0, 1.0))
    assert place(free, ink)[1] > 100
    ink[101:] = 1.0
    assert place(free, ink)[3] <= 101


def test_a_label_without_room_is_left_out() -> None:
    label = Label(text="much too long", anchor=(10.0, 10.0), colour="#000000")
    assert place(label, np.zeros((30, 30))) is None


def test_ink_ignores_pale_areas() -> None:
    image = Image.new("RGB", (3, 1), "#f7f8fa")
    image.putpixel((1, 0), (20, 20, 20))
    assert _ink(np.asarray(image)).tolist() == [[0.0, 1.0, 0.0]]


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
