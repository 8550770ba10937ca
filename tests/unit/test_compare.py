"""Comparison: the numbers, the verdict, and that nothing which cannot be compared passes."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.images import (
    ImageEntry,
    ImageSetWriter,
    Manifest,
    read_metadata,
    read_png,
    write_exr,
    write_npz_atomic,
    write_png,
)
from lightopt.images.comparison import ComparisonThresholds, compare_files, compare_sets, difference_picture
from lightopt.images.comparison._channels import compare_arrays

LEVELS = np.random.default_rng(0).uniform(1, 400, (40, 50)).astype(np.float32)
STRICT = {"absolute": 0.0, "relative": 0.0, "max_share": 0.0}


def exr(path: Path, **channels: np.ndarray) -> Path:
    write_exr(path, {name: values.astype(np.float32) for name, values in channels.items()}, metadata={})
    return path


# ---- numbers


def test_statistics_against_a_plain_computation():
    a = LEVELS.astype(float)
    b = a + np.random.default_rng(1).normal(0, 0.2, a.shape)
    result = compare_arrays("Y", a, b, absolute=0.05, relative=0.001, max_share=0.5, saturation=(255, 255))
    distance = [abs(x - y) for x, y in zip(a.ravel().tolist(), b.ravel().tolist(), strict=True)]
    differing = sum(d > 0.05 + 0.001 * abs(x) for d, x in zip(distance, a.ravel().tolist(), strict=True))
    full_a, full_b = ({i for i, x in enumerate(a.flat) if x >= 255}, {i for i, x in enumerate(b.flat) if x >= 255})
    assert result.max == pytest.approx(max(distance))
    assert result.rms == pytest.approx((sum(d * d for d in distance) / len(distance)) ** 0.5)
    assert result.percentiles == pytest.approx(
        {"p50": np.median(distance), **{f"p{p}": np.percentile(distance, p) for p in (95, 99)}}
        | {"p99_9": np.percentile(distance, 99.9)}
    )
    assert (result.differing, result.share) == (differing, differing / a.size)
    assert (result.saturated_a, result.saturated_b) == (len(full_a), len(full_b))
    assert result.iou == len(full_a & full_b) / len(full_a | full_b)


@given(hnp.arrays(np.float32, (3, 4), elements=st.floats(width=32)))
def test_anything_equals_itself(values: np.ndarray):
    result = compare_arrays("Y", values, values.copy(), **STRICT, saturation=(255, 255))
    assert result.passed
    assert (result.differing, result.iou) == (0, 1.0)
    json.dumps(result.as_dict(), allow_nan=False)


def test_unsigned_levels_do_not_wrap_around():
    result = compare_arrays("levels", np.array([[0]], np.uint8), np.array([[255]], np.uint8), **STRICT)
    assert result.max == 255


def test_threshold_is_relative_to_the_golden_and_not_reached_by_equality():
    golden = np.array([[1000.0, 0.0]])
    new = golden + np.array([[1.05, 0.05]])
    # In binary 1001.05 − 1000 is a hair above 1.05; a threshold a hair larger holds it.
    assert compare_arrays("Y", golden, new, absolute=0.0500001, relative=0.001, max_share=0).passed
    assert compare_arrays("Y", golden, new, absolute=0.0499, relative=0.001, max_share=0).differing == 2


def test_share_decides_not_the_largest_difference():
    a, b = np.zeros((100, 100)), np.zeros((100, 100))
    b.flat[:10] = 1e6
    limits = {"absolute": 0.05, "relative": 0.001, "max_share": 0.001}
    assert compare_arrays("Y", a, b, **limits).passed
    b.flat[10] = 1
    failed = compare_arrays("Y", a, b, **limits)
    assert not failed.passed
    assert "0.110% of values (11 of 10000)" in failed.reasons[0]


def test_values_that_are_not_finite():
    a = np.array([[np.nan, np.inf, np.nan, np.inf, 1.0, 2.0]])
    same = compare_arrays("Y", a, a.copy(), **STRICT)
    assert same.passed
    assert (same.not_finite_a, same.not_finite_b) == (4, 4)
    b = np.array([[np.nan, np.inf, np.inf, -np.inf, 1.0, 2.0]])
    assert compare_arrays("Y", a, b, absolute=0, relative=0, max_share=1).differing == 2
    fresh = np.array([[np.nan, np.inf, np.nan, np.inf, np.nan, 2.0]])
    result = compare_arrays("Y", a, fresh, absolute=0, relative=0, max_share=1)
    assert not result.passed
    assert "1 values are NaN or infinite" in result.reasons[0]
    nothing = compare_arrays("Y", np.full((2, 2), np.nan), np.full((2, 2), np.nan), **STRICT)
    assert nothing.max is None


def test_least_overlap_of_saturated_areas_when_requested():
    a, b = np.zeros((10, 10)), np.zeros((10, 10))
    a[:4], b[2:6] = 255, 255
    free = {"absolute": 1e9, "relative": 0, "max_share": 0, "saturation": (255, 255)}
    assert compare_arrays("Y", a, b, **free).iou == pytest.approx(1 / 3)
    assert compare_arrays("Y", a, b, **free, min_iou=0.33).passed
    assert "IoU" in compare_arrays("Y", a, b, **free, min_iou=0.34).reasons[0]


@pytest.mark.parametrize(
    "values",
    [{"absolute": -1}, {"relative": float("nan")}, {"max_share": 1.1}, {"min_iou": 2}, {"saturation": float("inf")}],
)
def test_impossible_thresholds_are_refused(values: dict):
    with pytest.raises(InputError, match=next(iter(values))):
        ComparisonThresholds(**values)


# ---- files


def test_default_thresholds_of_two_exr(tmp_path: Path):
    a = exr(tmp_path / "a.exr", Y=LEVELS)
    near = exr(tmp_path / "near.exr", Y=LEVELS * 1.001 + 0.04)
    far = exr(tmp_path / "far.exr", Y=LEVELS * 1.001 + 0.06)
    assert compare_files(a, near).passed
    result = compare_files(a, far)
    assert not result.passed
    assert result.channels[0].differing == LEVELS.size
    assert compare_files(a, far, ComparisonThresholds(absolute=0.1)).passed
    assert json.loads(json.dumps(result.as_dict(), allow_nan=False))["channels"][0]["passed"] is False


def test_saturation_of_an_exr_is_its_full_scale_and_of_a_png_its_own_level(tmp_path: Path):
    a = exr(tmp_path / "a.exr", Y=LEVELS)
    assert compare_files(a, a).channels[0].saturated_a == int((LEVELS >= 255).sum())
    assert compare_files(a, a, ComparisonThresholds(saturation=300)).channels[0].saturated_a == int(
        (LEVELS >= 300).sum()
    )
    write_exr(tmp_path / "b.exr", {"Y": LEVELS}, metadata={"full_scale": 200})
    assert compare_files(a, tmp_path / "b.exr").channels[0].saturated_b == int((LEVELS >= 200).sum())
    twelve = np.array([[4079, 4080, 4095]], np.uint16)
    write_png(tmp_path / "c.png", twelve, metadata={"saturation_level": 4080})
    write_png(tmp_path / "d.png", twelve, metadata={})
    result = compare_files(tmp_path / "c.png", tmp_path / "d.png").channels[0]
    assert (result.saturated_a, result.saturated_b) == (2, 0)


def test_other_channels_than_levels_have_no_saturated_area(tmp_path: Path):
    a = exr(tmp_path / "a.exr", Y=LEVELS, **{"diffuse.Y": LEVELS})
    result = compare_files(a, a)
    assert [(channel.name, channel.iou) for channel in result.channels] == [("Y", 1.0), ("diffuse.Y", None)]


def test_pngs_are_compared_in_sensor_levels_and_pictures_by_colour(tmp_path: Path):
    levels = np.full((40, 50), 100, np.uint8)
    write_png(tmp_path / "a.png", levels, metadata={})
    write_png(tmp_path / "b.png", levels + 1, metadata={})
    assert not compare_files(tmp_path / "a.png", tmp_path / "b.png").passed
    assert compare_files(tmp_path / "a.png", tmp_path / "b.png", ComparisonThresholds(absolute=1)).passed
    picture = np.stack([levels, levels, levels + 9], axis=-1)
    write_png(tmp_path / "c.png", picture, metadata={})
    assert [channel.name for channel in compare_files(tmp_path / "c.png", tmp_path / "c.png").channels] == [
        "B",
        "G",
        "R",
    ]
    assert "lacks channel" in " ".join(compare_files(tmp_path / "a.png", tmp_path / "c.png").reasons)


def test_what_cannot_be_compared_fails_with_its_reason(tmp_path: Path):
    a = exr(tmp_path / "a.exr", Y=LEVELS)
    write_png(tmp_path / "a.png", LEVELS.astype(np.uint8), metadata={})
    write_png(tmp_path / "wide.png", LEVELS.astype(np.uint16), metadata={})
    cases = {
        exr(tmp_path / "small.exr", Y=LEVELS[1:]): "different sizes",
        exr(tmp_path / "more.exr", Y=LEVELS, Z=LEVELS): "channel Z",
        exr(tmp_path / "other.exr", L=LEVELS): "channel L",
        tmp_path / "a.png": "different formats",
    }
    for other, reason in cases.items():
        for pair in ((a, other), (other, a)):
            result = compare_files(*pair)
            assert not result.passed, pair
            assert reason in " ".join(result.reasons), pair
    assert not compare_files(tmp_path / "a.png", tmp_path / "wide.png").passed


def test_files_that_are_no_images_are_wrong_input(tmp_path: Path):
    a = exr(tmp_path / "a.exr", Y=LEVELS)
    (tmp_path / "text.exr").write_text("no image")
    (tmp_path / "cut.exr").write_bytes(a.read_bytes()[:2000])
    for name, reported in (("missing.exr", "file is missing"), ("text.exr", "neither"), ("cut.exr", "cut.exr")):
        for pair in ((a, tmp_path / name), (tmp_path / name, a)):
            with pytest.raises(InputError, match=reported):
                compare_files(*pair)
    with pytest.raises(InputError) as both:
        compare_files(tmp_path / "missing.exr", tmp_path / "text.exr")
    missing, text = both.value.messages
    assert missing.startswith("golden file is missing")
    assert "text.exr" in text


def test_the_background_does_not_dilute_a_difference(tmp_path: Path):
    # a part of 100 pixels, one of which changed: 1 % of the part, 0.01 % of the frame
    a = np.zeros((100, 100))
    a[:10, :10] = 50
    b = a.copy()
    b[0, 0] = 60
    result = compare_files(exr(tmp_path / "a.exr", Y=a), exr(tmp_path / "b.exr", Y=b))
    assert not result.passed
    assert "1.000% of values (1 of 100)" in result.reasons[0]
    # part in one image only counts, whichever it is
    b = np.roll(a, 10, axis=1)
    for pair in (("a.exr", "c.exr"), ("c.exr", "a.exr")):
        exr(tmp_path / "c.exr", Y=b)
        channel = compare_files(tmp_path / pair[0], tmp_path / pair[1]).channels[0]
        assert (channel.differing, channel.compared, channel.pixels) == (200, 200, 10_000)
    nothing = exr(tmp_path / "dark.exr", Y=np.zeros((9, 9)))
    assert compare_files(nothing, nothing).passed


def test_the_background_of_a_png_is_its_black_level(tmp_path: Path):
    a = np.full((100, 100), 13, np.uint8)
    a[:10, :10] = 50
    b = a.copy()
    b[0, 0] = 60
    for name, levels in (("a", a), ("b", b)):
        write_png(tmp_path / f"{name}.png", levels, metadata={"black_level": 12.5})
        write_png(tmp_path / f"{name}-foreign.png", levels, metadata={})
    reported = compare_files(tmp_path / "a.png", tmp_path / "b.png").channels[0]
    assert (reported.differing, reported.compared) == (1, 100)
    foreign = tmp_path / "a-foreign.png", tmp_path / "b-foreign.png"
    assert compare_files(*foreign).channels[0].compared == 10_000
    manifest = Manifest(kind="captured", bit_depth=8, black_level=13)
    assert compare_files(*foreign, manifests=(manifest, manifest)).channels[0].compared == 100


# ---- geometry


def geometry(path: Path, hit: np.ndarray, patch: np.ndarray, *, shift: float = 0.0) -> Path:
    zero = np.zeros(hit.shape)
    names = ("P.X", "P.Y", "P.Z", "N.X", "N.Y", "N.Z")
    channels = {name: np.where(hit, 10 + shift, zero) for name in names}
    return exr(path, **channels, Z=np.where(hit, 500 + shift, zero), patch=np.where(hit, patch, -1))


def test_geometry_is_compared_where_both_hit_and_the_hit_masks_apart(tmp_path: Path):
    hit = np.zeros((100, 100), bool)
    hit[20:80, 20:80] = True
    patch = np.arange(10_000).reshape(100, 100) // 7
    golden = geometry(tmp_path / "a.exr", hit, patch)
    assert compare_files(golden, golden).passed

    moved = hit.copy()
    moved[20, 20:23] = False  # 0.08 % of the part: few pixels at the silhouette, far off in value
    few = compare_files(golden, geometry(tmp_path / "b.exr", moved, patch))
    channels = {channel.name: channel for channel in few.channels}
    assert few.passed
    assert (channels["hit"].differing, channels["Z"].compared, channels["Z"].max) == (3, 3597, 0)
    assert channels["hit"].compared == 3600
    assert channels["hit"].iou == pytest.approx(3597 / 3600)

    moved[20, 20:24] = False  # 0.11 %
    many = compare_files(golden, geometry(tmp_path / "c.exr", moved, patch))
    assert [reason.partition(":")[0] for reason in many.reasons] == ["hit"]


def test_geometry_has_a_threshold_of_its_own_and_patches_are_names(tmp_path: Path):
    hit = np.ones((100, 100), bool)
    patch = np.arange(10_000).reshape(100, 100)
    golden = geometry(tmp_path / "a.exr", hit, patch)
    assert compare_files(golden, geometry(tmp_path / "b.exr", hit, patch, shift=0.0005)).passed
    far = geometry(tmp_path / "c.exr", hit, patch, shift=0.002)
    assert not compare_files(golden, far).passed
    assert compare_files(golden, far, ComparisonThresholds(geometry_absolute=0.01)).passed
    renumbered = patch.copy()
    renumbered[0, :20] += 1
    result = compare_files(golden, geometry(tmp_path / "d.exr", hit, renumbered))
    assert len(result.reasons) == 1
    difference = next(channel for channel in result.channels if channel.name == "patch")
    assert (difference.differing, difference.max, difference.percentiles) == (20, None, None)


# ---- sets

HEADER = Manifest(kind="simulated", bit_depth=12, saturation_level=4080, lightopt="0.1.0")
PLACES = [("light1", Posture(0, 0)), ("light2", Posture(0, 0)), ("light1", Posture(0, 82))]


def image_set(folder: Path, *, header: Manifest = HEADER, places=PLACES, offset: float = 0.0, azimuth: float = 45.0):
    writer = ImageSetWriter(folder, header)
    writer.add_patches({"area": np.arange(5.0), "vertex": np.arange(3), "unit": np.array("mm")})
    for posture in dict.fromkeys(posture for _, posture in places):
        writer.add_geometry(posture, {"Z": np.full((40, 50), 500, np.float32), "N.X": np.ones((40, 50), np.float32)})
    for i, (light, posture) in enumerate(places):
        for exposure in (1.0, 0.25):
            sensor = np.minimum(LEVELS * exposure * 4095 / 255, 4095).astype(np.uint16)
            linear = {"Y": LEVELS + np.float32(offset if i == 0 else 0)}
            entry = ImageEntry(light, 60, azimuth, posture, exposure)
            writer.add_image(entry, png=sensor, exr=linear if exposure == 1 else None)
    return folder


@pytest.fixture
def golden(tmp_path: Path) -> Path:
    return image_set(tmp_path / "golden")


def test_equal_sets_pass_and_every_file_is_compared_once(golden: Path, tmp_path: Path):
    new = image_set(tmp_path / "new")
    result = compare_sets(golden, new / "manifest.json")
    assert result.passed
    assert len(result.files) == 3 * 2 + 3 + 2 + 1
    assert (result.missing, result.extra, result.notes) == ((), (), ())
    json.dumps(result.as_dict(), allow_nan=False)
    png = next(file for file in result.files if file.a.endswith("light1.png"))
    expected = int((np.minimum(LEVELS * 4095 / 255, 4095).astype(np.uint16) >= 4080).sum())
    assert png.channels[0].saturated_a == expected


def test_a_difference_in_one_image_fails_and_names_it(golden: Path, tmp_path: Path):
    result = compare_sets(golden, image_set(tmp_path / "new", offset=1))
    assert [reason.partition(", EXR: ")[0] for reason in result.reasons] == ["light1 at posture (0°, 0°)"]
    assert [file.passed for file in result.files].count(False) == 1


def test_missing_images_fail_and_extra_ones_are_reported(golden: Path, tmp_path: Path):
    fewer = image_set(tmp_path / "fewer", places=PLACES[:2])
    result = compare_sets(golden, fewer)
    assert not result.passed
    assert result.missing == (
        "light1 at posture (0°, 82°), exposure 1, PNG",
        "light1 at posture (0°, 82°), EXR",
        "light1 at posture (0°, 82°), exposure 0.25, PNG",
        "geometry at posture (0°, 82°)",
    )
    assert result.reasons == ("new set lacks 1 of 2 postures (4 files): (0°, 82°)",)
    turned = compare_sets(fewer, golden)
    assert turned.passed
    assert turned.extra == result.missing
    assert turned.notes == ("only in the new set: 1 of 2 postures (4 files): (0°, 82°)",)


def test_an_image_that_is_missing_from_a_posture_is_named(golden: Path, tmp_path: Path):
    result = compare_sets(golden, image_set(tmp_path / "fewer", places=[PLACES[0], PLACES[2]]))
    assert result.reasons[0] == "new set lacks light2 at posture (0°, 0°), exposure 1, PNG"
    assert len(result.reasons) == 3


def test_sets_of_other_postures_say_it_once(golden: Path, tmp_path: Path):
    other = image_set(tmp_path / "other", places=[(light, Posture(10, 20)) for light, _ in PLACES[:2]])
    result = compare_sets(golden, other)
    assert result.reasons == ("new set lacks 2 of 2 postures (11 files): (0°, 0°), (0°, 82°)",)
    assert result.notes == ("only in the new set: 1 of 1 posture (7 files): (10°, 20°)",)


def test_a_set_that_is_not_there_is_wrong_input(golden: Path, tmp_path: Path):
    for pair, role in (((tmp_path / "no", golden), "golden set"), ((golden, tmp_path / "no"), "new set")):
        with pytest.raises(InputError) as refused:
            compare_sets(*pair)
        assert [message.partition(":")[0] for message in refused.value.messages] == [role]
    with pytest.raises(InputError) as refused:
        compare_sets(tmp_path / "no", tmp_path / "no")
    assert len(refused.value.messages) == 2


def test_deleted_and_changed_files_fail(golden: Path, tmp_path: Path):
    new = tmp_path / "new"
    shutil.copytree(golden, new)
    (new / "posture_0_0/light2.png").unlink()
    (golden / "posture_0_82/geometry.exr").unlink()
    write_npz_atomic(new / "patches.npz", {"area": np.arange(5.0), "vertex": np.arange(3), "unit": np.array("m")})
    reasons = "\n".join(compare_sets(golden, new).reasons)
    assert "light2 at posture (0°, 0°), exposure 1, PNG: new file is missing" in reasons
    assert "geometry at posture (0°, 82°): golden file is missing" in reasons
    assert f"new file changed since its manifest was written: {new / 'patches.npz'}" in reasons
    assert "patch table: unit: different texts" in reasons


def test_empty_golden_fails(tmp_path: Path):
    ImageSetWriter(tmp_path / "a", HEADER)
    assert "lists no files" in compare_sets(tmp_path / "a", tmp_path / "a").reasons[0]


@pytest.mark.parametrize(
    ("arrays", "reason"),
    [
        ({"area": np.arange(5.0) + 0.01, "vertex": np.arange(3), "unit": np.array("mm")}, "area: 100.000% of values"),
        ({"area": np.arange(5.0), "vertex": np.arange(3) + 1, "unit": np.array("mm")}, "vertex: 100.000%"),
        ({"area": np.arange(4.0), "vertex": np.arange(3), "unit": np.array("mm")}, "area: golden float64 (5,), new"),
        ({"area": np.arange(5.0)}, "different arrays"),
        (None, "no readable .npz"),
    ],
)
def test_patch_tables_are_compared(golden: Path, tmp_path: Path, arrays: dict | None, reason: str):
    writer = ImageSetWriter(tmp_path / "new", HEADER)
    writer.add_patches(arrays or {})
    if arrays is None:
        (tmp_path / "new/patches.npz").write_bytes(b"PK\x03\x04 no table")
    reasons = compare_sets(golden, tmp_path / "new").reasons
    assert any(text.startswith("patch table: ") and reason in text for text in reasons), reasons


def test_other_bit_depth_full_scale_or_light_position_fail_and_other_inputs_are_noted(golden: Path, tmp_path: Path):
    other = image_set(tmp_path / "new", header=replace(HEADER, full_scale=100, saturation_level=4000), azimuth=46)
    result = compare_sets(golden, other)
    reasons = "\n".join(result.reasons)
    assert "different full_scale: golden 255, new 100" in reasons
    assert "light1 stood elsewhere" in reasons
    assert result.notes == ("different saturation_level: golden 4080, new 4000",)


# ---- picture


def test_difference_picture_shows_sign_scale_and_saturation(tmp_path: Path):
    a = np.full((20, 20), 250.0)
    b = a.copy()
    b[0, 0], b[0, 1], b[0, 2], b[0, 3] = 254.5, 245.5, 250.5, np.nan
    a[1, 0], b[1, 1] = 255.25, 255.25
    exr(tmp_path / "a.exr", Y=a), exr(tmp_path / "b.exr", Y=b)
    assert difference_picture(tmp_path / "a.exr", tmp_path / "b.exr", tmp_path / "d.png") == 5.25
    picture = read_png(tmp_path / "d.png", colour=True).astype(int)
    red, blue, weak, black = picture[0, 0], picture[0, 1], picture[0, 2], picture[0, 3]
    assert red[0] > red[2] + 100
    assert blue[2] > blue[0] + 100
    assert weak.min() > 220
    assert weak[0] > weak[2]
    assert black.tolist() == [0, 0, 0]
    assert len({tuple(picture[1, 0]), tuple(picture[1, 1]), tuple(picture[5, 5]), tuple(red), tuple(blue)}) == 5
    metadata = read_metadata(tmp_path / "d.png")
    assert (metadata["scale"], metadata["channel"]) == (5.25, "Y")
    assert (metadata["beyond_scale"], metadata["only_golden"], metadata["only_new"]) == (0, 1, 1)
    assert "5.25 and above" in metadata["colours"]


def test_scale_of_the_picture_follows_the_differences_there_are(tmp_path: Path):
    a = np.zeros((100, 100))
    b = a.copy()
    b.flat[:100] = np.linspace(1, 100, 100)
    exr(tmp_path / "a.exr", Y=a), exr(tmp_path / "b.exr", Y=b)
    scale = difference_picture(tmp_path / "a.exr", tmp_path / "b.exr", tmp_path / "d.png")
    assert scale == pytest.approx(99.9, abs=0.1)
    assert difference_picture(tmp_path / "a.exr", tmp_path / "a.exr", tmp_path / "e.png") == 0.05
    assert (read_png(tmp_path / "e.png", colour=True) == 247).all()


def test_difference_picture_of_pngs_and_of_geometry(tmp_path: Path):
    write_png(tmp_path / "a.png", np.zeros((4, 4), np.uint8), metadata={})
    write_png(tmp_path / "b.png", np.full((4, 4), 255, np.uint8), metadata={})
    assert difference_picture(tmp_path / "a.png", tmp_path / "b.png", tmp_path / "d.png") == 255
    assert read_metadata(tmp_path / "d.png")["only_new"] == 16
    a = exr(tmp_path / "a.exr", Z=LEVELS, patch=LEVELS)
    difference_picture(a, a, tmp_path / "e.png")
    assert read_metadata(tmp_path / "e.png")["channel"] == "Z"


def test_differences_that_cannot_be_shown_are_errors(tmp_path: Path):
    a = exr(tmp_path / "a.exr", Y=LEVELS)
    for other, reported in (
        (exr(tmp_path / "b.exr", Y=LEVELS[1:]), "no difference to show"),
        (exr(tmp_path / "c.exr", L=LEVELS), "no channel"),
        (tmp_path / "missing.exr", "cannot be read"),
    ):
        with pytest.raises(InputError, match=reported):
            difference_picture(a, other, tmp_path / "d.png")
    assert not (tmp_path / "d.png").exists()
