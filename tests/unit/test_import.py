"""``lightopt import``: photographs, lights and calibrations of others become rig, part and image set."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from lightopt.config import load_part, load_rig
from lightopt.images import read_image_set, read_png
from lightopt.rendering import RenderOptions, render_image_set
from lightopt.scene import build_camera, build_lights, build_scene, project

PARTS = Path(__file__).resolve().parents[2] / "configs" / "parts"
WIDTH, HEIGHT = 96, 72
FOCAL, CENTRE = (620.0, 612.0), (50.5, 33.25)  # ours: the first pixel's centre is at 0.5
DISTORTION = {"k1": -0.2, "k2": 0.5, "p1": 0.002, "p2": -0.001, "k3": 0.1}
EYE = np.array([60.0, -40.0, 480.0])
NEAR = {"near1": (150.0, 120.0, 250.0), "near2": (-180.0, 60.0, 200.0)}
FAR = {"far1": (0.3, -0.5, 0.8), "far2": (-0.2, -0.1, 0.9)}
FAR_MM = 1e6
INTENSITY = {"near1": 1.3, "near2": 0.8, "far1": 0.6, "far2": 1.0}
TURNED = Rotation.from_euler("x", 180, degrees=True).as_matrix()


def looking_at_origin(eye, roll):
    """Camera axes in columns (x right, y down, z ahead), plain NumPy."""
    ahead = -eye / np.linalg.norm(eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    return axes @ Rotation.from_rotvec([0, 0, roll]).as_matrix()


AXES = looking_at_origin(EYE, 0.4)


def unit(vector):
    return np.array(vector) / np.linalg.norm(vector)


def write_reference(folder: Path) -> tuple[Path, Path]:
    """A posed rig and a part, written by hand."""
    folder.mkdir()
    turn = Rotation.from_matrix(AXES).as_rotvec(degrees=True)
    mean = np.mean([np.linalg.norm(p) for p in NEAR.values()])
    lights = []
    for name, place in {**NEAR, **FAR}.items():
        x, y, z = place if name in NEAR else FAR_MM * unit(place)
        where = (math.sqrt(x * x + y * y + z * z), math.atan2(z, math.hypot(x, y)), math.atan2(y, x))
        angles = f"elevation_deg: {math.degrees(where[1]):.9f}, azimuth_deg: {math.degrees(where[2]):.9f}"
        falloff = "inverse_square" if name in NEAR else "none"
        gain = INTENSITY[name]
        lights.append(f"  - {{name: {name}, distance_mm: {where[0]:.9f}, {angles}, gain: {gain}, falloff: {falloff}}}")
    (folder / "rig.yaml").write_text(
        f"""format: lightopt-rig/1
name: reference
camera:
  pose:
    position_mm: {EYE.tolist()}
    rotation_vector_deg: {turn.tolist()}
  resolution_px: [{WIDTH}, {HEIGHT}]
  pixel_size_um: 5
  focal_px: {list(FOCAL)}
  principal_point_px: {list(CENTRE)}
  distortion: {json.dumps(DISTORTION).replace('"', "")}
  sensor: {{bit_depth: 16}}
light_source: {{size_mm: [1, 1], points: 1, reference_distance_mm: {mean}}}
lights:
"""
        + "\n".join(lights)
    )
    (folder / "part.yaml").write_text(f"""format: lightopt-part/1
name: knob
mesh: {{file: {json.dumps(str(PARTS / "cover-knob.stl"))}, units: mm}}
placement: {{anchor: rest_on_table, rotate_deg: [0, 0, 25], translate_mm: [2, -3, 0]}}
reflectance: {{R_d: 50, R_s: 1000, sigma_rad: 0.05}}
""")
    return folder / "rig.yaml", folder / "part.yaml"


def export(folder: Path, images: Path, part: Path, world: np.ndarray) -> None:
    """K, [R|t], lights and mesh in another world, X' = world·X, in OpenCV's conventions, by plain NumPy."""
    folder.mkdir()
    R = AXES.T @ world.T
    t = -R @ (world @ EYE)
    K = [FOCAL[0], 0, CENTRE[0] - 0.5, 0, FOCAL[1], CENTRE[1] - 0.5, 0, 0, 1]
    rvec = Rotation.from_matrix(R).as_rotvec()
    (folder / "calibration.yml").write_text(f"""%YAML:1.0
---
calibration_time: "Mon 01 Jan 2024"
image_width: {WIDTH}
image_height: {HEIGHT}
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: {[float(v) for v in K]}
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: {list(DISTORTION.values())}
rvec: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: {rvec.tolist()}
tvec: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: {(t / 10.0).tolist()}
""")
    rows = ["image,light,x,y,z,x_mm,y_mm,z_mm,intensity"]
    for name in (*NEAR, *FAR):
        place = world @ (np.array(NEAR[name]) if name in NEAR else unit(FAR[name]))
        cells = ",".join(repr(float(v)) for v in place)
        rows.append(f"{images.name}/{name}.png,{name}," + (f",,,{cells}" if name in NEAR else f"{cells},,,"))
        rows[-1] += f",{INTENSITY[name]}"
    (folder / "lights.csv").write_text("\n".join(rows))
    scene = build_scene(load_rig(part.with_name("rig.yaml")), load_part(part))
    mesh = trimesh.Trimesh(scene.mesh.vertices @ world.T, scene.mesh.faces, process=False)
    (folder / "knob.stl").write_bytes(mesh.export(file_type="stl"))


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    folder = tmp_path_factory.mktemp("import")
    rig, part = write_reference(folder / "reference")
    render_image_set(rig, part, folder / "rendered", options=RenderOptions(patch_budget=500))
    return folder / "rendered" / "posture_0_0", part


@pytest.mark.parametrize(("world", "turn"), [(np.eye(3), ()), (TURNED, ("--turn-world", "x180"))])
def test_exported_images_come_back(cli, tmp_path, reference, world, turn):
    images, part = reference
    export(tmp_path / "other", images, part, world)
    other, out = tmp_path / "other", tmp_path / "set"
    command = ["import", images.parent, other / "lights.csv", "-o", out, "--camera", other / "calibration.yml"]
    command += ["--pose-units", "cm", "--mesh", other / "knob.stl", "--mesh-units", "mm"]
    ran = cli(*command, *turn)
    assert ran.status == 0, ran.err
    lines = ran.out.splitlines()
    assert lines[0] == f"4 photographs of {WIDTH} × {HEIGHT} px, 16 bits, under 4 lights: {out / 'manifest.json'}"
    assert f"next: lightopt check {out / 'rig.yaml'} {out / 'part.yaml'}" in lines
    rig, there = load_rig(out / "rig.yaml"), load_rig(part.with_name("rig.yaml"))
    points = np.random.default_rng(3).uniform(-20, 20, (20, 3))
    for ours, theirs in zip(project(build_camera(rig), points), project(build_camera(there), points), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-5)
    for ours, theirs in zip(build_lights(rig), build_lights(there), strict=True):
        np.testing.assert_allclose(ours.centre, theirs.centre, rtol=1e-7, atol=1e-3)
    image_set = read_image_set(out)
    assert image_set.manifest.kind == "captured"
    render_image_set(rig, out / "part.yaml", tmp_path / "again", options=RenderOptions(patch_budget=500))
    for entry in image_set.images:
        photograph = read_png(images / f"{entry.light}.png").astype(int)
        assert (read_png(out / (entry.png or "")) == photograph).all()
        again = read_png(tmp_path / "again" / "posture_0_0" / f"{entry.light}.png").astype(int)
        # silhouettes move with the rounding of the mesh
        assert np.quantile(abs(again - photograph), 0.995) <= 1
    assert cli("import", *command[1:], *turn).status == 0, "the same again is fine"


def test_existing_files_are_kept_without_force(cli, tmp_path, ball, snapshot):
    assert cli(*ball, "-o", tmp_path / "set").status == 0
    before = snapshot(tmp_path / "set")
    ran = cli(*ball, "-o", tmp_path / "set", "--gamma", "srgb")
    assert ran.status == 2
    assert "rig.yaml: exists with other content; use --force" in ran.err
    assert snapshot(tmp_path / "set") == before
    assert cli(*ball, "-o", tmp_path / "set", "--gamma", "srgb", "--force").status == 0
    assert "bit_depth: 12" in (tmp_path / "set" / "rig.yaml").read_text(encoding="utf-8")


# --- a sphere, of which only a mask says where it is


@pytest.fixture
def ball(tmp_path):
    """A disc off the middle of an image, in colour, with K as text and no [R|t]."""
    folder = tmp_path / "ball"
    folder.mkdir()
    column, row = np.meshgrid(np.arange(80) + 0.5, np.arange(60) + 0.5)
    disc = np.hypot(column - 44.0, row - 27.0) < 20.0
    Image.fromarray((255 * disc).astype(np.uint8)).save(folder / "mask.png")
    colour = np.where(disc[..., None], np.array([200, 100, 50]), np.array([9, 9, 9])).astype(np.uint8)
    colour[25:28, 40:44, 0] = 255
    Image.fromarray(colour).save(folder / "one.png")
    Image.fromarray(colour // 2).save(folder / "two.png")
    (folder / "K.txt").write_text("# pixels\n8000 0 39.5\n0 8000 29.5\n0 0 1\n")
    (folder / "lights.csv").write_text("image;light;x;y;z;exposure\none.png;a;0;0;1;1\ntwo.png;a;0;0;1;0.5\n")
    where = ["import", folder, folder / "lights.csv", "--camera", folder / "K.txt"]
    return [*where, "--sphere", "10", "--mask", folder / "mask.png"]


def test_a_sphere_is_where_the_mask_is(cli, tmp_path, ball):
    ran = cli(*ball, "-o", tmp_path / "set")
    assert ran.status == 0, ran.err
    assert "--gamma srgb" in ran.err
    part, rig = load_part(tmp_path / "set" / "part.yaml"), load_rig(tmp_path / "set" / "rig.yaml")
    # 10 mm are 20 px at a focal length of 8000 px
    np.testing.assert_allclose(part.placement.translate_mm, [2.0, 1.5, 10.0], atol=0.02)
    assert rig.camera.distance_mm == pytest.approx(4010.0, rel=5e-3)
    overlap = next(line for line in ran.out.splitlines() if line.startswith("mask and part overlap"))
    assert float(overlap.split()[-1].rstrip("%")) > 98.0
    image_set = read_image_set(tmp_path / "set")
    assert [entry.exposure for entry in image_set.images] == [1.0, 0.5]
    levels = read_png(tmp_path / "set" / (image_set.images[0].png or ""))
    assert levels[0, 0] == 0, "black off the mask"
    assert levels[26, 35] == math.floor(0.2126 * 200 + 0.7152 * 100 + 0.0722 * 50 + 0.5)
    assert levels[26, 42] == 255, "a saturated channel is a saturated pixel"
    assert cli("check", tmp_path / "set" / "rig.yaml", tmp_path / "set" / "part.yaml").status == 0


def test_gamma(cli, tmp_path, ball):
    ran = cli(*ball, "-o", tmp_path / "set", "--gamma", "srgb")
    assert (ran.status, ran.err) == (0, "")
    image_set = read_image_set(tmp_path / "set")
    assert image_set.manifest.bit_depth == 12
    levels = read_png(tmp_path / "set" / (image_set.images[0].png or ""))
    linear = ((np.array([200, 100, 50]) / 255 + 0.055) / 1.055) ** 2.4
    assert levels[26, 35] == round(linear @ [0.2126, 0.7152, 0.0722] * 4095)


def test_a_mesh_needs_a_pose_above_it(cli, tmp_path, ball):
    folder = ball[1]
    (folder / "pose.csv").write_text("1,0,0,1\n0,1,0,2\n0,0,1,4000\n")
    (folder / "lights.csv").write_text("image,light,x,y,z\none.png,a,0,0,-1\n")
    mesh = PARTS / "cover-knob.stl"
    command = [*ball[:3], "--camera", folder / "K.txt", "--mesh", mesh, "--mesh-units", "mm", "-o", tmp_path / "set"]
    ran = cli(*command)
    assert ran.status == 2
    assert "K.txt: expected [R|t]" in ran.err
    command += ["--pose", folder / "pose.csv"]
    ran = cli(*command)
    assert ran.status == 2
    assert "puts the camera at Z = -4000 mm; Z points up in a rig" in ran.err
    ran = cli(*command, "--turn-world", "x180")
    assert ran.status == 0, ran.err
    scene = build_scene(tmp_path / "set" / "rig.yaml", tmp_path / "set" / "part.yaml")
    np.testing.assert_allclose(scene.camera.right, [1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(scene.camera.position, [-1, 2, 4000], atol=1e-6)


# --- files of other programs


def test_a_calibration_in_json(cli, tmp_path, ball):
    matrix = {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": [8000.0, 0, 39.5, 0, 8100.0, 30.5]}
    matrix["data"] += [0, 0, 1]
    path = ball[1] / "K.json"
    path.write_text(json.dumps({"cameraMatrix": matrix, "distCoeffs": [0.1, 0, 0, 0]}))
    ran = cli(*ball, "--camera", path, "-o", tmp_path / "set")
    assert ran.status == 0, ran.err
    camera = load_rig(tmp_path / "set" / "rig.yaml").camera
    assert (camera.focal_px, camera.principal_point_px) == ((8000, 8100), (40, 31))
    assert camera.distortion.k1 == 0.1


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("K.txt", "8000 0 39.5\n0 8000\n0 0 1\n", "K.txt: expected numbers as text"),
        ("K.txt", "8000 0 0\n0 8000 0\n40 30 1\n", "expected K as fx, 0, cx; 0, fy, cy; 0, 0, 1, without skew"),
        ("K.txt", "8000 0 390.5\n0 8000 29.5\n0 0 1\n", "the principal point is outside the photographs"),
        ("K.json", '{"K": [[1, 0, 40], [0, 1, 30], [0, 0, 1]], "image_width": 9, "image_height": 9}', "9 × 9 px"),
        ("K.json", '{"focal": 3}', "K.json: expected K as camera_matrix, found focal"),
        ("lights.csv", "image,light,x,y,z\none.png,a,0,0,300\n", "lights.csv:2: expected a direction of length 1"),
        ("lights.csv", "image,light,x,y\none.png,a,0,0\n", "lights.csv:1: expected the columns image, light and"),
        ("lights.csv", "image,light,x,y,z\none.png,a,0,b,1\n", 'column y: expected a number, found "b"'),
        ("lights.csv", "image,light,x,y,z\nno.png,a,0,0,1\n", "lights.csv:2: "),
        ("lights.csv", "image,light,x,y,z\none.png,a,0,0,1\none.png,b,0,0,1\n", "one.png is already in"),
    ],
)
def test_refusals(cli, tmp_path, ball, name, text, words):
    (ball[1] / name).write_text(text)
    command = [*ball, "--camera", ball[1] / name] if name.startswith("K") else ball
    ran = cli(*command, "-o", tmp_path / "set")
    assert ran.status == 2
    assert words in ran.err
    assert not (tmp_path / "set").exists()


def write(path: Path, pixels: np.ndarray) -> None:
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    spec = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], str(pixels.dtype))
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(pixels)
    output.close()


@pytest.mark.parametrize(
    ("name", "options", "bits", "level"),
    [("a.tif", (), 16, 1234), ("a.png", ("--bits", "12"), 12, 1234), ("a.jpg", (), 8, 123)],
)
def test_formats_and_depths(cli, tmp_path, ball, name, options, bits, level):
    grey = np.full((60, 80), level, np.uint16)
    if name == "a.jpg":
        Image.fromarray(grey.astype(np.uint8)).save(ball[1] / name, quality=95)
    else:
        write(ball[1] / name, grey)
    (ball[1] / "lights.csv").write_text(f"image,light,x,y,z,exposure\n{name},a,0,0,1,2\n")
    ran = cli(*ball, "-o", tmp_path / "set", *options)
    assert ran.status == 0, ran.err
    image_set = read_image_set(tmp_path / "set")
    assert image_set.manifest.bit_depth == bits
    loaded = image_set.load(image_set.images[0])
    expected = level * 255 / (2**bits - 1) / 2
    assert loaded.levels[27, 44] == pytest.approx(expected, rel=0.01 if name == "a.jpg" else 1e-5)
    assert not loaded.saturated.any()
