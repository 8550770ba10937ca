"""Lobes that are given by a table: their sums of Gaussian lobes, their files, and what the part file makes of them."""

import math

import numpy as np
import pytest

from lightopt import build_scene, render
from lightopt.config import copied_text, load_part
from lightopt.config._load import input_files
from lightopt.core.errors import InputError
from lightopt.optics import Reflectance, SpecularModel, gaussian_sum, specular_lobe
from lightopt.scene._reflectance_table import LARGEST_ERROR, table_lobes

DELTA = np.radians(np.concatenate([[0.0], np.geomspace(0.05, 60.0, 120)]))


def ggx(delta, alpha):
    return 1.0 / (np.cos(delta) ** 4 * (1.0 + (np.tan(delta) / alpha) ** 2) ** 2)


def summed(lobes, delta):
    return sum(height * np.exp(-0.5 * (delta / sigma) ** 2) for height, sigma in lobes)


def test_two_gaussian_lobes_are_found_again():
    truth = ((0.95, 0.02), (0.05, 0.12))
    found = gaussian_sum(DELTA, 3.0 * summed(truth, DELTA))
    assert found.error < 0.01
    assert np.allclose(summed(found.lobes, DELTA), summed(truth, DELTA), rtol=0.01, atol=1e-4)


@pytest.mark.parametrize("alpha", [0.01, 0.06, 0.3])
def test_tails_of_ggx_are_followed(alpha):
    value = ggx(DELTA, alpha)
    found = gaussian_sum(DELTA, value)
    assert found.error < 0.02
    assert sum(height for height, _ in found.lobes) == pytest.approx(1.0)
    assert np.all(np.diff([sigma for _, sigma in found.lobes]) > 0.0)
    seen = value > 1e-3
    assert np.allclose(summed(found.lobes, DELTA)[seen], value[seen], rtol=0.05)


LOBES = {
    "ggx": lambda delta: ggx(delta, 0.06),
    "narrow ggx": lambda delta: ggx(delta, 0.01),
    "longer tails": lambda delta: 1.0 / (1.0 + (np.tan(delta) / 0.03) ** 2) ** 1.5,
    "short tails": lambda delta: 1.0 / (1.0 + (np.tan(delta) / 0.05) ** 2) ** 3,
    "abc": lambda delta: 1.0 / (1.0 + 1e4 * (2.0 * np.sin(0.5 * delta)) ** 2) ** 0.8,
    "exponential": lambda delta: np.exp(-delta / 0.05),
    "beckmann": lambda delta: np.exp(-((np.tan(delta) / 0.1) ** 2)) / np.cos(delta) ** 4,
}


@pytest.mark.parametrize("name", LOBES)
@pytest.mark.parametrize(
    "delta", [DELTA, np.radians(90.0 * (np.arange(85) / 90.0) ** 2), np.radians(np.arange(0.0, 60.1, 0.25))]
)
def test_noise_of_a_table_is_no_error_of_the_sum(name, delta):
    truth = LOBES[name](delta)
    noisy = truth * (1.0 + 0.04 * np.random.default_rng(3).standard_normal(len(delta)))
    found = gaussian_sum(delta, noisy)
    assert found.error < LARGEST_ERROR
    seen = truth > 0.01
    ratio = summed(found.lobes, delta)[seen] / truth[seen]
    assert np.std(ratio) < 0.08 * np.mean(ratio)  # the height itself is R_s


def test_the_worst_angle_is_where_the_table_has_an_edge():
    found = gaussian_sum(DELTA, np.searchsorted([math.radians(20.0)], DELTA) == 0)
    assert found.error > 0.5
    assert math.degrees(found.worst) == pytest.approx(20.0, abs=5.0)


def test_the_lobe_is_the_sum():
    lobes = ((0.7, 0.02), (0.25, 0.06), (0.05, 0.2))
    model = SpecularModel(name="measured", measured=lobes)
    for factor in (1.0, 1.5):
        lobe = Reflectance(R_d=0.0, R_s=1.0, sigma=factor * 0.02, model=model).lobe
        for delta in (0.0, 0.01, 0.05, 0.3, 0.8):
            chord = 2.0 * math.sin(0.5 * delta)
            expected = summed(lobes, delta / factor)
            assert specular_lobe(chord * chord, 0.0, lobe) == pytest.approx(expected, rel=1e-9, abs=1e-25)


def write_merl(path, alpha, diffuse, shape=(90, 30, 8)):
    """A material whose lobe is that of GGX over cosθ_i cosθ_o, and whose diffuse light is constant."""
    theta_h = 0.5 * math.pi * (np.arange(shape[0]) / shape[0]) ** 2
    theta_d = 0.5 * math.pi * np.arange(shape[1]) / shape[1]
    phi = math.pi * np.arange(shape[2]) / shape[2]
    h, d, p = np.meshgrid(theta_h, theta_d, phi, indexing="ij")
    along, across = np.cos(h) * np.cos(d), np.sin(h) * np.sin(d) * np.cos(p)
    cosines = (along - across) * (along + across)
    brdf = np.where(cosines > 0.0, ggx(h, alpha) / np.maximum(cosines, 1e-9) + diffuse, -1.0)
    scales = np.array([1.0, 1.15, 1.66]) / 1500.0
    with path.open("wb") as file:
        np.array(shape, np.int32).tofile(file)
        (brdf[None] / scales[:, None, None, None]).tofile(file)


def test_a_material_of_the_merl_database_is_read(tmp_path):
    write_merl(tmp_path / "metal.binary", 0.08, 0.02)
    lobes = table_lobes(tmp_path / "metal.binary")
    delta = np.radians(np.linspace(0.0, 15.0, 40))
    assert np.allclose(summed(lobes, delta), ggx(delta, 0.08), rtol=0.02, atol=1e-3)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected 5 to 100000 rows, found 0"),
        ("delta,value\n0,1\n1,x\n", "line 3: expected δ in degrees and the lobe's value, two numbers"),
        ("0,1\n1,0.5\n1,0.4\n2,0.1\n3,0\n", "expected ascending angles from 0"),
        ("5,1\n6,0.5\n7,0.4\n8,0.1\n9,0\n", "expected ascending angles from 0"),
        ("0,1\n1,0.5\n2,-0.4\n3,0.1\n4,0\n", "expected values of 0 and above"),
        ("0,0.1\n1,0.5\n2,1\n3,0.1\n4,0\n", "expected a lobe that is greatest at the least angle"),
        (
            "\n".join(f"{d},{1.0 if d < 20 else 0.0}" for d in range(40)),
            "follow the table only to .* at δ = .* end the table before them",
        ),
    ],
)
def test_what_is_no_table_is_said(tmp_path, text, words):
    path = tmp_path / "lobe.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words) as error:
        table_lobes(path)
    assert str(error.value).startswith(str(path))


def test_a_file_that_is_no_material_is_refused(tmp_path):
    (tmp_path / "metal.binary").write_bytes(b"\x5a\x00\x00\x00" * 50)
    with pytest.raises(InputError, match="expected a material of the MERL database"):
        table_lobes(tmp_path / "metal.binary")


def test_a_part_with_the_table_of_its_lobe_looks_the_same(bench):
    bench.edit("rig.yaml", "points: 4", "points: auto")
    plain = [image.level for image in next(iter(render(build_scene(bench.rig, bench.part)))).lights]
    delta = np.concatenate([[0.0], np.geomspace(0.1, 30.0, 80)])
    rows = (f"{d:.6g},{7.0 * math.exp(-0.5 * (math.radians(d) / 0.0475) ** 2):.9g}" for d in delta)
    (bench.folder / "lobe.csv").write_text("delta_deg,value\n" + "\n".join(rows), encoding="utf-8")
    bench.edit("part.yaml", "sigma_rad: 0.0475", "model: measured, table: lobe.csv")
    scene = build_scene(bench.rig, bench.part)
    assert scene.reflectance.sigma == pytest.approx(0.0475, rel=1e-3)
    for level, expected in zip((image.level for image in next(iter(render(scene))).lights), plain, strict=True):
        assert np.abs(level - expected).max() <= 0.002 * expected.max()
    part = load_part(bench.part)
    assert "table lobe.csv" in input_files(part)
    (bench.folder / "elsewhere").mkdir()
    assert 'table: "../lobe.csv"' in copied_text(part, bench.folder / "elsewhere", {})
    ggx = {("reflectance", "model"): "ggx", ("reflectance", "alpha"): "0.1", ("reflectance", "table"): None}
    assert "table:" not in copied_text(part, bench.folder / "elsewhere", ggx)


def test_a_table_that_cannot_be_used_is_named_with_its_line(bench):
    (bench.folder / "lobe.csv").write_text("0,1\n", encoding="utf-8")
    bench.edit("part.yaml", "sigma_rad: 0.0475", "model: measured, table: lobe.csv")
    with pytest.raises(InputError, match="expected 5 to 100000 rows, found 1") as error:
        build_scene(bench.rig, bench.part)
    assert "reflectance.table: " in str(error.value)
