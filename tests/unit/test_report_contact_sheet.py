"""The contact sheet: everything in its place, saturation visible, foreign sets, bad input."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.images import ImageEntry, ImageSet, ImageSetWriter, Manifest, SourceFile, read_image_set, read_png
from lightopt.report import contact_sheet
from lightopt.report._contact_sheet import MARGIN


def make_set(
    folder: Path,
    levels: Mapping[tuple[str, Posture, float], int],
    *,
    size: tuple[int, int] = (30, 40),
    bits: int = 8,
    exr_only: bool = False,
    positions: Mapping[tuple[str, Posture], float] | None = None,
) -> ImageSet:
    """A set of images, each of one level."""
    header = Manifest(
        kind="simulated",
        bit_depth=bits,
        rig=SourceFile("four-panel.yaml", "a" * 64),
        part=SourceFile("cover-knob.yaml", "b" * 64),
    )
    writer = ImageSetWriter(folder, header)
    for (light, posture, exposure), level in levels.items():
        azimuth = (positions or {}).get((light, posture), 45.0)
        entry = ImageEntry(light, 60.0, azimuth, posture, exposure)
        if exr_only:
            scale = 255 / ((2**bits - 1) * exposure)
            writer.add_image(entry, exr={"Y": np.full(size, level * scale, np.float32)})
        else:
            writer.add_image(entry, png=np.full(size, level, np.uint8 if bits == 8 else np.uint16))
    return read_image_set(folder)


def box_of(picture: np.ndarray, grey: int, least: int = 2000) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of the area of a grey."""
    same = picture[..., 1] == grey
    assert np.count_nonzero(same) >= least, grey
    # borders of letters hold any grey, an image many of one
    rows, columns = (np.flatnonzero(count > 0.5 * count.max()) for count in (same.sum(axis=1), same.sum(axis=0)))
    left, top, right, bottom = int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1
    assert same[top:bottom, left:right].all()
    return left, top, right, bottom


def sheet_of(image_set: ImageSet, path: Path, **options: object) -> np.ndarray:
    assert contact_sheet(image_set, path, **options) == path  # pyright: ignore[reportArgumentType]
    picture = read_png(path, colour=True)
    # nothing runs into the margin; ascenders of letters may a little
    for border in (picture[: MARGIN - 6], picture[-MARGIN + 8 :], picture[:, : MARGIN - 2], picture[:, -MARGIN:]):
        assert border.min() == 255
    return picture


@pytest.mark.slow
@pytest.mark.parametrize(("lights", "postures"), [(1, 1), (4, 4), (2, 7), (7, 12)])
def test_rows_are_postures_and_columns_are_lights(tmp_path: Path, lights: int, postures: int) -> None:
    names = [f"light{i}" for i in range(lights)]
    poses = [Posture(0, 10 * i) for i in range(postures)]
    levels = {(name, pose, 1.0): 5 + r * lights + c for r, pose in enumerate(poses) for c, name in enumerate(names)}
    picture = sheet_of(make_set(tmp_path / "set", levels), tmp_path / "sheet.png")
    # the outermost and one in the middle are enough
    examined = [poses[i] for i in sorted({0, postures // 2, postures - 1})]
    columns = [names[i] for i in sorted({0, lights // 2, lights - 1})]
    boxes = [[box_of(picture, levels[name, pose, 1.0]) for name in columns] for pose in examined]
    for r in range(len(examined)):
        assert len({box[1] for box in boxes[r]}) == 1
        assert r == 0 or boxes[r][0][1] > boxes[r - 1][0][3]
    for c in range(len(columns)):
        assert len({row[c][0] for row in boxes}) == 1
        assert c == 0 or boxes[0][c][0] > boxes[0][c - 1][2]
    assert len({(box[2] - box[0], box[3] - box[1]) for row in boxes for box in row}) == 1


def test_same_set_same_bytes(tmp_path: Path) -> None:
    image_set = make_set(tmp_path / "set", {("a", Posture(0, 0), 1.0): 80, ("b", Posture(0, 0), 1.0): 255})
    first = contact_sheet(image_set, tmp_path / "1.png").read_bytes()
    assert contact_sheet(image_set, tmp_path / "2.png").read_bytes() == first
    assert contact_sheet(image_set, tmp_path / "3.png", title="other").read_bytes() != first
    assert sorted(p.name for p in tmp_path.iterdir()) == ["1.png", "2.png", "3.png", "set"]


def test_the_longest_exposure_unless_another_is_requested(tmp_path: Path) -> None:
    levels = {("a", Posture(0, 0), 0.25): 21, ("a", Posture(0, 0), 1.0): 84}
    image_set = make_set(tmp_path / "set", levels)
    box_of(sheet_of(image_set, tmp_path / "1.png"), 84)
    box_of(sheet_of(image_set, tmp_path / "2.png", exposure=0.25 * (1 + 1e-9)), 21)
    with pytest.raises(InputError, match=r"no images at 0\.5; it has 0\.25, 1"):
        contact_sheet(image_set, tmp_path / "3.png", exposure=0.5)
    assert not (tmp_path / "3.png").exists()


def test_more_than_eight_bits_are_scaled_linearly(tmp_path: Path) -> None:
    levels = {("a", Posture(0, 0), 1.0): 1023, ("b", Posture(0, 0), 1.0): 2047}
    picture = sheet_of(make_set(tmp_path / "set", levels, bits=12), tmp_path / "1.png")
    box_of(picture, round(255 * 1023 / 4095))
    box_of(picture, round(255 * 2047 / 4095))


def test_a_set_of_exr_shows_the_same_images(tmp_path: Path) -> None:
    levels = {("a", Posture(0, 0), 0.5): 90, ("b", Posture(0, 0), 0.5): 255}
    png = sheet_of(make_set(tmp_path / "png", levels), tmp_path / "1.png")
    exr = sheet_of(make_set(tmp_path / "exr", levels, exr_only=True), tmp_path / "2.png")
    assert np.array_equal(png, exr)


def test_saturation_is_red_and_counted(tmp_path: Path) -> None:
    dark = make_set(tmp_path / "dark", {("a", Posture(0, 0), 1.0): 254}, size=(64, 64))
    bright = make_set(tmp_path / "bright", {("a", Posture(0, 0), 1.0): 255}, size=(64, 64))

    def red(picture: np.ndarray) -> int:
        channels = picture[: -7 * 21].astype(int)  # without the legend
        return int(np.count_nonzero(channels[..., 0] > 2 * channels[..., 1] + 60))

    assert red(sheet_of(dark, tmp_path / "1.png")) == 0
    assert red(sheet_of(bright, tmp_path / "2.png")) > 300 * 300


def test_missing_images_leave_their_cell_empty(tmp_path: Path) -> None:
    levels = {("a", Posture(0, 0), 1.0): 60, ("b", Posture(0, 0), 1.0): 61, ("b", Posture(0, 90), 1.0): 62}
    picture = sheet_of(make_set(tmp_path / "set", levels), tmp_path / "1.png")
    boxes = [box_of(picture, grey) for grey in (60, 61, 62)]
    assert boxes[1][0] == boxes[2][0]
    empty = picture[boxes[2][1] : boxes[2][3], boxes[0][0] : boxes[0][2]]
    assert (empty > 80).all()


def test_images_of_different_sizes_keep_the_table_aligned(tmp_path: Path) -> None:
    header = Manifest(kind="captured", bit_depth=8)
    writer = ImageSetWriter(tmp_path / "set", header)
    for grey, (light, size) in enumerate((("wide", (200, 400)), ("tall", (400, 200))), 70):
        writer.add_image(ImageEntry(light, 60.0, 45.0, Posture(0, 0)), png=np.full(size, grey, np.uint8))
    picture = sheet_of(read_image_set(tmp_path / "set"), tmp_path / "1.png")
    wide, tall = box_of(picture, 70), box_of(picture, 71)
    assert tall[0] > wide[2]
    assert abs((wide[1] + wide[3]) - (tall[1] + tall[3])) <= 2


def test_a_light_that_moves_between_postures_shows_where_it_was(tmp_path: Path) -> None:
    levels = {("a", Posture(0, 0), 1.0): 60, ("a", Posture(0, 90), 1.0): 61}
    still = sheet_of(make_set(tmp_path / "1", levels), tmp_path / "1.png")
    moved = {("a", Posture(0, 90)): 50.0}
    moving = sheet_of(make_set(tmp_path / "2", levels, positions=moved), tmp_path / "2.png")
    assert (moving != still).any(axis=2).sum() > 100  # a second line below the images


def test_long_and_foreign_names_stay_inside(tmp_path: Path) -> None:
    names = ["a light with quite a long name that no column could hold in full", "Lümière 薬\u2028"]
    levels = {(name, Posture(-12.5, 278.25), 1.0): 60 + i for i, name in enumerate(names)}
    sheet_of(make_set(tmp_path / "set", levels), tmp_path / "1.png", title="t" * 500)


def test_bad_input(tmp_path: Path) -> None:
    image_set = make_set(tmp_path / "set", {("a", Posture(0, 0), 1.0): 60})
    with pytest.raises(InputError, match=r"ends in \.png"):
        contact_sheet(image_set, tmp_path / "sheet.jpg")
    with pytest.raises(InputError, match="cannot be written"):
        contact_sheet(image_set, tmp_path / "nowhere" / "sheet.png")
    empty = ImageSet(folder=tmp_path, manifest=Manifest(kind="simulated", bit_depth=8))
    with pytest.raises(InputError, match="lists no images"):
        contact_sheet(empty, tmp_path / "sheet.png")
    image_set.path(image_set.images[0].png or "").unlink()
    with pytest.raises(InputError, match="png"):
        contact_sheet(image_set, tmp_path / "sheet.png")
    assert [p.name for p in tmp_path.iterdir()] == ["set"]
