"""``lightopt import`` of wrong inputs: what is wrong, where, and what to do."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

K = "500 0 39.5\n0 500 29.5\n0 0 1\n"
LIGHTS = "image,light,x,y,z\none.png,a,0,0,1\ntwo.png,b,0.6,0,0.8\n"
POSE = "1 0 0 0\n0 -1 0 0\n0 0 -1 400\n"
KNOB = Path(__file__).resolve().parents[2] / "configs" / "parts" / "cover-knob.stl"
MESH = ("--mesh", KNOB, "--mesh-units", "mm")


@pytest.fixture
def folder(tmp_path):
    for name in ("one", "two"):
        Image.fromarray(np.full((60, 80), 90, np.uint8)).save(tmp_path / f"{name}.png")
    (tmp_path / "K.txt").write_text(K)
    (tmp_path / "pose.txt").write_text(POSE)
    (tmp_path / "lights.csv").write_text(LIGHTS)
    return tmp_path


@pytest.fixture
def refused(cli, folder):
    """Import with some files changed, and the lines of the error."""

    def run(*options, **files):
        for name, text in files.items():
            (folder / name.replace("_", ".")).write_text(text)
        options = (*options, *(() if {"--sphere", "--mesh"} & set(options) else MESH))
        if "--camera" not in options:
            options += ("--camera", folder / "K.txt")
        if "--pose" not in options and "--sphere" not in options:
            options += ("--pose", folder / "pose.txt")
        ran = cli("import", folder, folder / "lights.csv", "-o", folder / "set", *options)
        assert ran.status == 2, ran.out + ran.err
        assert not list((folder / "set").glob("*")), "nothing is left"
        return [line for line in ran.err.splitlines() if line.startswith("error: ")]

    return run


def test_the_folder_is_good(cli, folder):
    pose = ("--pose", folder / "pose.txt")
    arguments = ("import", folder, folder / "lights.csv", "--camera", folder / "K.txt", *MESH, "-o", folder / "set")
    ran = cli(*arguments, *pose)
    assert ran.status == 0, ran.err


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("image,light\none.png,a\n", ["lights.csv:1", "x_mm"]),
        ("image,light,x,y,z,exposuer\none.png,a,0,0,1,1\n", ["lights.csv:1", "exposuer", "exposure"]),
        (LIGHTS + ",c,0,0,1\n", ["lights.csv:4", '"c" without an image']),
        (LIGHTS + "three.png,c,,,\n", ["lights.csv:4", "an image without light"]),
        (LIGHTS + "three.png,c,0,0,1\n", ["lights.csv:4", "three.png", "cannot be read"]),
        (LIGHTS + "one.png,c,0,0,1\n", ["lights.csv:4", "one.png is already in", "lights.csv:2"]),
        (LIGHTS.replace("0.6,0,0.8", "60,0,80"), ["lights.csv:3", "length 1", "x_mm"]),
        (LIGHTS.replace("0.6", "0,6"), ["lights.csv:3", "as many cells"]),
        (LIGHTS.replace("0.6", "a"), ["lights.csv:3", "column x", '"a"']),
        (LIGHTS.replace(",b,", ",a,"), ["lights.csv:3", '"a" has another place', "lights.csv:2"]),
        (LIGHTS.replace(",b,", ",the left,"), ["lights.csv:3", "column light", '"the left"']),
        (LIGHTS.replace("0.8", "-0.8"), ["lights.csv:3", '"b" is below the part']),
        (LIGHTS.replace("0,1", "0,-1").replace("0.8", "-0.8"), ["all lights", "--turn-world", "x180"]),
        ("image,light,x,y,z,tilt_deg\none.png,a,0,0,1,flat\n", ["lights.csv:2", "column tilt_deg", '"flat"']),
        ("image,light,x,y,z,intensity\none.png,a,0,0,1,0\n", ["lights.csv:2", "column intensity", "above 0"]),
        ("image,light,x,y,z\n", ["a row per photograph"]),
    ],
)
def test_tables(refused, table, words):
    errors = refused(lights_csv=table)
    assert any(all(word in line for word in words) for line in errors), errors


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("500 0 39.5\n3 500 29.5\n0 0 1\n", ["expected K as fx, 0, cx"]),
        ("500 0 0\n0 500 0\n39.5 29.5 1\n", ["expected K as fx, 0, cx", "39.5, 29.5, 1"]),
        ("500 9 39.5\n0 500 29.5\n0 0 1\n", ["without skew", "500, 9, 39.5"]),
        ("500 0 39.5\n0 -500 29.5\n0 0 1\n", ["expected K as fx, 0, cx"]),
        ("500 0 39.5\n0 500\n0 0 1\n", ["expected numbers as text"]),
        ("500 0 39.5\nfocal\n0 0 1\n", ["expected numbers as text"]),
        ("500 0 390\n0 500 29.5\n0 0 1\n", ["principal point is outside"]),
        ("500 0 39.5\n0 500 29.5\n", ["3 × 3", "2 × 3"]),
        ("500 0 39.5\n0 nan 29.5\n0 0 1\n", ["finite"]),
    ],
)
def test_camera_matrices(refused, text, words):
    errors = refused(K_txt=text)
    assert any(all(word in line for word in ["K.txt", *words]) for line in errors), errors


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (POSE.replace("-1 0 0", "-2 0 0"), ["R is not a rotation"]),
        (POSE.replace("0 -1 0", "0 1 0"), ["left-handed"]),
        ("1 0 0 0\n0 1 0 0\n0 0 1 400\n", ["Z = -400 mm", "--turn-world"]),
        ("1 0 0\n0 1 0\n0 0 1\n", ["3 × 4"]),
        (POSE + "0 0 1 1\n", ["3 × 4", "4 × 4"]),
    ],
)
def test_poses(refused, folder, text, words):
    errors = refused("--pose", folder / "pose.txt", pose_txt=text)
    assert any(all(word in line for word in ["pose.txt", *words]) for line in errors), errors


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"K": None}, ["expected K", "dist"]),
        ({"dist": [0, 0, 0, 0, 0, 0.1, 0, 0]}, ["five coefficients"]),
        ({"fisheye_model": 1}, ["fisheye", "undistort"]),
        ({"image_width": 160, "image_height": 120}, ["160 × 120 px", "80 × 60 px"]),
        ({"R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "T": "here"}, ["T", "expected numbers"]),
        ({"R": [[1, 0, 0], [0, 1], [0, 0, 1]], "T": [0, 0, 400]}, ["R", "expected numbers"]),
        ({"R": None, "T": [0, 0, 400]}, ["rvec and tvec"]),
    ],
)
def test_calibration_files(refused, folder, values, words):
    good = {"K": [[500, 0, 39.5], [0, 500, 29.5], [0, 0, 1]], "dist": [0, 0, 0, 0]}
    (folder / "c.json").write_text(json.dumps({key: v for key, v in {**good, **values}.items() if v is not None}))
    errors = refused("--camera", folder / "c.json", *(("--pose", folder / "c.json") if "T" in values else ()))
    assert any(all(word in line for word in ["c.json", *words]) for line in errors), errors


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("c.yml", "%YAML:1.0\n---\nK: [1, 2\nb: 3\n", ["c.yml", "line 4"]),
        ("c.yml", "- 1\n", ["keys such as camera_matrix"]),
        ("c.yml", "K: !!python/name:os.system x\n", ["c.yml", "python"]),
        ("c.json", "{\n", ["c.json", "expected YAML or JSON"]),
        ("c.npz", "no archive", ["c.npz", "expected numbers"]),
        ("absent.txt", None, ["absent.txt", "cannot be read"]),
    ],
)
def test_unreadable_calibrations(refused, folder, name, text, words):
    if text is not None:
        (folder / name).write_text(text)
    errors = refused("--camera", folder / name)
    assert len(errors) == 1
    assert all(word in errors[0] for word in words), errors


def test_images(refused, folder):
    Image.fromarray(np.zeros((60, 40), np.uint8)).save(folder / "two.png")
    errors = refused()
    assert all(word in errors[0] for word in ("lights.csv:3", "two.png", "40 × 60 px", "80 × 60 px"))
    Image.fromarray(np.full((60, 80), 90, np.uint8)).save(folder / "two.png")
    Image.fromarray(np.zeros((60, 80), np.uint8)).save(folder / "mask.png")
    assert "all black" in refused("--mask", folder / "mask.png")[0]
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(np.zeros((60, 80), np.uint8)).save(folder / "two.jpg", exif=exif)
    errors = refused(lights_csv=LIGHTS.replace("two.png", "two.jpg"))
    assert "EXIF orientation 6" in errors[0]
    Image.fromarray(np.full((60, 80), 5000, np.uint16)).save(folder / "deep.png")
    errors = refused("--bits", "12", lights_csv="image,light,x,y,z\ndeep.png,a,0,0,1\n")
    assert "--bits: found levels up to 5000" in errors[0]


def test_masks_of_spheres(refused, folder):
    mask = np.zeros((60, 80), np.uint8)
    mask[10:50, 10:70] = 255
    Image.fromarray(mask).save(folder / "mask.png")
    assert "expected the disc of the sphere" in refused("--sphere", "5", "--mask", folder / "mask.png")[0]
    assert "--mask" in refused("--sphere", "5")[0]
    table = "image,light,x,y,z,rotation_deg\none.png,a,0,0,1,0\ntwo.png,a,0,0,1,90\n"
    assert "one posture" in refused("--sphere", "5", "--mask", folder / "mask.png", lights_csv=table)[0]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--turn-world", "180"), ["--turn-world", "x180"]),
        (("--sphere", "5", "--mesh", KNOB), ["--mesh", "--sphere"]),
        (("--bits", "12"), ["--bits", "16 bits"]),
        (("--mesh", "absent.stl", "--mesh-units", "mm"), ["absent.stl"]),
        (("--mesh", KNOB), ["--mesh-units", "cover-knob.stl"]),
    ],
)
def test_options(refused, options, words):
    errors = refused(*options)
    assert any(all(word in line for word in words) for line in errors), errors


def test_a_mask_that_the_part_does_not_fit(cli, folder):
    mask = np.zeros((60, 80), np.uint8)
    mask[:20, :20] = 255
    Image.fromarray(mask).save(folder / "mask.png")
    where = (folder, folder / "lights.csv", "-o", folder / "set", "--camera", folder / "K.txt", *MESH)
    ran = cli("import", *where, "--pose", folder / "pose.txt", "--mask", folder / "mask.png")
    assert ran.status == 0, ran.err
    assert "warning: mask and part overlap by" in ran.err


def test_other_images_of_the_folder_are_named(cli, folder):
    (folder / "lights.csv").write_text(LIGHTS.replace("two.png,b", "sub/two.png,b"))
    (folder / "sub").mkdir()
    Path(folder / "two.png").rename(folder / "sub" / "two.png")
    Image.fromarray(np.zeros((60, 80), np.uint8)).save(folder / "ambient.png")
    ran = cli(
        "import",
        folder,
        folder / "lights.csv",
        "-o",
        folder / "set",
        "--camera",
        folder / "K.txt",
        *MESH,
        "--pose",
        folder / "pose.txt",
    )
    assert ran.status == 0, ran.err
    assert "1 image without light, left out: ambient.png" in ran.err
