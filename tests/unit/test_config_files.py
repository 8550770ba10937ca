"""Rig and part files: what they promise, and what is told about bad ones."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from lightopt.config import PartConfig, RigConfig, load_part, load_rig
from lightopt.core.errors import InputError

CONFIGS = Path(__file__).parents[2] / "configs"
RIG = (CONFIGS / "rigs" / "four-panel.yaml").read_text(encoding="utf-8")
PART = """\
format: lightopt-part/1
name: knob
mesh:
  file: knob.stl
  units: mm
postures:
  - {elevation_deg: 0, rotation_deg: 0}
  - {elevation_deg: 0, rotation_deg: 82}
reflectance:
  R_d: 45.0
  R_s: 12500
  sigma_rad: 0.0475
"""
STEP = """\
ISO-10303-21;
#9=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));
#10=(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNIT_ASSIGNED_CONTEXT((#9,#8))REPRESENTATION_CONTEXT('',''));
"""
STEP_INCH = """\
ISO-10303-21;
#9=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));
#7=(CONVERSION_BASED_UNIT('INCH',#6)LENGTH_UNIT()NAMED_UNIT(#5));
#10=(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNIT_ASSIGNED_CONTEXT ((#7,#8))REPRESENTATION_CONTEXT('',''));
"""


def write(folder: Path, text: str, name: str = "file.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def changed(text: str, old: str, new: str) -> tuple[str, int]:
    """The text with the first `old` replaced, and the line number where it was."""
    assert old in text
    return text.replace(old, new, 1), text[: text.index(old)].count("\n") + 1


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "knob.stl").write_text("solid\n")
    (tmp_path / "knob.glb").write_bytes(b"glTF")
    (tmp_path / "knob.step").write_text(STEP)
    (tmp_path / "inch.step").write_text(STEP_INCH)
    (tmp_path / "folder.stl").mkdir()
    return tmp_path


def errors(load, path: Path) -> list[str]:
    with pytest.raises(InputError) as caught:
        load(path)
    for message in caught.value.messages:
        assert message.startswith(str(path))
        assert "Input should" not in message
    return [message.removeprefix(f"{path}:") for message in caught.value.messages]


# ---- good files


def test_four_panel_has_the_numbers_of_the_contract() -> None:
    rig = load_rig(CONFIGS / "rigs" / "four-panel.yaml")
    camera = rig.camera
    assert (camera.distance_mm, camera.elevation_deg, camera.azimuth_deg, camera.roll_deg) == (550, 90, 270, 0)
    assert (camera.resolution_px, camera.pixel_size_um, camera.image_distance_mm) == ((1600, 1200), 4.4, 55)
    sensor = camera.sensor
    assert (sensor.bit_depth, sensor.saturation_level, sensor.black_level) == (8, 255, 0)
    assert (sensor.read_noise_levels, sensor.electrons_per_level) == (0.8, 60)
    source = rig.light_source
    assert (source.size_mm, source.points, source.normalisation) == ((60, 60), 4, "mean")
    assert (source.falloff, source.emission_exponent) == ("none", 0)
    assert [light.name for light in rig.lights] == ["light1", "light2", "light3", "light4"]
    assert [light.azimuth_deg for light in rig.lights] == [45, 135, 225, 315]
    for light in rig.lights:
        assert (light.distance_mm, light.elevation_deg, light.elevation_range_deg) == (330, 60, (30, 60))
        assert (light.gain, light.azimuth_range_deg, light.size_mm, light.points) == (1, None, None, None)
    assert rig.stage.elevation_range_deg == (-45, 45)
    assert rig.stage.rotation_range_deg == (0, 360)
    assert rig.hardware is None


def test_paper_rig_leans_the_camera_as_table_2_does() -> None:
    rig = load_rig(CONFIGS / "rigs" / "paper.yaml")
    assert rig.camera.elevation_deg == 105
    assert rig.light_source.points == 4


def test_sample_parts() -> None:
    knob = load_part(CONFIGS / "parts" / "cover-knob.yaml")
    assert [p.rotation_deg for p in knob.postures] == [0, 82, 180, 278]
    assert (knob.reflectance.R_d, knob.reflectance.R_s, knob.reflectance.sigma_rad) == (45, 12500, 0.0475)
    assert knob.source.resolve(knob.mesh.file).is_file()
    assert len(load_part(CONFIGS / "parts" / "spout.yaml").postures) == 2


def test_defaults(folder: Path) -> None:
    text = PART[: PART.index("postures")] + PART[PART.index("reflectance") :]
    part = load_part(write(folder, text))
    assert (part.mesh.normals, part.mesh.crease_angle_deg, part.mesh.max_triangles) == ("smooth", 30, 20_000_000)
    assert (part.placement.anchor, part.placement.translate_mm) == ("rest_on_table", (0, 0, 0))
    assert [(p.elevation_deg, p.rotation_deg) for p in part.postures] == [(0, 0)]
    assert part.reflectance.full_scale == 255


@pytest.mark.parametrize("name", ["rigs/four-panel", "rigs/paper", "parts/cover-knob", "parts/spout"])
def test_dump_and_read_again(name: str) -> None:
    load, model = (load_rig, RigConfig) if name.startswith("rigs") else (load_part, PartConfig)
    config = load(CONFIGS / f"{name}.yaml")
    again = model.model_validate(config.model_dump())
    assert again.model_dump() == config.model_dump()


def test_source_names_hash_and_lines(folder: Path) -> None:
    path = write(folder, PART)
    part = load_part(path)
    assert len(part.source.sha256) == 64
    assert part.source.path == path
    assert part.source.at("mesh", "units") == f"{path}:5: mesh.units"
    assert part.source.at("postures", 1, "rotation_deg") == f"{path}:8: postures[1].rotation_deg"
    assert part.source.at("mesh", "normals") == f"{path}:3: mesh.normals"  # not in the file: its mapping
    assert part.source.at() == f"{path}:1"
    assert part.source.resolve(part.mesh.file) == folder / "knob.stl"


def test_built_in_code_has_no_lines() -> None:
    rig = RigConfig.model_validate(load_rig(CONFIGS / "rigs" / "paper.yaml").model_dump())
    assert rig.source.at("camera") == "<built in code>: camera"


def test_frozen_and_picklable(folder: Path) -> None:
    part = load_part(write(folder, PART))
    with pytest.raises(ValueError, match="frozen"):
        part.name = "other"  # type: ignore[misc]
    again = pickle.loads(pickle.dumps(part))
    assert again == part
    assert again.source.at("mesh") == part.source.at("mesh")


def test_optional_keys_of_the_rig(tmp_path: Path) -> None:
    text = RIG.replace("image_distance_mm: 55 ", "focal_length_mm: 50 ").replace("points: 4 ", "points: auto ")
    text = text.replace("azimuth_deg: 45,", "azimuth_deg: 45, gain: 1.2, size_mm: [20, 30], falloff: inverse_square,")
    text = text.replace("  sensor:", "  exposure_us: 5e3\n  sensor:")
    rig = load_rig(write(tmp_path, text))
    assert (rig.camera.focal_length_mm, rig.camera.image_distance_mm, rig.camera.exposure_us) == (50, None, 5000)
    assert rig.light_source.points == "auto"
    light = rig.lights[0]
    assert (light.gain, light.size_mm, light.falloff, light.points) == (1.2, (20, 30), "inverse_square", None)
    assert rig.hardware is None


def test_step_may_repeat_its_own_unit(folder: Path) -> None:
    for units, file in (("mm", "knob.step"), ("inch", "inch.step"), ("m", "knob.glb")):
        text = PART.replace("knob.stl", file).replace("units: mm", f"units: {units}")
        assert load_part(write(folder, text)).mesh.units == units
    for file in ("knob.step", "knob.glb"):
        text = PART.replace("knob.stl", file).replace("  units: mm\n", "")
        assert load_part(write(folder, text)).mesh.units is None


# ---- one thing wrong with a rig

LIGHT2 = "{name: light2, distance_mm: 330, elevation_deg: 60, azimuth_deg: 135, elevation_range_deg: [30, 60]}"


def light(**changes: str | None) -> str:
    keys: dict[str, str | None] = {
        "name": "light2",
        "distance_mm": "330",
        "elevation_deg": "60",
        "azimuth_deg": "135",
        "elevation_range_deg": "[30, 60]",
        **changes,
    }
    return "{" + ", ".join(f"{k}: {v}" for k, v in keys.items() if v is not None) + "}"


BAD_RIGS = [
    # (old, new, keys, words)
    ("lightopt-rig/1", "lightopt-rig/2", "format", ["expected lightopt-rig/1", '"lightopt-rig/2"', "version 1"]),
    ("lightopt-rig/1", "lightopt-part/1", "format", ["this is a part", "expected a rig"]),
    ("lightopt-rig/1", "other", "format", ["expected lightopt-rig/1", 'found "other"']),
    ("lightopt-rig/1", "1", "format", ["expected lightopt-rig/1", "found 1"]),
    ("name: four-panel", "name:", "name", ["expected text", "found nothing"]),
    ("name: four-panel", "name: 4", "name", ["expected text", "found 4", "quotes"]),
    ("name: four-panel", "nmae: four-panel", "", ['unknown key "nmae"; did you mean "name"?']),
    ("distance_mm: 550", 'distance_mm: "550"', "camera.distance_mm", ["a length", '"550" in quotes']),
    ("distance_mm: 550", "distance_mm: 550 mm", "camera.distance_mm", ["a length", '"550 mm"']),
    ("distance_mm: 550", "distance_mm: true", "camera.distance_mm", ["a length", "found true"]),
    ("distance_mm: 550", "distance_mm: -550", "camera.distance_mm", ["a length", "found -550"]),
    ("distance_mm: 550", "distance_mm: 1:30", "camera.distance_mm", ["a length", '"1:30"']),
    ("distance_mm: 550", "distance_mm: .nan", "camera.distance_mm", ["finite", ".nan"]),
    ("distance_mm: 550", "distance_mm: -.inf", "camera.distance_mm", ["finite", "-.inf"]),
    ("distance_mm: 550", "distance_mm: 1e999", "camera.distance_mm", ["finite", "too large"]),
    ("distance_mm: 550", "distance_mm: " + "9" * 5000, "camera.distance_mm", ["finite", "5000 digits"]),
    ("distance_mm: 550", "distance: 550", "camera", ['unknown key "distance"', '"distance_mm"']),
    ("distance_mm: 550", "roll_degrees: 550\n  distance_mm: 550", "camera", ['"roll_degrees"', '"roll_deg"']),
    ("distance_mm: 550", "colour: 1\n  distance_mm: 550", "camera", ['unknown key "colour"', "the keys here are dist"]),
    ("elevation_deg: 90", "elevation_deg: 180", "camera.elevation_deg", ["between 0 and 180", "found 180"]),
    ("elevation_deg: 90", "elevation_deg: abc", "camera.elevation_deg", ["between 0 and 180", '"abc"']),
    ("azimuth_deg: 270", "azimuth_deg: 400", "camera.azimuth_deg", ["-360 to 360", "found 400"]),
    ("[1600, 1200]", "[1600]", "camera.resolution_px", ["[width, height]", "[1600]"]),
    ("[1600, 1200]", "[1600, 0]", "camera.resolution_px", ["[width, height]", "[1600, 0]"]),
    ("[1600, 1200]", "[1600.0, 1200]", "camera.resolution_px", ["whole numbers", "1600.0"]),
    ("[1600, 1200]", "[true, 1200]", "camera.resolution_px", ["whole numbers", "true"]),
    ("[1600, 1200]", "1600", "camera.resolution_px", ["[width, height]", "found 1600"]),
    ("pixel_size_um: 4.4", "pixel_size_um: 0", "camera.pixel_size_um", ["0.01 to 1000", "found 0"]),
    ("image_distance_mm: 55 ", "", "camera", ['missing key "image_distance_mm"', '"focal_length_mm"']),
    ("image_distance_mm: 55 ", "focal_lenght_mm: 50 ", "camera", ["unknown key", '"focal_length_mm"']),
    ("image_distance_mm: 55 ", "focal_length_mm: 550 ", "camera.focal_length_mm", ["less than distance_mm, 550"]),
    ("k1: 0", "k1: x", "camera.distortion.k1", ["expected a number", '"x"']),
    ("k1: 0", "k4: 0", "camera.distortion", ['unknown key "k4"', "the keys here are k1, k2"]),
    ("bit_depth: 8 ", "bit_depth: 9 ", "camera.sensor.bit_depth", ["8, 10, 12, 14 or 16", "found 9"]),
    ("bit_depth: 8 ", "bit_depth: 8.0 ", "camera.sensor.bit_depth", ["8, 10, 12, 14 or 16", "found 8.0"]),
    ("saturation_level: 255", "saturation_level: 256", "camera.sensor.saturation_level", ["255", "found 256"]),
    ("saturation_level: 255", "saturation_level: 0", "camera.sensor.saturation_level", ["above 0", "found 0"]),
    ("black_level: 0", "black_level: 255", "camera.sensor.black_level", ["less than", "255", "found 255"]),
    ("black_level: 0", "black_level: -1", "camera.sensor.black_level", ["from 0 up", "found -1"]),
    ("electrons_per_level: 60", "electrons_per_level: 0", "camera.sensor.electrons_per_level", ["above 0"]),
    ("size_mm: [60, 60]", "size_mm: [60, -60]", "light_source.size_mm", ["two lengths", "[60, -60]"]),
    ("size_mm: [60, 60]", "size_mm: 60", "light_source.size_mm", ["two lengths", "found 60"]),
    ("points: 4 ", "points: 5 ", "light_source.points", ["square", "found 5", "4 and 9"]),
    ("points: 4 ", "points: 0 ", "light_source.points", ["square", "found 0"]),
    ("points: 4 ", "points: -4 ", "light_source.points", ["square", "found -4"]),
    ("points: 4 ", "points: 4.0 ", "light_source.points", ["square", "found 4.0"]),
    ("points: 4 ", "points: true ", "light_source.points", ["square", "found true"]),
    ("points: 4 ", "points: Auto ", "light_source.points", ["or auto", '"Auto"']),
    ("normalisation: mean", "normalisation: median", "light_source.normalisation", ["mean or sum", '"median"']),
    ("falloff: none", "falloff: linear", "light_source.falloff", ["none or inverse_square", '"linear"']),
    ("falloff: none", "falloff:", "light_source.falloff", ["none or inverse_square", "found nothing"]),
    ("emission_exponent: 0", "emission_exponent: -1", "light_source.emission_exponent", ["from 0", "found -1"]),
    (LIGHT2, light(name="light1"), "lights[1].name", ['"light1" is already that of lights[0]']),
    (LIGHT2, light(name="LIGHT1"), "lights[1].name", ['"LIGHT1"', "lights[0]", "lower case"]),
    (LIGHT2, light(name="nul"), "lights[1].name", ['"nul"', "Windows reserves"]),
    (LIGHT2, light(name="COM1.txt"), "lights[1].name", ["Windows reserves"]),
    (LIGHT2, light(name="a/b"), "lights[1].name", ["letters, digits", '"a/b"']),
    (LIGHT2, light(name="'..'"), "lights[1].name", ["letters, digits", '".."']),
    (LIGHT2, light(name="a."), "lights[1].name", ["ends with a dot"]),
    (LIGHT2, light(name="ü"), "lights[1].name", ["letters, digits", '"ü"']),
    (LIGHT2, light(name="2"), "lights[1].name", ["letters, digits", "found 2", "quotes"]),
    (LIGHT2, light(name=None), "lights[1]", ['missing key "name"']),
    (LIGHT2, light(elevation_deg="0"), "lights[1].elevation_deg", ["between 0 and 180", "found 0"]),
    (LIGHT2, light(elevation_deg="75"), "lights[1].elevation_range_deg", ["elevation_deg 75", "[30, 60]"]),
    (LIGHT2, light(elevation_range_deg="[60, 30]"), "lights[1].elevation_range_deg", ["[low, high]", "60 above"]),
    (LIGHT2, light(elevation_range_deg="60"), "lights[1].elevation_range_deg", ["[low, high]", "found 60"]),
    (LIGHT2, light(distance_range_mm="[340, 400]"), "lights[1].distance_range_mm", ["distance_mm 330", "[340, 400]"]),
    (LIGHT2, light(distance_range_mm="[400, 300]"), "lights[1].distance_range_mm", ["[low, high]", "400 above"]),
    (LIGHT2, light(distance_range_mm="330"), "lights[1].distance_range_mm", ["[low, high]", "found 330"]),
    (LIGHT2, light(distance_range_mm="[0, 330]"), "lights[1].distance_range_mm", ["panel cannot stand at the origin"]),
    (LIGHT2, light(distance_step_mm="10"), "lights[1].distance_step_mm", ["no effect without distance_range_mm"]),
    (LIGHT2, light(azimuth_range_deg="[0, 90]"), "lights[1].azimuth_range_deg", ["azimuth_deg 135", "[0, 90]"]),
    (LIGHT2, light(gain="-1"), "lights[1].gain", ["from 0", "found -1"]),
    (LIGHT2, light(points="6"), "lights[1].points", ["square", "4 and 9"]),
    (LIGHT2, light(points="auto", normalisation="sum"), "lights[1].normalisation", ["points: auto", "use mean"]),
    (LIGHT2, light().replace("elevation_deg", "elevaton_deg", 1), "lights[1]", ['did you mean "elevation_deg"?']),
    (
        LIGHT2,
        light().replace("elevation_deg", "elevation", 1),
        "lights[1]",
        ['unknown key "elevation"; did you mean "elevation_deg"?'],
    ),
    (
        LIGHT2,
        light().replace("distance_mm", "distance_cm", 1),
        "lights[1]",
        ['did you mean "distance_mm"? It is in mm: convert the value from cm'],
    ),
    (LIGHT2, light().replace("distance_mm: ", "distance_mm:"), "lights[1]", ["space after the colon"]),
    (LIGHT2, "light2", "lights[1]", ['"key: value"', 'found "light2"']),
    (LIGHT2, "[1, 2]", "lights[1]", ['"key: value"', "found [1, 2]"]),
    ("pivot_mm: [0, 0, 0]", "pivot_mm: [0, 0]", "stage.pivot_mm", ["[x, y, z]", "[0, 0]"]),
    ("[-45, 45]", "[45, -45]", "stage.elevation_range_deg", ["[low, high]", "45 above the high end -45"]),
    ("[-45, 45]", "[-45, 200]", "stage.elevation_range_deg", ["-180 to 180", "[-45, 200]"]),
    ("stage:  ", "hardware: 3\nstage:  ", "hardware", ["keys and values", "found 3"]),
]


@pytest.mark.parametrize(("old", "new", "keys", "words"), BAD_RIGS, ids=lambda v: str(v)[:40])
def test_bad_rig(tmp_path: Path, old: str, new: str, keys: str, words: list[str]) -> None:
    text, line = changed(RIG, old, new)
    found = errors(load_rig, write(tmp_path, text))
    assert len(found) == 1
    if "missing key" in found[0] and keys == "camera":
        line = RIG[: RIG.index("camera:")].count("\n") + 1
    assert found[0].startswith(f"{line}: {keys}: " if keys else f"{line}: ")
    for word in words:
        assert word in found[0]


def test_focal_length_and_image_distance_together(tmp_path: Path) -> None:
    text, line = changed(RIG, "image_distance_mm: 55", "focal_length_mm: 50\n  image_distance_mm: 55")
    (found,) = errors(load_rig, write(tmp_path, text))
    assert found.startswith(f"{line}: camera.focal_length_mm: given together with image_distance_mm")


def test_lights_must_be_a_list_with_something_in_it(tmp_path: Path) -> None:
    head, tail = RIG[: RIG.index("lights: ")], RIG[RIG.index("stage:  ") :]
    (found,) = errors(load_rig, write(tmp_path, f"{head}lights: []\n{tail}"))
    assert "lights: expected at least one entry" in found
    (found,) = errors(load_rig, write(tmp_path, f"{head}lights: {{a: 1}}\n{tail}"))
    assert "lights: expected a list, found keys and values (a)" in found
    many = ", ".join(light(name=f"l{i}") for i in range(1001))
    (found,) = errors(load_rig, write(tmp_path, f"{head}lights: [{many}]\n{tail}"))
    assert "lights: expected at most 1000 entries, found 1001" in found
    (found,) = errors(load_rig, write(tmp_path, head + tail))
    assert found.startswith('9: missing key "lights": ')


def test_a_light_inherits_what_makes_it_impossible(tmp_path: Path) -> None:
    text, line = changed(RIG.replace("normalisation: mean", "normalisation: sum"), LIGHT2, light(points="auto"))
    (found,) = errors(load_rig, write(tmp_path, text))
    assert found.startswith(f"{line}: lights[1].points: ")


def test_shared_sum_of_auto_points(tmp_path: Path) -> None:
    text, line = changed(RIG.replace("points: 4 ", "points: auto "), "normalisation: mean", "normalisation: sum")
    (found,) = errors(load_rig, write(tmp_path, text))
    assert found.startswith(f"{line}: light_source.normalisation: sum cannot be used with points: auto")


def test_all_errors_at_once_sorted_by_line(tmp_path: Path) -> None:
    text = (
        RIG.replace("name: four-panel", "nmae: four-panel")
        .replace("distance_mm: 550", "distance_mm: far")
        .replace("points: 4 ", "points: .inf ")
        .replace("name: light2", "name: light1")
        .replace("name: light3, distance_mm: 330", "name: light3, distance_mm: -1, colour: red")
        .replace("name: light4", "gain: 2, gain: 3, name: light4")
        .replace("[-45, 45]", "[45, -45]")
    )
    found = errors(load_rig, write(tmp_path, text))
    lines = [int(f.partition(":")[0]) for f in found]
    assert lines == sorted(lines)
    for word in (
        '"nmae"',
        '"far"',
        "light_source.points: expected a finite number",
        '"light1" is already',
        "lights[2].distance_mm",
        '"colour"',
        'lights[3]: key "gain" is given twice',
        "stage.elevation_range_deg",
    ):
        assert sum(word in f for f in found) == 1, word
    assert len(found) == 8


def test_what_is_unreadable_hides_nothing_else(tmp_path: Path) -> None:
    text = (
        RIG.replace("points: 4 ", "points: 5 ")
        .replace("falloff: none ", "points: 4\n  falloff: none ")
        .replace("[1600, 1200]", "[.nan, 1200]")
        .replace("pixel_size_um: 4.4", "pixel_size_um: -1")
        .replace("pivot_mm: [0, 0, 0]", "<<: {}\n  pivot_mm: 0")
        .replace("bit_depth: 8 ", "!!str bit_depth: 8 ")
    )
    found = errors(load_rig, write(tmp_path, text))
    assert [f.split(": ")[1] for f in found] == [
        "camera.resolution_px[0]",
        "camera.pixel_size_um",
        "camera.sensor",
        "light_source.points",
        "light_source",
        "stage",
        "stage.pivot_mm",
    ]


# ---- one thing wrong with a part

BAD_PARTS = [
    ("lightopt-part/1", "lightopt-rig/1", "format", ["this is a rig", "expected a part"]),
    ("lightopt-part/1", "lightopt-images/1", "format", ["this is an image set", "expected a part"]),
    ("  file: knob.stl", "  fil: knob.stl", "mesh", ['unknown key "fil"; did you mean "file"?']),
    ("knob.stl", "knop.stl", "mesh.file", ["no such file", "knop.stl", 'did you mean "knob.stl"?']),
    ("knob.stl", "sub/knob.stl", "mesh.file", ["no such file", "sub"]),
    ("knob.stl", "folder.stl", "mesh.file", ["is a folder", "expected a file"]),
    ("knob.stl", "knob.gltf", "mesh.file", [".stl, .ply, .obj, .glb, .step, .stp", '"knob.gltf"']),
    ("knob.stl", "knob", "mesh.file", ["ending in", '"knob"']),
    ("knob.stl", "a" * 190 + ".stl", "mesh.file", ["no such file"]),
    ("knob.stl", '"a\\nb.stl"', "mesh.file", ["text of one line"]),
    ("knob.stl", "3", "mesh.file", ["text of one line", "found 3"]),
    ("units: mm", "units: miles", "mesh.units", ["um, mm, cm, m, inch or ft", '"miles"']),
    ("units: mm", "normals: flat\n  units: mm", "mesh.normals", ["smooth or facet", '"flat"']),
    ("units: mm", "units: mm\n  crease_angle_deg: 0", "+mesh.crease_angle_deg", ["above 0, up to 180"]),
    ("units: mm", "units: mm\n  chord_tolerance_mm: 0.1", "+mesh.chord_tolerance_mm", ["belongs to STEP"]),
    ("knob.stl\n  units: mm", "knob.step\n  chord_tolerance_mm: 0", "+mesh.chord_tolerance_mm", ["0.0001 to 10"]),
    ("units: mm", "units: mm\n  max_triangles: 1.5", "+mesh.max_triangles", ["whole number", "1.5"]),
    ("knob.stl\n  units: mm", "knob.glb\n  units: mm", "+mesh.units", [".glb is in metres", "found mm"]),
    ("knob.stl\n  units: mm", "knob.step\n  units: m", "+mesh.units", ["found m", "is in mm", "remove"]),
    ("knob.stl\n  units: mm", "inch.step\n  units: mm", "+mesh.units", ["found mm", "is in inch", "remove"]),
    ("rotation_deg: 82", "rotation_deg: 0.0", "postures[1]", ["the same posture as postures[0]"]),
    ("rotation_deg: 82", "rotation_deg: 361", "postures[1].rotation_deg", ["-360 to 360", "found 361"]),
    ("R_d: 45.0", "R_d: -45.0", "reflectance.R_d", ["from 0", "found -45.0"]),
    ("R_d: 45.0", "r_d: 45.0", "reflectance", ['unknown key "r_d"; did you mean "R_d"?']),
    ("R_s: 12500", "R_s: 12,500", "reflectance.R_s", ["a number", '"12,500"']),
    (
        "sigma_rad: 0.0475",
        "sigma_deg: 2.7",
        "reflectance",
        ['did you mean "sigma_rad"? It is in radians: convert the value from degrees'],
    ),
    ("sigma_rad: 0.0475", "sigma_rad: 0", "reflectance.sigma_rad", ["to 0.5 (radians)", "found 0"]),
    ("sigma_rad: 0.0475", "sigma_rad: 2.7", "reflectance.sigma_rad", ["to 0.5 (radians)", "found 2.7"]),
    ("sigma_rad: 0.0475", "sigma_rad: 0.1\n  full_scale: 0", "+reflectance.full_scale", ["above 0"]),
    ("postures:", "placement: {anchor: left}\npostures:", "placement.anchor", ["rest_on_table", '"left"']),
    ("postures:", "placement: {rotate_deg: 90}\npostures:", "placement.rotate_deg", ["[x, y, z]", "found 90"]),
    ("postures:", "placement:\npostures:", "placement", ["found nothing"]),
]


@pytest.mark.parametrize(("old", "new", "keys", "words"), BAD_PARTS, ids=lambda v: str(v)[:40])
def test_bad_part(folder: Path, old: str, new: str, keys: str, words: list[str]) -> None:
    text, line = changed(PART, old, new)
    line += keys.startswith("+")
    found = errors(load_part, write(folder, text))
    assert len(found) == 1
    assert found[0].startswith(f"{line}: {keys.removeprefix('+')}: ")
    for word in words:
        assert word in found[0]


@pytest.mark.parametrize("file", ["knob.stl", "knob.ply", "knob.OBJ"])
def test_units_are_mandatory_where_the_format_has_none(folder: Path, file: str) -> None:
    (folder / file).write_text("")
    text = PART.replace("knob.stl", file).replace("  units: mm\n", "")
    (found,) = errors(load_part, write(folder, text))
    assert found.startswith(f'3: mesh: missing key "units": {Path(file).suffix.lower()} files carry no unit')
    assert file in found


def test_backslashes_get_a_hint(folder: Path) -> None:
    (found,) = errors(load_part, write(folder, PART.replace("knob.stl", r"meshes\knob.stl")))
    assert "no such file" in found


def test_missing_keys_are_described(folder: Path) -> None:
    found = errors(load_part, write(folder, "\nformat: lightopt-part/1\nreflectance:\n  R_d: 1\n"))
    assert len(found) == 4
    assert [f.partition(":")[0] for f in found] == ["2", "2", "3", "3"]
    assert any(f.startswith('2: missing key "mesh": The part') for f in found)
    assert any(
        f.startswith('3: reflectance: missing key "sigma_rad": torrance-sparrow, two-lobe: width') for f in found
    )


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("model: ggx", ['missing key "alpha"', "Model ggx needs it"]),
        (
            "model: ggx, alpha: 0.1, sigma_rad: 0.05",
            ["sigma_rad: model ggx has no such key; it belongs to torrance-sparrow, two-lobe"],
        ),
        ("alpha: 0.1, sigma_rad: 0.05", ["alpha: model torrance-sparrow has no such key; it belongs to ggx"]),
        ("model: two-lobe, sigma_rad: 0.05", ['missing key "R_s_wide"', 'missing key "sigma_wide_rad"']),
        (
            "model: two-lobe, sigma_rad: 0.1, R_s_wide: 200, sigma_wide_rad: 0.05",
            ["at most R_s, 100", "more than sigma_rad"],
        ),
        ("model: phong, sigma_rad: 0.05", ["model", "ggx"]),
        ("sigma_rad: 0.05, diffuse_exponent: 0", ["diffuse_exponent: expected a number from 0.5 to 5, found 0"]),
        ("sigma_rad: 0.05, oren_nayar_roughness: 1.5", ["oren_nayar_roughness: expected a number from 0 to 1"]),
        (
            "sigma_rad: 0.05, oren_nayar_roughness: 0.3, diffuse_exponent: 1.12",
            ["oren_nayar_roughness: the diffuse component has one form: diffuse_exponent is given, too"],
        ),
        ("sigma_rad: 0.05, oren_nayar_sigma: 0.3", ['unknown key "oren_nayar_sigma"; did you mean']),
        ("sigma_rad: 0.05, sigma_across_rad: 0.2", ['missing key "brushing"']),
        ("sigma_rad: 0.05, brushing: {direction: [1, 0, 0]}", ['missing key "sigma_across_rad"']),
        (
            "sigma_rad: 0.05, sigma_across_rad: 0.04, brushing: {direction: [1, 0, 0]}",
            ["sigma_across_rad: expected more than sigma_rad, 0.05, up to 50 times as much, found 0.04"],
        ),
        (
            "model: ggx, alpha: 0.05, sigma_across_rad: 0.2, brushing: {direction: [1, 0, 0]}",
            ["sigma_across_rad: model ggx has no such key"],
        ),
        (
            "sigma_rad: 0.05, sigma_across_rad: 0.2, brushing: {direction: [0, 0, 0]}",
            ["brushing.direction: expected [x, y, z], three numbers that are not all 0"],
        ),
        (
            "sigma_rad: 0.05, sigma_across_rad: 0.2, brushing: {}",
            ['missing key "direction", "around_axis", "along_curve_mm" or "along_texture": expected one of them'],
        ),
        (
            "sigma_rad: 0.05, sigma_across_rad: 0.2, brushing: {along_texture: w}",
            ["brushing.along_texture: expected", "u"],
        ),
        (
            "sigma_rad: 0.05, sigma_across_rad: 0.2, brushing: {along_curve_mm: [[0, 0, 0]]}",
            ["brushing.along_curve_mm: expected at least 2 entries, found 1"],
        ),
        (
            "sigma_rad: 0.05, sigma_across_rad: 0.2, brushing: {along_curve_mm: [[0, 0, 0], [0, 0, 0]]}",
            ["two corners that follow each other are at the same place"],
        ),
        ("sigma_rad: 0.05, refractive_index: [2.0]", ["refractive_index", "[n, k]"]),
        ("sigma_rad: 0.05, refractive_index: [2.0, -1.0]", ["refractive_index", "above 0"]),
    ],
)
def test_models_have_keys_of_their_own(folder: Path, keys: str, words: list[str]) -> None:
    mesh = "mesh: {file: knob.stl, units: mm}"
    text = f"format: lightopt-part/1\nname: x\n{mesh}\nreflectance: {{R_d: 1, R_s: 100, {keys}}}\n"
    found = errors(load_part, write(folder, text))
    assert all(f.startswith("4: ") for f in found), found
    assert all(any(word in f for f in found) for word in words), found


# ---- files that are no configuration at all


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", ["empty", "format: lightopt-rig/1"]),
        (b"\xef\xbb\xbf# nothing\n\n", ["empty"]),
        (b"null\n", ["empty"]),
        (b"- a\n- b\n", ["1: ", "expected a rig", 'found ["a", "b"]']),
        (b"just text\n", ["expected a rig", '"just text"']),
        (b"name: \xff\xfe\n", ["1: ", "0xff", "UTF-8"]),
        (b"a: 1\nb: \xe9\n", ["2: ", "0xe9", "UTF-8"]),
        ("name: x\n".encode("utf-16"), ["UTF-16", "UTF-8"]),
        (b"\x89PNG\r\n\x1a\n\0\0", ["UTF-8"]),
        (b"solid\0\0\0", ["binary"]),
        (b"a: 1\nb: \x07\n", ["2: ", "control character U+0007"]),
        (b"#" * 1_000_001, ["larger than 1 MB"]),
    ],
)
def test_not_a_configuration(tmp_path: Path, data: bytes, words: list[str]) -> None:
    path = tmp_path / "x.yaml"
    path.write_bytes(data)
    (found,) = errors(load_rig, path)
    for word in words:
        assert word in found


def test_byte_order_mark_is_accepted(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + RIG.replace("\n", "\r\n").encode())
    assert load_rig(path).name == "four-panel"


def test_missing_file_and_folder(tmp_path: Path) -> None:
    write(tmp_path, RIG, "four-panel.yaml")
    (found,) = errors(load_rig, tmp_path / "fourpanel.yaml")
    assert "no such file" in found
    assert "four-panel.yaml" in found
    (found,) = errors(load_rig, tmp_path)
    assert "folder" in found
    (found,) = errors(load_rig, tmp_path / "nowhere" / "x.yaml")
    assert f"{tmp_path / 'nowhere'} is not there" in found
    with pytest.raises(InputError, match=r"cannot be read|no such file"):
        load_rig(tmp_path / "four-panel.yaml" / "x")
