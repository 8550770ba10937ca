"""Bad input at the command line: exit status 2, an ``error:`` that says what is wrong and where, nothing written.

What can be repaired, or is only partly wrong, is a ``warning:`` with numbers and the run goes on.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from lightopt.images import read_image_set

FEW = ("--patches", "500")


def refuse(cli, bench, snapshot, *options, command="render"):
    """Run a command that has to be refused; returns what it said, one message a line."""
    before = snapshot(bench.folder)
    if command == "render":
        ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, *options)
    else:
        ran = cli(command, bench.rig, bench.part, *options)
    assert ran.status == 2, ran
    assert ran.out == ""
    lines = ran.err.splitlines()
    assert lines
    assert all(line.startswith(("error: ", "see: ")) for line in lines), ran.err
    assert "Traceback" not in ran.err
    assert snapshot(bench.folder) == before, "a refused run writes nothing"
    assert not bench.out.exists()
    return [line.removeprefix("error: ") for line in lines if not line.startswith("see: ")]


def accept(cli, bench, *options):
    """Run a render that has to succeed; returns its warnings."""
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, *options)
    assert ran.status == 0, ran.err
    lines = ran.err.splitlines()
    assert all(line.startswith("warning: ") for line in lines), ran.err
    warnings = [line.removeprefix("warning: ") for line in lines]
    assert list(read_image_set(bench.out).manifest.warnings) == warnings
    return warnings


# --- the files' words: (file, old, new, line, key, expected and found)

RIG, PART = "rig.yaml", "part.yaml"
WORDS = {
    "misspelt key": (
        RIG,
        "pixel_size_um:",
        "pixel_sise_um:",
        7,
        "camera",
        '"pixel_sise_um"; did you mean "pixel_size_um"?',
    ),
    "misspelt key of a light": (RIG, "gain: 0.8", "gian: 0.8", 13, "lights[1]", '"gian"; did you mean "gain"?'),
    "misspelt key of the part": (PART, "R_s: 12500", "Rs: 12500", 6, "reflectance", '"Rs"; did you mean "R_s"?'),
    "unknown key": (
        RIG,
        "name: small",
        "name: small\ncolour: red",
        3,
        "",
        'unknown key "colour"; the keys here are format, name, camera',
    ),
    "missing key": (RIG, "  distance_mm: 550\n", "", 3, "camera", 'missing key "distance_mm"'),
    "text for a number": (
        RIG,
        "distance_mm: 550",
        "distance_mm: far",
        4,
        "camera.distance_mm",
        '(a number), found "far"',
    ),
    "number in quotes": (
        RIG,
        "distance_mm: 550",
        'distance_mm: "550"',
        4,
        "camera.distance_mm",
        'found "550" in quotes',
    ),
    "a unit in the value": (RIG, "distance_mm: 550", "distance_mm: 550 mm", 4, "camera.distance_mm", 'found "550 mm"'),
    "list for a number": (
        RIG,
        "distance_mm: 550",
        "distance_mm: [550]",
        4,
        "camera.distance_mm",
        "(a number), found [550]",
    ),
    "number for a list": (
        RIG,
        "resolution_px: [160, 120]",
        "resolution_px: 160",
        6,
        "camera.resolution_px",
        "[width, height]",
    ),
    "fraction of a pixel": (RIG, "[160, 120]", "[160.5, 120]", 6, "camera.resolution_px", "found [160.5, 120]"),
    "text for keys": (
        PART,
        "{file: knob.stl, units: mm}",
        "knob.stl",
        3,
        "mesh",
        'expected keys and values ("key: value"), found "knob.stl"',
    ),
    "nothing for a number": (RIG, "distance_mm: 550", "distance_mm:", 4, "camera.distance_mm", "found nothing"),
    "yes is not a boolean or number": (RIG, "gain: 0.8", "gain: yes", 13, "lights[1].gain", 'found "yes"'),
    "NaN": (
        RIG,
        "distance_mm: 550",
        "distance_mm: .nan",
        4,
        "camera.distance_mm",
        "expected a finite number, found .nan",
    ),
    "infinity": (PART, "R_s: 12500", "R_s: .inf", 6, "reflectance.R_s", "expected a finite number, found .inf"),
    "infinity by overflow": (PART, "R_s: 12500", "R_s: 1e999", 6, "reflectance.R_s", "found 1e999, which is too large"),
    "negative size": (RIG, "size_mm: [60, 60]", "size_mm: [60, -60]", 10, "light_source.size_mm", "found [60, -60]"),
    "size of zero": (RIG, "size_mm: [60, 60]", "size_mm: [0, 60]", 10, "light_source.size_mm", "found [0, 60]"),
    "negative pixels": (RIG, "pixel_size_um: 44", "pixel_size_um: -44", 7, "camera.pixel_size_um", "found -44"),
    "negative resolution": (RIG, "[160, 120]", "[160, -120]", 6, "camera.resolution_px", "found [160, -120]"),
    "negative reflectance": (PART, "R_d: 45.0", "R_d: -45.0", 6, "reflectance.R_d", "found -45.0"),
    "sigma in degrees": (PART, "sigma_rad: 0.0475", "sigma_rad: 2.7", 6, "reflectance.sigma_rad", "found 2.7"),
    "m is not a square": (RIG, "points: 4", "points: 5", 10, "light_source.points", "found 5; the nearest are 4 and 9"),
    "m is not a number": (
        RIG,
        "points: 4",
        "points: automatic",
        10,
        "light_source.points",
        'or auto, found "automatic"',
    ),
    "m of a light is not a square": (
        RIG,
        "gain: 0.8",
        "points: 10",
        13,
        "lights[1].points",
        "found 10; the nearest are 9 and 16",
    ),
    "elevation range reversed": (
        RIG,
        "azimuth_deg: 45}",
        "azimuth_deg: 45, elevation_range_deg: [60, 30]}",
        12,
        "lights[0].elevation_range_deg",
        "the low end 60 above the high end 30",
    ),
    "azimuth range reversed": (
        RIG,
        "azimuth_deg: 45}",
        "azimuth_deg: 45, azimuth_range_deg: [90, 0]}",
        12,
        "lights[0].azimuth_range_deg",
        "the low end 90 above the high end 0",
    ),
    "stage range reversed": (
        RIG,
        "[-45, 45]",
        "[45, -45]",
        14,
        "stage.elevation_range_deg",
        "the low end 45 above the high end -45",
    ),
    "a light outside its range": (
        RIG,
        "azimuth_deg: 45}",
        "azimuth_deg: 45, elevation_range_deg: [20, 50]}",
        12,
        "lights[0].elevation_range_deg",
        "is at elevation_deg 60, outside [20, 50]",
    ),
    "duplicate lights": (
        RIG,
        "name: light3",
        "name: light1",
        13,
        "lights[1].name",
        '"light1" is already that of lights[0]',
    ),
    "duplicate lights but for case": (
        RIG,
        "name: light3",
        "name: LIGHT1",
        13,
        "lights[1].name",
        "upper and lower case are not distinguished",
    ),
    "duplicate postures": (
        PART,
        "{elevation_deg: -10, rotation_deg: 170}",
        "{elevation_deg: 0, rotation_deg: 0}",
        5,
        "postures[1]",
        "the same posture as postures[0]",
    ),
    "no lights": (RIG, "stage:", "lights_: []\nstage:", 14, "", 'unknown key "lights_"; did you mean "lights"?'),
    "a key twice": (
        RIG,
        "elevation_deg: 90\n",
        "elevation_deg: 90\n  distance_mm: 500\n",
        6,
        "camera",
        '"distance_mm" is given twice; the first is in line 4',
    ),
    "focal length and image distance": (
        RIG,
        "image_distance_mm: 55",
        "image_distance_mm: 55\n  focal_length_mm: 50",
        9,
        "camera.focal_length_mm",
        "expected only one of them",
    ),
    "a lens too long to focus": (
        RIG,
        "image_distance_mm: 55",
        "focal_length_mm: 600",
        8,
        "camera.focal_length_mm",
        "cannot focus there",
    ),
    "another format": (
        RIG,
        "lightopt-rig/1",
        "lightopt-rig/2",
        1,
        "format",
        'expected lightopt-rig/1, found "lightopt-rig/2"',
    ),
    "a part for a rig": (
        RIG,
        "lightopt-rig/1",
        "lightopt-part/1",
        1,
        "format",
        "this is a part (lightopt-part/1); expected a rig",
    ),
    "a tab": (RIG, "  elevation_deg: 90", "\televation_deg: 90", 5, "", "a tab (column 1)"),
    "a tag": (
        RIG,
        "name: small",
        'name: !!python/object/apply:os.system ["touch pwned"]',
        2,
        "name",
        "tag !!python/object/apply:os.system is not allowed",
    ),
    "a tag of the standard": (
        RIG,
        "distance_mm: 550",
        "distance_mm: !!float 550",
        4,
        "camera.distance_mm",
        "tag !!float is not allowed",
    ),
    "no units for STL": (PART, ", units: mm}", "}", 3, "mesh", 'missing key "units": .stl files carry no unit'),
    "unknown units": (
        PART,
        "units: mm",
        "units: furlong",
        3,
        "mesh.units",
        'expected um, mm, cm, m, inch or ft, found "furlong"',
    ),
    "missing mesh": (PART, "knob.stl", "knobb.stl", 3, "mesh.file", 'did you mean "knob.stl"?'),
    "unknown mesh format": (PART, "knob.stl", "knob.sldprt", 3, "mesh.file", 'found "knob.sldprt"'),
    "saturation beyond the sensor": (
        RIG,
        "bit_depth: 8,",
        "bit_depth: 8, saturation_level: 300,",
        9,
        "camera.sensor.saturation_level",
        "expected at most 255",
    ),
    "bits in between": (
        RIG,
        "bit_depth: 8,",
        "bit_depth: 9,",
        9,
        "camera.sensor.bit_depth",
        "expected 8, 10, 12, 14 or 16, found 9",
    ),
}


@pytest.mark.parametrize("command", ["render", "check"])
@pytest.mark.parametrize("case", WORDS, ids=lambda case: case.replace(" ", "-"))
def test_words_that_cannot_be(cli, bench, snapshot, case, command):
    name, old, new, line, key, said = WORDS[case]
    bench.edit(name, old, new)
    (message,) = refuse(cli, bench, snapshot, command=command)
    place = f"{bench.folder / name}:{line}: " + (f"{key}: " if key else "")
    assert message.startswith(place), message
    assert said in message


def test_everything_wrong_with_a_file_is_said_at_once(cli, bench, snapshot):
    bench.edit(RIG, "distance_mm: 550", "distance_mm: .nan")
    bench.edit(RIG, "pixel_size_um", "pixel_sise_um")
    bench.edit(RIG, "points: 4", "points: 5")
    bench.edit(RIG, "name: light3", "name: light1")
    bench.edit(PART, "R_d: 45.0", "R_d: x")
    messages = refuse(cli, bench, snapshot)
    places = [f"{bench.rig}:{line}: " for line in (4, 7, 10, 13)] + [f"{bench.part}:6: "]
    assert len(messages) == len(places)
    assert all(message.startswith(place) for message, place in zip(messages, places, strict=True)), messages


@pytest.mark.parametrize("command", ["render", "check"])
def test_a_yaml_bomb_is_refused_before_it_goes_off(cli, bench, snapshot, command):
    lines = ["a: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"b{i}: &a{i + 1} [" + ", ".join([f"*a{i}"] * 9) + "]" for i in range(12)]
    bench.rig.write_text("\n".join([*lines, "format: lightopt-rig/1\n"]), encoding="utf-8")
    (message,) = refuse(cli, bench, snapshot, command=command)
    assert re.match(re.escape(str(bench.rig)) + r":\d+: aliases expand to more than ", message)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", ": the file is empty"),
        (b"\xff\xfef\x00", ": the text is UTF-16"),
        (b"name: \xe9t\xe9\n", ":1: byte 0xe9 is not UTF-8"),
        (b"solid \x00\x01", ": this is a binary file"),
        (b"- a\n- b\n", ":1: expected a rig"),
        (b"format: [lightopt-rig/1\n", ":"),
        (b"{" * 3000, ":1: nested more than"),
        (b"a: 1\n" * 300_000, ": larger than 1 MB"),
    ],
    ids=["empty", "UTF-16", "Latin-1", "binary", "list", "unclosed", "deep", "large"],
)
def test_a_rig_that_is_no_rig(cli, bench, snapshot, content, said):
    bench.rig.write_bytes(content)
    (message, *_) = refuse(cli, bench, snapshot)
    assert message.startswith(f"{bench.rig}{said}"), message


# --- missing files


@pytest.mark.parametrize("name", [RIG, PART])
@pytest.mark.parametrize("command", ["render", "check"])
def test_a_missing_file_and_what_may_be_meant(cli, bench, snapshot, name, command):
    (bench.folder / name).rename(bench.folder / f"my-{name}")
    (message,) = refuse(cli, bench, snapshot, command=command)
    assert message == f'{bench.folder / name}: no such file; did you mean "my-{name}"?'


def test_a_folder_for_a_file(cli, bench, snapshot):
    bench.part.unlink()
    bench.part.mkdir()
    (message,) = refuse(cli, bench, snapshot)
    assert message == f"{bench.part}: this is a folder; expected the YAML file of a part"


# --- options

OPTIONS = {
    "points not a square": (("--points", "5"), "points: expected a square (1, 4, 9, 16, …) or auto, found 5"),
    "points zero": (("--points", "0"), "found 0"),
    "points too many": (("--points", "9" * 500), "expected a square"),
    "points a word": (("--points", "many"), '--points: expected a square (1, 4, 9, 16, …) or auto, found "many"'),
    "exposure zero": (
        ("--exposure", "0"),
        '--exposure: expected a number from 1e-09 to 1e+09 or a fraction such as 1/16, found "0"',
    ),
    "exposure negative": (("--exposure", "-1"), 'found "-1"'),
    "exposure NaN": (("--exposure", "nan"), 'found "nan"'),
    "exposure infinite": (("--exposure", "1e999"), 'found "1e999"'),
    "exposure by zero": (("--exposure", "1/0"), 'found "1/0"'),
    "exposure twice": (("--exposure", "0.5,1/2"), "the same exposure was given twice"),
    "posture of one angle": (
        ("--posture", "82"),
        '--posture: expected tilt,rotation in degrees, such as 0,82, found "82"',
    ),
    "posture NaN": (("--posture", "0,nan"), 'found "0,nan"'),
    "posture twice": (("--posture", "0,82", "--posture", "0,82.0"), "the same posture was given twice"),
    "unknown light": (("--light", "light2"), "it has light1, light3"),
    "supersample zero": (("--supersample", "0"), "--supersample: expected"),
    "supersample too many": (("--supersample", "1000"), "found 1000"),
    "threads zero": (("--threads", "0"), "--threads: expected"),
    "negative seed": (("--noise", "-3"), "noise: expected a seed of 0 or more, found -3"),
    "no patches": (("--patches", "0"), "--patches: expected"),
}


@pytest.mark.parametrize("case", OPTIONS, ids=lambda case: case.replace(" ", "-"))
def test_options_that_cannot_be(cli, bench, snapshot, case):
    options, said = OPTIONS[case]
    (message,) = refuse(cli, bench, snapshot, *options)
    assert said in message


def test_a_posture_the_stage_cannot_take_names_both_places(cli, bench, snapshot):
    (message,) = refuse(cli, bench, snapshot, "--posture", "50,0")
    assert "elevation 50° is outside the stage's range -45° to 45°" in message
    assert f"{bench.rig}:14: stage.elevation_range_deg" in message
    bench.edit(PART, "rotation_deg: 170", "rotation_deg: -20")
    (message,) = refuse(cli, bench, snapshot)
    assert message.startswith(f"{bench.part}:5: postures[1]: rotation -20° is outside the stage's range 0° to 360°")
    assert f"{bench.rig}:14: stage.rotation_range_deg" in message


# --- meshes


def box(**options):
    return trimesh.creation.box((30.0, 20.0, 10.0), **options)


def ascii_stl(vertices, faces) -> bytes:
    lines = ["solid part"]
    for face in faces:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex " + " ".join(f"{x!r}" for x in np.asarray(vertices)[k].tolist()) for k in face]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid part\n"]).encode()


def use_mesh(bench, name: str, data: bytes) -> Path:
    path = bench.folder / name
    path.write_bytes(data)
    bench.edit(PART, "knob.stl", name)
    return path


def binary_stl() -> bytes:
    return bytes(box().export(file_type="stl"))


BAD_MESHES = {
    "empty": ("part.stl", lambda: b"", "the mesh file is empty (0 bytes)"),
    "no triangles": ("part.stl", lambda: bytes(84), "has no triangles"),
    "ASCII without triangles": ("part.stl", lambda: b"solid a\nendsolid a\n", "has no triangles"),
    "OBJ without triangles": ("part.obj", lambda: b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "has no triangles"),
    "truncated binary": ("part.stl", lambda: binary_stl()[:-70], "its header says 12 triangles"),
    "truncated ASCII": ("part.stl", lambda: ascii_stl(box().vertices, box().faces)[:-200], "cut off or damaged"),
    "truncated PLY": ("part.ply", lambda: box().export(file_type="ply")[:-30], "part.ply"),
    "truncated GLB": ("part.glb", lambda: box().export(file_type="glb")[:-30], "part.glb"),
    "not a mesh": ("part.stl", lambda: b"hello, this is a letter to you " * 10, "part.stl"),
    "no area": (
        "part.stl",
        lambda: ascii_stl([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]]),
        "triangles of the ASCII STL file has an area",
    ),
    "NaN": ("part.stl", lambda: ascii_stl([[0.0, 0, float("nan")], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), "not finite"),
    "index out of range": ("part.obj", lambda: b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "part.obj"),
}


@pytest.mark.parametrize("command", ["render", "check"])
@pytest.mark.parametrize("case", BAD_MESHES, ids=lambda case: case.replace(" ", "-"))
def test_meshes_that_cannot_be_used(cli, bench, snapshot, case, command):
    name, data, said = BAD_MESHES[case]
    path = use_mesh(bench, name, data())
    if name.endswith(".glb"):
        bench.edit(PART, ", units: mm", "")
    (message,) = refuse(cli, bench, snapshot, command=command)
    assert message.startswith(str(path))
    assert said in message


def test_a_mesh_over_the_memory_budget(cli, bench, snapshot):
    bench.edit(PART, "units: mm}", "units: mm, max_triangles: 1000}")
    (message,) = refuse(cli, bench, snapshot)
    assert message.startswith(f"{bench.mesh}: 2,496 triangles, at most 1,000 are accepted")
    assert "GB of memory" in message


def test_a_mesh_that_claims_to_be_huge_is_not_even_loaded(cli, bench, snapshot):
    path = use_mesh(bench, "huge.stl", bytes(80) + np.uint32(4_000_000_000).tobytes())
    (message,) = refuse(cli, bench, snapshot)
    assert message.startswith(f"{path}: its header says 4,000,000,000 triangles")


@pytest.mark.parametrize("shift", ["[500, 0, 0]", "[0, -400, 0]", "[0, 0, 5000]"])
def test_a_part_wholly_outside_the_view(cli, bench, snapshot, shift):
    bench.edit(PART, "translate_mm: [0, 0, 0]", f"translate_mm: {shift}")
    bench.edit(PART, ", {elevation_deg: -10, rotation_deg: 170}", "")
    (message,) = refuse(cli, bench, snapshot)
    assert message.startswith(
        f"{bench.part}:3: mesh.file: in posture (0°, 0°) the part, 52 × 45.99 × 18.49 mm, lies wholly outside"
    )
    assert "160 × 120 px" in message


def test_a_part_outside_the_view_in_one_posture(cli, bench, snapshot):
    bench.edit(RIG, "stage: {", "stage: {pivot_mm: [0, 300, 0], ")
    (message,) = refuse(cli, bench, snapshot)
    assert "in posture (-10°, 170°) the part" in message


def test_a_camera_inside_the_part(cli, bench, snapshot):
    bench.edit(PART, "units: mm", "units: m")
    message, hint = refuse(cli, bench, snapshot)
    assert message.startswith(f"{bench.part}:3: mesh.file: the camera, 550 mm from the origin, is inside the part")
    assert "units" in message
    assert hint.startswith(f"{bench.part}:3: mesh.units: a wrong unit? Read as m, ")


def test_a_lens_that_folds_the_image_over(cli, bench, snapshot):
    bench.edit(RIG, "image_distance_mm: 55", "image_distance_mm: 5\n  distortion: {k1: -1.5}")
    (message,) = refuse(cli, bench, snapshot)
    assert message.startswith(f"{bench.rig}:9: camera.distortion: this lens model folds the image over")


# --- fine, or repaired and told


def sheet_of_three() -> tuple[np.ndarray, list[list[int]]]:
    """Three triangles on one edge: open and not a manifold."""
    return np.array([[0.0, 0, 0], [0, 20, 0], [20, 0, 5], [-20, 0, 5], [0, 0, 20]]), [[0, 2, 1], [0, 1, 3], [0, 1, 4]]


def test_open_and_non_manifold_meshes_are_fine(cli, bench):
    use_mesh(bench, "part.stl", ascii_stl(*sheet_of_three()))
    assert all("back of a face" in warning for warning in accept(cli, bench))
    open_box = box()
    open_box.update_faces(np.arange(12) != 0)
    (bench.folder / "part.stl").write_bytes(bytes(open_box.export(file_type="stl")))
    assert cli("render", bench.rig, bench.part, "-o", bench.folder / "open", *FEW).status == 0


def test_a_sound_mesh_has_no_warning(cli, bench):
    use_mesh(bench, "part.stl", binary_stl())
    assert accept(cli, bench) == []


def test_a_part_that_leaves_the_view_is_a_warning(cli, bench):
    bench.edit(PART, "translate_mm: [0, 0, 0]", "translate_mm: [15, 0, 0]")
    bench.edit(PART, ", {elevation_deg: -10, rotation_deg: 170}", "")
    (warning,) = accept(cli, bench)
    match = re.fullmatch(
        r"posture \(0°, 0°\): the part leaves the view by ([\d.]+) px \(([\d.]+) mm\) at the right", warning
    )
    assert match, warning
    # the rim, 41 mm off the axis, stands at Z = 0 or above; half the view is 35.2 mm
    assert 13 <= float(match[1]) <= 16
    assert 5.5 <= float(match[2]) <= 6.5


def test_duplicate_vertices_are_a_warning(cli, bench):
    mesh = box()
    lines = [f"v {x} {y} {z}" for x, y, z in [*mesh.vertices, *mesh.vertices[:3]]]
    lines += ["f " + " ".join(str(k + 1 + 8 * (k < 3 and i % 2)) for k in face) for i, face in enumerate(mesh.faces)]
    use_mesh(bench, "part.obj", "\n".join([*lines, ""]).encode())
    (warning,) = accept(cli, bench)
    assert re.search(r"\d of \d+ vertices repeat another one: merged", warning)


def test_triangles_without_area_are_a_warning(cli, bench):
    mesh = box()
    faces = [*mesh.faces.tolist(), [0, 0, 1], [2, 3, 2]]
    use_mesh(bench, "part.stl", ascii_stl(mesh.vertices, faces))
    assert accept(cli, bench) == ["2 of 14 triangles have no area: left out"]


def test_mixed_winding_is_a_warning(cli, bench):
    mesh = box()
    faces = [face[::-1] if i in (1, 4, 7) else face for i, face in enumerate(mesh.faces.tolist())]
    use_mesh(bench, "part.stl", ascii_stl(mesh.vertices, faces))
    assert accept(cli, bench) == ["3 of 12 triangles wound against their neighbours: turned"]


def test_repaired_meshes_render_like_sound_ones(cli, bench, snapshot):
    mesh = box()
    faces = [face[::-1] if i in (1, 4, 7) else face for i, face in enumerate(mesh.faces.tolist())]
    images = []
    path = use_mesh(bench, "part.stl", b"")
    for i, spoilt in enumerate((mesh.faces.tolist(), [*faces, [0, 0, 1]])):
        path.write_bytes(ascii_stl(mesh.vertices, spoilt))
        out = bench.folder / f"out{i}"
        assert cli("render", bench.rig, bench.part, "-o", out, *FEW).status == 0
        images.append({name: digest for name, digest in snapshot(out).items() if name.endswith(".png")})
    assert images[0] == images[1]


def test_points_too_few_for_the_lobe_are_a_warning(cli, bench):
    bench.edit(PART, "sigma_rad: 0.0475", "sigma_rad: 0.003")
    warnings = accept(cli, bench)
    assert [warning.split(":")[0] for warning in warnings] == ["light1, light3"]  # alike, so told once
    assert "σ = 0.003 rad" in warnings[0]
    assert "points: auto" in warnings[0]


def test_no_traceback_from_the_real_command(bench):
    bench.edit(RIG, "distance_mm: 550", "distance_mm: .inf")
    ran = subprocess.run(
        [sys.executable, "-m", "lightopt", "render", str(bench.rig), str(bench.part), "-o", str(bench.out)],
        capture_output=True,
        text=True,
        encoding="utf-8",
        env={**os.environ, "PYTHONUTF8": "1"},
        check=False,
    )
    assert ran.returncode == 2
    assert ran.stdout == ""
    assert ran.stderr == f"error: {bench.rig}:4: camera.distance_mm: expected a finite number, found .inf\n"
