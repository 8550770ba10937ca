"""Lens and data sheet in rig files: what they become, and errors with their lines."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from lightopt.config import copied_text, input_hashes, load_rig
from lightopt.core.errors import InputError
from lightopt.scene import build_camera, build_sensor

CONFIGS = Path(__file__).parents[2] / "configs"

RIG = """\
format: lightopt-rig/1
name: lens
camera:
  distance_mm: 550
  elevation_deg: 90
  resolution_px: [160, 120]
  pixel_size_um: 3.45
  focal_length_mm: 50
  aperture: 8
  sensor: {bit_depth: 12, saturation_level: 4000, black_level: 100}
light_source: {size_mm: [60, 60], points: 4}
lights: [{name: light1, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45}]
"""

SHEET = """\
format: lightopt-sensor/1
name: test
quantum_efficiency_percent: 60
saturation_capacity_e: 10000
dark_noise_e: 2.5
dark_current_e_per_s: 100
dsnu_e: 1
prnu_percent: 0.5
linearity_error_percent: 0.2
"""


@pytest.fixture
def load(tmp_path):
    def run(text=RIG, *, sheet=None):
        (tmp_path / "rig.yaml").write_text(text, encoding="utf-8")
        if sheet is not None:
            (tmp_path / "sheet.yaml").write_text(sheet, encoding="utf-8")
        return load_rig(tmp_path / "rig.yaml")

    return run


def with_sheet(extra=""):
    return RIG.replace("black_level: 100", f"black_level: 100{extra}, data_sheet: sheet.yaml")


def test_lens_of_a_rig(load):
    camera = build_camera(load())
    assert camera.lens.aperture == pytest.approx(50 / 8)
    assert camera.lens.focus == 550
    assert camera.diffraction_cutoff is None
    text = RIG.replace("aperture: 8", "aperture: 8\n  focus_distance_mm: 500\n  wavelength_nm: 550")
    camera = build_camera(load(text))
    assert camera.image_distance == pytest.approx(1 / (1 / 50 - 1 / 500))
    assert camera.lens.focus == 500
    # the cut-off of diffraction is 1 / (λ · working f-number)
    assert camera.diffraction_cutoff == pytest.approx(3.45 / (0.55 * camera.image_distance / (50 / 8)))
    measured = build_camera(load(text.replace("focal_length_mm: 50", "image_distance_mm: 55")))
    assert measured.lens.aperture == pytest.approx(1 / (1 / 500 + 1 / 55) / 8)


def test_no_aperture_is_a_pinhole(load):
    assert build_camera(load(RIG.replace("  aperture: 8\n", ""))).lens is None


@pytest.mark.parametrize(
    ("keys", "line", "says"),
    [
        ("aperture: 0", 9, "camera.aperture: expected an f-number from 0.5 to 1000, found 0"),
        ("aperture: -2.8", 9, "an f-number"),
        ("aperture: f/8", 9, "an f-number"),
        ("focus_distance_mm: 500", 9, "only a lens with an aperture has this"),
        ("wavelength_nm: 550", 9, "only a lens with an aperture has this"),
        ("aperture: 8\n  focus_distance_mm: 50", 10, "expected more than focal_length_mm, 50, found 50"),
        ("aperture: 8\n  focus_distance_mm: 0", 10, "a length"),
        ("aperture: 8\n  wavelength_nm: 0.00055", 10, "nanometres"),
        ("aperture: 8\n  vignetting: {cos4: 1}", 10, "camera.vignetting.cos4"),
        (
            "aperture: 8\n  vignetting: {v2: -0.9, v4: -0.9}",
            10,
            "1 + v2·ρ² + v4·ρ⁴ is -0.8 in the corners; expected at",
        ),
    ],
)
def test_wrong_lenses(load, keys, line, says):
    with pytest.raises(InputError) as error:
        load(RIG.replace("aperture: 8", keys))
    assert f"rig.yaml:{line}: " in str(error.value)
    assert says in str(error.value)


def test_data_sheet_in_levels(load):
    rig = load(with_sheet().replace("aperture: 8", "aperture: 8\n  exposure_us: 20000"), sheet=SHEET)
    sensor = build_sensor(rig.camera)
    gain = 10000 / 3900  # electrons per level, such that the capacity makes the saturation level
    assert sensor.electrons_per_level == pytest.approx(gain)
    assert sensor.read_noise_levels == pytest.approx(math.hypot(2.5, math.sqrt(100 * 0.02)) / gain)
    assert sensor.dsnu_levels == pytest.approx(1 / gain)
    assert (sensor.prnu, sensor.linearity_error) == (pytest.approx(0.005), pytest.approx(0.002))
    assert rig.camera.sensor.quantum_efficiency_percent == 60
    assert "data sheet" in input_hashes(rig, None)


def test_gain_of_the_sheet_and_keys_of_the_rig_take_precedence(load):
    sheet = SHEET + "levels_per_electron: 0.5\n"
    assert load(with_sheet(), sheet=sheet).camera.sensor.electrons_per_level == 2
    rig = load(with_sheet(", electrons_per_level: 4, prnu_percent: 0"), sheet=sheet)
    assert rig.camera.sensor.electrons_per_level == 4
    assert rig.camera.sensor.read_noise_levels == pytest.approx(2.5 / 4)
    assert rig.camera.sensor.prnu_percent == 0


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (("dark_noise_e: 2.5\n", ""), 'missing key "dark_noise_e"'),
        (("saturation_capacity_e: 10000\n", ""), 'missing key "saturation_capacity_e"'),
        (("quantum_efficiency_percent: 60", "quantum_efficiency_percent: 0"), "sheet.yaml:3: "),
        (("prnu_percent: 0.5", "prnu_percent: -1"), "sheet.yaml:8: prnu_percent: expected per cent, from 0 to 50"),
        (("prnu_percent", "prnu"), "sheet.yaml:8: "),
        (("lightopt-sensor/1", "lightopt-part/1"), "expected the data sheet of a sensor"),
    ],
)
def test_wrong_data_sheets(load, wrong, says):
    with pytest.raises(InputError) as error:
        load(with_sheet(), sheet=SHEET.replace(*wrong))
    assert "rig.yaml:10: camera.sensor.data_sheet: " in str(error.value)
    assert says in str(error.value)


def test_data_sheet_that_is_not_there(load):
    with pytest.raises(InputError, match=r"rig\.yaml:10: camera\.sensor\.data_sheet: .*no such file"):
        load(with_sheet())


def test_a_rig_that_is_copied_keeps_its_data_sheet(load, tmp_path):
    rig = load(with_sheet(), sheet=SHEET)
    other = tmp_path / "out" / "rig.yaml"
    other.parent.mkdir()
    other.write_text(copied_text(rig, other.parent), encoding="utf-8")
    assert load_rig(other).camera.sensor.read_noise_levels == rig.camera.sensor.read_noise_levels


def test_example_of_a_data_sheet(tmp_path, load):
    example = (CONFIGS / "sensors" / "assumed-cmos.yaml").read_text(encoding="utf-8")
    assert build_sensor(load(with_sheet(), sheet=example).camera).prnu == pytest.approx(0.005)
