"""ChArUco boards: what images show of them, what is wrong with images, boards as meshes and on paper."""

from __future__ import annotations

import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from lightopt.config import BoardTargetConfig
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration import BoardImage, board_grid, board_mesh, find_corners, white_areas
from lightopt.geometry import face_areas, face_normals, load_mesh, stl_bytes
from lightopt.report.rig import board_sheet

TARGET = BoardTargetConfig(squares=(8, 6), square_mm=5.0, marker_mm=3.75)
SCALE, ORIGIN = 11.3, np.array([260.37, 190.81])  # of a picture [px/mm], [px]


@pytest.fixture(scope="module")
def cv2():
    return pytest.importorskip("cv2", minversion="4.14", reason="needs the extra opencv")


def picture(target, dark=20.0, bright=210.0, margin=3.0):
    """The board seen straight on: the share of each pixel that is white, exactly."""
    width, height = (2 * ORIGIN).astype(int) + 1
    white = np.zeros((height, width))
    for left, bottom, right, top in white_areas(target, margin=margin):
        (x0, x1), (y0, y1) = ORIGIN[0] + SCALE * np.array([left, right]), ORIGIN[1] - SCALE * np.array([top, bottom])
        across, down = (
            np.clip(np.arange(size) + 1, low, high) - np.clip(np.arange(size), low, high)
            for size, low, high in ((width, x0, x1), (height, y0, y1))
        )
        white += np.outer(down, across)
    return gaussian_filter(dark + (bright - dark) * white, 0.7)


def corners_of(image, target=TARGET, **options):
    return find_corners([BoardImage("a", Posture(0.0, 0.0), image)], target, **options)


@pytest.mark.parametrize("legacy", [False, True])
def test_corners_are_found_where_they_are(cv2, legacy):
    target = BoardTargetConfig(squares=(8, 6), square_mm=5.0, marker_mm=3.75, legacy_pattern=legacy)
    (view,), problems = corners_of(picture(target), target)
    assert problems == []
    assert sorted(view.ids) == list(range(35))
    true = ORIGIN + SCALE * board_grid(target).points[view.ids] * [1, -1]
    assert np.abs((view.pixels - true).mean(axis=0)).max() < 0.02  # not half a pixel
    assert np.sqrt(np.mean(np.square(view.pixels - true))) < 0.1


def test_any_kind_of_image_will_do(cv2):
    image = picture(TARGET)
    (grey,), _ = corners_of(image)
    (colours,), _ = corners_of(np.repeat(image[:, :, None], 3, axis=2))
    (twelve,), _ = corners_of((image * 16).astype(np.uint16), full_scale=4095.0)
    np.testing.assert_allclose(colours.pixels, grey.pixels, atol=1e-6)
    np.testing.assert_allclose(twelve.pixels, grey.pixels, atol=0.03)


@pytest.mark.parametrize(
    ("change", "message", "used"),
    [
        (lambda image: gaussian_filter(image, 2.7), r"blurred: edges are 2\.\d px wide", True),
        (lambda image: np.clip(1.4 * image, 0, 255), "saturated: .* Expose less", True),
        (lambda image: image[:, ::-1], "the image is mirrored", False),
        (lambda image: image[:230, :260], r"\d markers and \d corners found, expected at least 8 corners", False),
        (lambda image: np.full_like(image, 9.0), "no board found: grey levels are between 9 and 9 of 255", False),
        (lambda image: gaussian_filter(image, 20.0), "no board found", False),
    ],
)
def test_what_is_wrong_with_an_image_is_said(cv2, change, message, used):
    good, bad = BoardImage("good", Posture(0.0, 0.0), picture(TARGET)), change(picture(TARGET))
    frame = np.full_like(good.pixels, 20.0)
    frame[: bad.shape[0], : bad.shape[1]] = bad
    views, (problem,) = find_corners([good, BoardImage("bad", Posture(0.0, 0.0), frame)], TARGET)
    assert [view.name for view in views] == ["good", "bad"][: 1 + used]
    assert re.match("bad: " + message, problem)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"legacy_pattern": True}, "other pattern: set legacy_pattern to false"),
        ({"dictionary": "DICT_5X5_1000"}, "its markers are of DICT_4X4_1000, expected DICT_5X5_1000"),
        ({"squares": (4, 4)}, r"wrong board: it shows marker 23 .* has 0 to 7\. Check the numbers of squares"),
    ],
)
def test_another_board_is_recognised(cv2, other, message):
    fields = {"squares": (8, 6), "square_mm": 5.0, "marker_mm": 3.75, **other}
    with pytest.raises(InputError, match=message):
        corners_of(picture(TARGET), BoardTargetConfig(**fields))


def test_images_of_several_sizes_are_refused(cv2):
    image = picture(TARGET)
    with pytest.raises(InputError, match=r"sizes differ: 521 × 382 \(a\), 521 × 380 \(b\)"):
        find_corners([BoardImage("a", Posture(0, 0), image), BoardImage("b", Posture(0, 0), image[:380])], TARGET)


@pytest.mark.parametrize(
    ("module", "message"),
    [
        (None, r"need OpenCV, which is not there .*pip install 'lightopt\[opencv\]'"),
        (SimpleNamespace(__version__="4.13.0", aruco=None), "OpenCV 4.13.0 finds ChArUco corners half a pixel off"),
        (SimpleNamespace(__version__="5.0.0-pre"), "no module aruco"),
    ],
)
def test_an_opencv_that_is_missing_or_too_old_is_refused(monkeypatch, module, message):
    monkeypatch.setitem(sys.modules, "cv2", module)
    with pytest.raises(InputError, match=message):
        white_areas(TARGET)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"dictionary": "DICT_9X9"}, "no dictionary DICT_9X9; expected one of DICT_4X4_100, "),
        ({"dictionary": "DICT_4X4_50", "squares": (20, 20)}, "DICT_4X4_50 has 50 markers; the board needs 200"),
        ({"marker_mm": 5.0}, "expected less than the squares"),
    ],
)
def test_boards_that_cannot_be_are_refused(cv2, fields, message):
    with pytest.raises(InputError, match=message):
        white_areas(BoardTargetConfig(**{"squares": (8, 6), "square_mm": 5.0, "marker_mm": 3.75, **fields}))


def test_a_board_is_a_mesh_of_its_white_areas(cv2, tmp_path):
    areas = white_areas(TARGET)
    whole = float(np.prod(areas[:, 2:] - areas[:, :2], axis=1).sum())
    assert whole == pytest.approx(24 * (25.0 - 3.75**2) + 24 * 3.75**2 / 36 * 8, rel=0.08)  # half of a marker's 16 bits
    mesh = board_mesh(TARGET, margin=2.0)
    (tmp_path / "board.stl").write_bytes(stl_bytes(mesh))
    read = load_mesh(tmp_path / "board.stl", unit_mm=1.0, normals="facet", crease_angle=0.5).mesh
    for found in (mesh, read):
        assert face_areas(found).sum() == pytest.approx(whole + 44 * 34 - 40 * 30, rel=1e-5)
        np.testing.assert_allclose(face_normals(found)[:, 2], 1.0)
        np.testing.assert_allclose(found.bounds, [[-22, -17, 0], [22, 17, 0]], atol=1e-5)


def test_a_printed_board_has_its_true_size(cv2, tmp_path):
    from PIL import Image

    board_sheet(TARGET, tmp_path / "board.png")
    board_sheet(TARGET, tmp_path / "board.pdf", paper="A4")
    with Image.open(tmp_path / "board.png") as image:
        assert image.info["dpi"] == pytest.approx((600, 600), abs=0.1)
        grey = np.asarray(image.convert("L"), np.float64)
    (view,), _ = corners_of(grey * 0.8)
    off = view.pixels - board_grid(TARGET).points[view.ids] * [1, -1] * 600 / 25.4
    assert len(view.ids) == 35
    assert np.ptp(off, axis=0).max() < 2.0  # edges are on whole pixels of 0.04 mm
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")
    assert b"/MediaBox [ 0 0 841.88" in (tmp_path / "board.pdf").read_bytes()
    with pytest.raises(InputError, match=r"ends with .pdf or .png"):
        board_sheet(TARGET, tmp_path / "board.svg")
    with pytest.raises(InputError, match="paper b5: expected a4, a3, letter"):
        board_sheet(TARGET, tmp_path / "board.pdf", paper="b5")
    with pytest.raises(InputError, match="the board needs 320 × 286 mm, and a4 has 297 × 210 mm"):
        board_sheet(
            BoardTargetConfig(squares=(6, 5), square_mm=50.0, marker_mm=40.0), tmp_path / "board.pdf", paper="a4"
        )


@pytest.mark.slow
def test_corners_of_a_rendered_board_are_where_the_scene_has_them(cv2, tmp_path):
    from lightopt import build_scene, load_part, load_rig, render
    from lightopt.scene import project

    (tmp_path / "board.stl").write_bytes(stl_bytes(board_mesh(TARGET, margin=3.0)))
    (tmp_path / "part.yaml").write_text(
        "format: lightopt-part/1\nname: board\nmesh: {file: board.stl, units: mm, normals: facet}\n"
        "placement: {anchor: rest_on_table}\npostures: [{elevation_deg: 30, rotation_deg: 20}]\n"
        "reflectance: {R_d: 200, R_s: 0, sigma_rad: 0.2}\n"
    )
    (tmp_path / "rig.yaml").write_text(
        "format: lightopt-rig/1\nname: rig\n"
        "camera: {distance_mm: 550, elevation_deg: 80, roll_deg: 7, resolution_px: [800, 600], pixel_size_um: 6, "
        "image_distance_mm: 55, sensor: {bit_depth: 8, saturation_level: 255, black_level: 0, read_noise_levels: 1, "
        "electrons_per_level: 60}}\n"
        "light_source: {size_mm: [60, 60], points: 4, falloff: none, emission_exponent: 0}\n"
        "lights: [{name: light, distance_mm: 330, elevation_deg: 80, azimuth_deg: 45}]\n"
    )
    scene = build_scene(load_rig(tmp_path / "rig.yaml"), load_part(tmp_path / "part.yaml"))
    (images,) = render(scene, shadows=False, supersample=4)
    level = images.lights[0].level
    (view,), _ = corners_of(level * (200.0 / level.max()))
    rotation, shift = scene.stage.transform(images.posture)
    points = np.column_stack([board_grid(TARGET).points[view.ids], np.zeros(len(view.ids))]) @ rotation.T + shift
    columns, rows, _ = project(scene.camera, points)
    off = view.pixels - np.column_stack([columns, rows])
    assert len(view.ids) == 35
    assert np.sqrt(np.mean(np.square(off))) < 0.1
    assert np.abs(off.mean(axis=0)).max() < 0.03
