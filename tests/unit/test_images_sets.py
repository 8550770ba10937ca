"""Image sets: the manifest's contract, resuming, interruption at any moment, reading foreign sets."""

from __future__ import annotations

import copy
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.images import (
    ImageEntry,
    ImageSet,
    ImageSetWriter,
    Manifest,
    SourceFile,
    png_name,
    read_image_set,
    read_manifest,
    read_metadata,
    write_exr,
    write_png,
)
from lightopt.images._manifest import exr_name, geometry_name, parse_manifest

HEADER = Manifest(
    kind="simulated",
    bit_depth=8,
    full_scale=255,
    saturation_level=250,
    black_level=2,
    lightopt="0.1.0",
    rig=SourceFile("rig.yaml", "a" * 64),
    part=SourceFile("part.yaml", "b" * 64),
    provenance={"options": {"points": 4, "layers": ("diffuse", "specular"), "noise": None}},
    warnings=("12 duplicate vertices merged",),
)
POSTURES = (Posture(0, 0), Posture(-10, 82.5))
LIGHTS = ("light1", "light2")
EXPOSURES = (1.0, 0.0625)
PLAN = [(light, posture, exposure) for posture in POSTURES for light in LIGHTS for exposure in EXPOSURES]


def entry_of(light: str, posture: Posture, exposure: float) -> ImageEntry:
    return ImageEntry(light, 60.0, 45.0 + 90 * LIGHTS.index(light), posture, exposure)


@pytest.mark.parametrize(
    ("capture", "held"),
    [
        ({"exposure_us": {"requested": 500.0, "read": 501.0}}, 0.0625 * 501 / 500),
        ({"exposure_us": {"requested": 500.0, "read": 500.0}}, 0.0625),
        ({"exposure_us": {"requested": 0, "read": 501.0}}, 0.0625),
        ({"exposure_us": {"requested": 500.0}}, 0.0625),
        ({"exposure_us": "long"}, 0.0625),
        ("of others", 0.0625),
        (None, 0.0625),
    ],
)
def test_the_exposure_that_was_held(capture: Any, held: float) -> None:
    entry = replace(entry_of("light1", POSTURES[0], 0.0625), extra={"capture": capture})
    assert entry.held_exposure == held
    assert entry.key[2] == entry.exposure == 0.0625


def linear_of(light: str, posture: Posture) -> np.ndarray:
    seed = [LIGHTS.index(light), POSTURES.index(posture)]
    return np.random.default_rng(seed).uniform(0, 4000, (6, 5)).astype(np.float32)


def sensor_of(light: str, posture: Posture, exposure: float) -> np.ndarray:
    return np.clip(np.floor(2.5 + exposure * linear_of(light, posture)), 0, 255).astype(np.uint8)


def run(folder: Path, *, header: Manifest = HEADER, force: bool = False) -> int:
    """A renderer in small: makes what is not done; returns how many files it made."""
    writer = ImageSetWriter(folder, header, force=force, plan=PLAN)
    made = 0
    if not writer.file_done():
        writer.add_patches({"area": np.arange(4.0)})
        made += 1
    for posture in POSTURES:
        if not writer.geometry_done(posture):
            writer.add_geometry(posture, {"Z": np.ones((6, 5), np.float32)})
            made += 1
        for light in LIGHTS:
            for i, exposure in enumerate(EXPOSURES):
                if writer.done(light, posture, exposure):
                    continue
                linear = {"Y": linear_of(light, posture)} if i == 0 else None
                sensor = sensor_of(light, posture, exposure)
                writer.add_image(entry_of(light, posture, exposure), png=sensor, exr=linear)
                made += 1
    writer.add_warnings(["part leaves the view by 3 px", "12 duplicate vertices merged"])
    return made


def content(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("set") / "deep" / "out"
    assert run(folder) == 11
    return folder


def test_set_has_the_files_and_the_manifest_of_the_contract(whole: Path):
    assert set(content(whole)) == {"manifest.json", "patches.npz"} | {
        f"{folder}/{name}"
        for folder in ("posture_0_0", "posture_-10_82.5")
        for name in (
            *("light1.png", "light1_x0.0625.png", "light1.exr"),
            *("light2.png", "light2_x0.0625.png", "light2.exr", "geometry.exr"),
        )
    }
    data = json.loads((whole / "manifest.json").read_text())
    assert list(data) == [
        *("format", "kind", "lightopt", "bit_depth", "full_scale", "saturation_level", "black_level"),
        *("rig", "part", "provenance", "images", "geometry", "patches", "files", "warnings"),
    ]
    assert data["format"] == "lightopt-images/1"
    assert data["rig"] == {"file": "rig.yaml", "sha256": "a" * 64}
    assert data["warnings"] == ["12 duplicate vertices merged", "part leaves the view by 3 px"]
    image = data["images"][1]
    assert image == {
        "light": "light1",
        "light_elevation_deg": 60.0,
        "light_azimuth_deg": 45.0,
        "posture": {"elevation_deg": 0, "rotation_deg": 0},
        "exposure": 0.0625,
        "png": "posture_0_0/light1_x0.0625.png",
        "exr": "posture_0_0/light1.exr",
        "sha256": {"exr": data["images"][0]["sha256"]["exr"], "png": image["sha256"]["png"]},
    }
    assert data["geometry"][1]["exr"] == "posture_-10_82.5/geometry.exr"


def test_files_say_what_they_are(whole: Path):
    png = read_metadata(whole / "posture_0_0/light1_x0.0625.png")
    assert (png["light"], png["exposure"], png["saturation_level"], png["bit_depth"]) == ("light1", 0.0625, 250, 8)
    exr = read_metadata(whole / "posture_0_0/light1.exr")
    assert (exr["light"], exr["full_scale"], exr["posture"]) == ("light1", 255, {"elevation_deg": 0, "rotation_deg": 0})
    assert "exposure" not in exr


def test_manifest_reads_back_as_it_was_written(whole: Path):
    manifest = read_manifest(whole / "manifest.json")
    assert manifest.to_json() == (whole / "manifest.json").read_text(encoding="utf-8")
    assert [image.key for image in manifest.images] == PLAN


def test_a_set_is_another_once_an_image_was_edited(whole: Path, tmp_path: Path):
    """Whatever hash the manifest has of it; and only what is read counts: of an image with a PNG, not its EXR."""
    folder = tmp_path / "copy"
    shutil.copytree(whole, folder)
    images = read_image_set(folder)
    before = images.fingerprint
    assert before == read_image_set(whole).fingerprint
    (folder / "posture_0_0/light2.exr").write_bytes(b"edited")
    assert ImageSet(folder, images.manifest).fingerprint == before
    assert images.images[0].png is not None
    images.path(images.images[0].png).write_bytes(b"edited")
    edited = ImageSet(folder, images.manifest).fingerprint
    assert edited != before
    assert edited["manifest_sha256"] == before["manifest_sha256"]
    images.path(images.images[0].png).unlink()
    assert ImageSet(folder, images.manifest).fingerprint not in (before, edited)


def test_same_run_elsewhere_gives_the_same_bytes(whole: Path, tmp_path: Path):
    run(tmp_path)
    assert content(tmp_path) == content(whole)


def test_finished_run_repeated_makes_nothing_and_changes_nothing(whole: Path):
    before = content(whole)
    assert run(whole) == 0
    assert content(whole) == before
    moved = replace(HEADER, rig=SourceFile("elsewhere/rig.yaml", "a" * 64))
    assert run(whole, header=moved) == 0, "the rig is known by its content, not by its name"


def test_damaged_and_deleted_files_are_made_again_and_nothing_else(whole: Path, tmp_path: Path):
    folder = tmp_path / "copy"
    shutil.copytree(whole, folder)
    (folder / "posture_0_0/light2.png").unlink()
    (folder / "posture_-10_82.5/geometry.exr").write_bytes(b"damaged")
    assert run(folder) == 2
    assert content(folder) == content(whole)


class Killed(BaseException):
    """Stands for kill -9: nothing cleans up after it."""


@pytest.mark.slow
def test_run_killed_at_any_write_leaves_a_valid_set_and_resumes_to_the_same_bytes(whole, tmp_path, monkeypatch):
    replace_file, unlink = os.replace, Path.unlink
    writes = 1 + 2 * 11 + 8 // 2 + 1  # manifest; file and manifest each; an EXR for every second image; warnings
    for kill_at in range(writes):
        for before in (True, False):
            folder = tmp_path / f"{kill_at}{before}"
            count = 0

            def dying(source: str, target: str, kill_at: int = kill_at, before: bool = before) -> None:
                nonlocal count
                if not (count == kill_at and before):
                    replace_file(source, target)
                count += 1
                if count == kill_at + 1:
                    raise Killed

            monkeypatch.setattr(os, "replace", dying)
            monkeypatch.setattr(Path, "unlink", lambda *args, **kwargs: None)
            with pytest.raises(Killed):
                run(folder)
            monkeypatch.setattr(os, "replace", replace_file)
            monkeypatch.setattr(Path, "unlink", unlink)
            if (folder / "manifest.json").exists():
                read_image_set(folder, verify=True)
            else:
                assert kill_at == 0
            run(folder)
            assert content(folder) == content(whole), f"killed at write {kill_at}"


def test_ctrl_c_leaves_no_temporary_file(tmp_path: Path, monkeypatch):
    calls = []

    def interrupted(fd: int) -> None:
        calls.append(fd)
        if len(calls) == 6:
            raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path)
    assert not list(tmp_path.rglob("*.partial"))
    read_image_set(tmp_path)


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        ({"part": SourceFile("part.yaml", "c" * 64)}, r"part\.sha256: another content"),
        ({"provenance": {"options": {**HEADER.options, "points": 9}}}, r"options\.points: previously 4, now 9"),
        (
            {"provenance": {"options": {**HEADER.options, "falloff": "none"}}},
            r'options\.falloff: previously absent, now "none"',
        ),
        ({"lightopt": "0.2.0"}, r'lightopt: previously "0.1.0", now "0.2.0"'),
        ({"bit_depth": 12}, "bit_depth: previously 8, now 12"),
        ({"rig": None}, "rig: previously absent, now null"),
    ],
)
def test_set_of_another_run_is_refused_and_left_alone(whole: Path, change: dict[str, Any], reported: str):
    before = content(whole)
    with pytest.raises(InputError, match=reported) as caught:
        ImageSetWriter(whole, replace(HEADER, **change))
    assert "option 'force'" in str(caught.value)
    assert content(whole) == before


def test_force_replaces_the_set_of_another_run(whole: Path, tmp_path: Path):
    run(tmp_path, header=replace(HEADER, lightopt="0.0.9"))
    ImageSetWriter(tmp_path, HEADER, force=True, plan=PLAN)
    assert read_manifest(tmp_path / "manifest.json").images == ()
    assert run(tmp_path) == 11
    assert content(tmp_path) == content(whole)


def test_damaged_manifest_needs_force(tmp_path: Path):
    (tmp_path / "manifest.json").write_text('{"format": ')
    with pytest.raises(InputError, match=r"manifest\.json:1: not valid JSON") as caught:
        run(tmp_path)
    assert "option 'force'" in str(caught.value)
    assert run(tmp_path, force=True) == 11


def test_files_that_belong_to_no_set_are_in_the_way_before_any_work(tmp_path: Path):
    (tmp_path / "posture_0_0").mkdir()
    (tmp_path / "posture_0_0/light2.exr").write_text("mine")
    (tmp_path / "notes.txt").write_text("unrelated")
    with pytest.raises(InputError, match=r"light2\.exr: exists but belongs to no image set; use option 'force'"):
        run(tmp_path)
    assert set(content(tmp_path)) == {"posture_0_0/light2.exr", "notes.txt"}
    run(tmp_path, force=True)
    assert (tmp_path / "notes.txt").read_text() == "unrelated"


def test_files_in_the_way_of_an_unplanned_run_are_refused_when_met(tmp_path: Path):
    (tmp_path / "patches.npz").write_text("mine")
    writer = ImageSetWriter(tmp_path, HEADER)
    with pytest.raises(InputError, match=r"patches\.npz: exists"):
        writer.add_patches({"area": np.zeros(1)})
    assert (tmp_path / "patches.npz").read_text() == "mine"


def test_folder_that_cannot_be_made_is_reported_before_any_work(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be made"):
        ImageSetWriter(tmp_path / "file" / "out", HEADER)


def test_read_only_folder_is_reported_before_any_work(read_only_folder: Path):
    with pytest.raises(InputError, match="denied"):
        ImageSetWriter(read_only_folder, HEADER)


@pytest.mark.parametrize(
    "keys",
    [
        [("a", POSTURES[0], 1.0), ("A", POSTURES[0], 1.0)],
        [("a_x2", POSTURES[0], 1.0), ("a", POSTURES[0], 2.0)],
        [("geometry", POSTURES[0], 1.0)],
    ],
)
def test_names_that_clash_are_refused_before_any_work(tmp_path: Path, keys: list):
    with pytest.raises(InputError, match="would both be written"):
        ImageSetWriter(tmp_path, HEADER, plan=keys)
    assert content(tmp_path) == {}


def test_names_are_stable_and_short():
    assert png_name("l", Posture(-0.0, 360.0), 1) == "posture_0_360/l.png"
    assert png_name("l", Posture(12.5, 1e-7), 1 / 16) == "posture_12.5_0.0000001/l_x0.0625.png"
    assert exr_name("l", Posture(1e3, 0.1 + 0.2)) == "posture_1000_0.30000000000000004/l.exr"
    assert geometry_name(Posture(0, 82)) == "posture_0_82/geometry.exr"


def test_an_exr_written_last_belongs_to_all_exposures(tmp_path: Path):
    """A captured set: exposures one after the other, the linear image made of them at the end."""
    writer = ImageSetWriter(tmp_path, replace(HEADER, kind="captured"))
    for exposure in EXPOSURES:
        writer.add_image(entry_of("light1", POSTURES[0], exposure), png=sensor_of("light1", POSTURES[0], exposure))
    linear = {"Y": linear_of("light1", POSTURES[0]), "valid": np.ones((6, 5), np.float32)}
    last = entry_of("light1", POSTURES[0], 1.0)
    listed = writer.add_image(last, png=sensor_of("light1", POSTURES[0], 1.0), exr=linear)
    images = read_image_set(tmp_path).images
    assert [image.exposure for image in images] == list(EXPOSURES)
    assert {image.exr for image in images} == {listed.exr} == {"posture_0_0/light1.exr"}


def test_further_files_are_listed_and_stay_inside(tmp_path: Path):
    writer = ImageSetWriter(tmp_path, HEADER)
    writer.add_file("sheets/contact.html", "<p>größe</p>")
    assert writer.file_done("sheets/contact.html")
    writer.add_file("sheets/contact.html", "again")
    assert (tmp_path / "sheets/contact.html").read_text() == "again"
    assert set(read_image_set(tmp_path).manifest.files) == {"sheets/contact.html"}
    for name in ("../a", "/a", "C:/a", "a\\b", "", "."):
        with pytest.raises(InputError, match="expected"):
            writer.add_file(name, b"")
    with pytest.raises(InputError, match="would both be written"):
        writer.add_file("manifest.json", b"")


@pytest.mark.parametrize(
    ("header", "png"),
    [
        (HEADER, np.zeros((2, 2), np.uint16)),
        (replace(HEADER, bit_depth=12, saturation_level=None), np.zeros((2, 2), np.uint8)),
        (replace(HEADER, bit_depth=12, saturation_level=None), np.full((2, 2), 4096, np.uint16)),
        (HEADER, None),
    ],
)
def test_levels_that_do_not_fit_the_bit_depth_are_refused(tmp_path: Path, header: Manifest, png):
    writer = ImageSetWriter(tmp_path, header)
    with pytest.raises(InputError, match="light1"):
        writer.add_image(entry_of("light1", POSTURES[0], 1.0), png=png)
    assert set(content(tmp_path)) == {"manifest.json"}


def test_loaded_png_is_linear_at_exposure_1_and_knows_what_is_saturated(whole: Path):
    images = read_image_set(whole)
    entry = images.images[1]
    loaded = images.load(entry)
    sensor = sensor_of("light1", POSTURES[0], 0.0625)
    assert np.array_equal(loaded.sensor, sensor)
    assert np.allclose(loaded.levels, (sensor.astype(float) - 2) * 255 / (255 * 0.0625), rtol=1e-6)
    assert np.array_equal(loaded.saturated, sensor >= 250)
    assert loaded.saturated.any()
    lit = ~loaded.saturated
    assert np.abs(loaded.levels - linear_of("light1", POSTURES[0]))[lit].max() <= 0.5 / 0.0625 + 1e-3
    with pytest.raises(ValueError, match="read-only"):
        loaded.levels[0, 0] = 1


def test_loaded_exr_is_used_only_without_png(tmp_path: Path):
    linear = np.array([[0, 100, 3951, 3952.1, 1e6]], np.float32)
    writer = ImageSetWriter(tmp_path, HEADER)
    entry = writer.add_image(entry_of("light1", POSTURES[0], 0.0625), exr={"Y": linear})
    loaded = read_image_set(tmp_path).load(entry)
    assert loaded.sensor is None
    assert np.array_equal(loaded.levels, linear)
    # 0.0625 · 3951 + 2 = 248.94 → 249; 0.0625 · 3952.1 + 2 = 249.006 → 249; 1e6 clips to 255
    assert loaded.saturated.tolist() == [[False, False, False, False, True]]
    valid = np.array([[1, 1, 1, 0, 1]], np.float32)
    entry = writer.add_image(entry_of("light2", POSTURES[0], 1.0), exr={"Y": linear, "valid": valid})
    assert read_image_set(tmp_path).load(entry).saturated.tolist() == [[False, False, False, True, False]]
    entry = writer.add_image(entry_of("light2", POSTURES[1], 1.0), exr={"L": linear})
    with pytest.raises(InputError, match="expected a channel Y, found L"):
        read_image_set(tmp_path).load(entry)


FOREIGN: dict[str, Any] = {
    "format": "lightopt-images/1",
    "kind": "captured",
    "bit_depth": 12,
    "camera": "somebody's",
    "images": [
        {
            "light": "ring",
            "light_elevation_deg": 45,
            "light_azimuth_deg": 0,
            "posture": {"elevation_deg": 0, "rotation_deg": 0},
            "exposure": 2,
            "png": "frames/ring.png",
            "operator": "me",
        }
    ],
}


def foreign(folder: Path, levels: np.ndarray) -> Path:
    (folder / "frames").mkdir()
    write_png(folder / "frames/ring.png", levels, metadata={})
    path = folder / "manifest.json"
    path.write_text(json.dumps(FOREIGN))
    return path


def test_foreign_set_with_only_what_is_required_is_read_from_folder_or_manifest(tmp_path: Path):
    levels = np.array([[0, 2000, 4095]], np.uint16)
    path = foreign(tmp_path, levels)
    for given in (tmp_path, path, str(path)):
        images = read_image_set(given)
        loaded = images.load(images.images[0])
        assert np.allclose(loaded.levels, levels.astype(float) * 255 / 4095 / 2)
        assert loaded.saturated.tolist() == [[False, False, True]]
    assert images.manifest.extra == {"camera": "somebody's"}
    assert images.images[0].extra == {"operator": "me"}
    assert images.manifest.as_dict()["camera"] == "somebody's"


def test_left_aligned_levels_are_reported(tmp_path: Path):
    foreign(tmp_path, np.array([[0, 65520]], np.uint16))
    images = read_image_set(tmp_path)
    with pytest.raises(InputError, match=r"expected right-aligned levels of 12 bits .*found uint16 up to 65520"):
        images.load(images.images[0])


def test_eight_bit_container_of_twelve_bits_is_reported(tmp_path: Path):
    foreign(tmp_path, np.array([[0, 255]], np.uint8))
    images = read_image_set(tmp_path)
    with pytest.raises(InputError, match="found uint8"):
        images.load(images.images[0])


@pytest.mark.parametrize(
    ("keys", "value", "reported"),
    [
        (["format"], None, "format: expected text, found nothing"),
        (["format"], "lightopt-images/2", "format: expected lightopt-images/1, found 'lightopt-images/2'"),
        (["kind"], None, "kind: expected text"),
        (["kind"], "drawn", 'kind: expected simulated or captured, found "drawn"'),
        (["bit_depth"], None, "bit_depth: expected a number above 0 up to 16, found nothing"),
        (["bit_depth"], 17, "bit_depth: expected a number above 0 up to 16, found 17"),
        (["bit_depth"], 8.5, "bit_depth: expected a whole number, found 8.5"),
        (["bit_depth"], True, "bit_depth: expected a number"),
        (["saturation_level"], 5000, "saturation_level: expected a number above 0 up to 4095, found 5000"),
        (["full_scale"], 0, "full_scale: expected a number above 0, found 0"),
        (["images"], None, "images: expected a list, found nothing"),
        (["images"], {}, "images: expected a list"),
        (["images", 0], 5, "images[0]: expected an object, found 5"),
        (["images", 0, "light"], None, "images[0].light: expected text, found nothing"),
        (["images", 0, "light_elevation_deg"], "60", 'images[0].light_elevation_deg: expected a number, found "60"'),
        (["images", 0, "light_azimuth_deg"], None, "images[0].light_azimuth_deg: expected a number"),
        (["images", 0, "posture"], None, "images[0].posture: expected an object, found nothing"),
        (["images", 0, "posture"], {}, "images[0].posture.elevation_deg: expected a number, found nothing"),
        (["images", 0, "posture", "rotation_deg"], None, "images[0].posture.rotation_deg: expected a number"),
        (["images", 0, "exposure"], None, "images[0].exposure: expected a number above 0, found nothing"),
        (["images", 0, "exposure"], 0, "images[0].exposure: expected a number above 0, found 0"),
        (["images", 0, "png"], None, "images[0]: expected png or exr"),
        (["images", 0, "png"], "../ring.png", "images[0].png: expected a file inside the manifest's folder"),
        (["images", 0, "png"], "/ring.png", "images[0].png: expected a path relative to the manifest's folder"),
        (["images", 0, "png"], "C:/ring.png", "images[0].png: expected a path relative to the manifest's folder"),
        (["images", 0, "png"], "a\\b.png", "images[0].png: expected forward slashes"),
        (["images", 0, "png"], "a/../../b.png", "images[0].png: expected a file inside the manifest's folder"),
        (["images", 0, "sha256"], ["x"], "images[0].sha256: expected an object"),
        (["geometry"], [{"posture": {"elevation_deg": 0, "rotation_deg": 0}}], "geometry[0].exr: expected a file"),
        (["patches"], "../p.npz", "patches: expected a file inside"),
        (["files"], {"../p.npz": "0"}, "files: expected a file inside"),
        (["rig"], {"file": "rig.yaml"}, "rig.sha256: expected text, found nothing"),
        (["provenance"], [1], "provenance: expected an object"),
        (["warnings"], [1], "warnings: expected a list of texts"),
    ],
)
def test_wrong_manifests_are_refused_by_file_and_key(keys: list, value: object, reported: str):
    data = copy.deepcopy(FOREIGN)
    place: Any = data
    for key in keys[:-1]:
        place = place[key]
    if value is None and isinstance(keys[-1], str):
        place.pop(keys[-1], None)
    else:
        place[keys[-1]] = value
    with pytest.raises(InputError) as caught:
        parse_manifest(data, path="set/manifest.json")
    assert any(f"set/manifest.json: {reported}" in message for message in caught.value.messages), caught.value.messages


def test_all_problems_of_a_manifest_are_reported_at_once_and_duplicates_among_them():
    data = copy.deepcopy(FOREIGN)
    data["images"].append(copy.deepcopy(data["images"][0]))
    data["bit_depth"], data["kind"] = 99, "drawn"
    with pytest.raises(InputError) as caught:
        parse_manifest(data, path="m.json")
    assert len(caught.value.messages) == 3
    assert any("images[1]: expected each light, posture and exposure once" in m for m in caught.value.messages)


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("", ":1: not valid JSON"),
        ('{\n"a": 1,\n}', ":3: not valid JSON"),
        ('{"bit_depth": NaN}', "NaN is not a number of JSON"),
        ("[1]", "manifest: expected an object"),
        ("[" * 100_000, "not valid JSON"),
        (b"\xff\xfe", "not text; expected an image set"),
    ],
)
def test_manifests_that_are_no_json_are_reported(tmp_path: Path, text: str | bytes, reported: str):
    path = tmp_path / "manifest.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=reported):
        read_manifest(path)


def test_missing_and_changed_files_are_reported_all_at_once(whole: Path, tmp_path: Path):
    folder = tmp_path / "copy"
    shutil.copytree(whole, folder)
    (folder / "posture_0_0/light1.png").unlink()
    (folder / "posture_0_0/geometry.exr").write_bytes(b"changed")
    (folder / "patches.npz").unlink()
    with pytest.raises(InputError) as caught:
        read_image_set(folder)
    assert len(caught.value.messages) == 3
    assert "light1.png: missing" in str(caught.value)
    assert "geometry.exr: changed since it was listed" in str(caught.value)
    assert len(read_image_set(folder, verify=False).images) == 8


def test_folder_without_a_set_is_reported(tmp_path: Path):
    with pytest.raises(InputError, match=r"no manifest\.json, which says what each picture shows"):
        read_image_set(tmp_path)
    (tmp_path / "images").mkdir()
    with pytest.raises(InputError, match='imags: no such folder; expected an image set; did you mean "images"'):
        read_image_set(tmp_path / "imags")


def test_geometry_is_read_by_channel(whole: Path):
    images = read_image_set(whole)
    assert (images.load_geometry(images.geometry[0])["Z"] == 1).all()


def test_file_of_an_image_that_vanished_is_reported_on_loading(tmp_path: Path):
    writer = ImageSetWriter(tmp_path, HEADER)
    entry = writer.add_image(entry_of("light1", POSTURES[0], 1.0), png=np.zeros((2, 2), np.uint8))
    images = read_image_set(tmp_path)
    (tmp_path / entry.png).unlink()
    with pytest.raises(InputError, match=r"light1\.png: cannot be read"):
        images.load(entry)


def test_exr_written_by_hand_is_found_without_hash(tmp_path: Path):
    (tmp_path / "a").mkdir()
    write_exr(tmp_path / "a/b.exr", {"Y": np.ones((2, 2), np.float32)}, metadata={})
    data = copy.deepcopy(FOREIGN)
    data["images"][0] |= {"exr": "a/b.exr"}
    del data["images"][0]["png"]
    (tmp_path / "manifest.json").write_text(json.dumps(data))
    images = read_image_set(tmp_path)
    assert images.load(images.images[0]).sensor is None
