"""Images derived from series: formulas, signs, what is unknown, and the files of --derived."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from lightopt import build_scene, render
from lightopt.config import load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.images import read_exr, read_metadata
from lightopt.lights import place_light
from lightopt.series._derived import _array, _Series, absolute_place, demodulate, phase_gradient, slope_map

LIGHTS = """\
  - {name: dome, kind: dome, radius_mm: 150, camera_hole_mm: 40, segments: 4, lower_elevation_deg: 10, gain: 1.5}
  - name: leds
    kind: led_array
    size_mm: [200, 100]
    rows: 1
    columns: 3
    led_mm: 8
    distance_mm: 200
    elevation_deg: 60
  - name: lcd
    kind: display
    size_mm: [300, 200]
    distance_mm: 300
    elevation_deg: 60
    pattern: {period_mm: 100, phases: 3, directions: [v]}
"""


def stripes(place, period, phases, *, contrast=0.8, mean=100.0):
    steps = 2.0 * math.pi * np.arange(phases) / phases
    return mean * (1.0 + contrast * np.cos(2.0 * math.pi * place / period - steps[:, None, None]))


@pytest.mark.parametrize("phases", [3, 4, 7])
def test_phase_modulation_and_mean(phases):
    place = np.linspace(-9.9, 9.9, 60).reshape(3, 20)
    found = demodulate(stripes(place, 20.0, phases))
    np.testing.assert_allclose(found.phase, 2.0 * math.pi * place / 20.0, atol=1e-12)
    np.testing.assert_allclose(found.modulation, 0.8)
    np.testing.assert_allclose(found.mean, 100.0)
    np.testing.assert_allclose(found.amplitude, 80.0)
    # as if the camera had seen nothing, or too much
    dark = stripes(place, 20.0, phases, mean=0.0)
    assert np.isnan(demodulate(dark).modulation).all()
    dark[1, 0, 0] = np.nan
    assert np.isnan(demodulate(dark).phase[0, 0])


@pytest.mark.parametrize("second", [450.0, 21.0])
def test_a_second_period_gives_the_place(second):
    rng = np.random.default_rng(1)
    place = rng.uniform(-200.0, 200.0, (50, 40))
    phases = [demodulate(stripes(place, p, 4)).phase for p in (20.0, second)]
    noisy = [p + rng.normal(0.0, 0.02, place.shape) for p in phases]
    found = absolute_place(noisy[0], noisy[1], (20.0, second), 400.0)
    assert np.abs(found - place).max() < 0.02 * 20.0 / (2 * math.pi) * 6.0
    assert np.isnan(absolute_place(np.full((1, 1), np.nan), phases[1][:1, :1], (20.0, second), 400.0)).all()


def test_the_gradient_of_the_phase_passes_over_its_steps():
    x, y = np.meshgrid(np.arange(50.0), np.arange(40.0))
    right, down = phase_gradient(np.angle(np.exp(1j * (0.9 * x - 0.4 * y))))
    np.testing.assert_allclose(right[:, 1:-1], 0.9)
    np.testing.assert_allclose(down[1:-1], -0.4)
    assert np.isnan(right[:, 0]).all()


def test_slopes_of_a_tilted_mirror_and_of_a_wrong_height():
    display = place_light(
        distance=300.0, elevation=math.radians(60.0), azimuth=math.radians(270.0), name="lcd", size=(400, 300), points=1
    )
    camera, tilt = np.array([0.0, 0.0, 550.0]), math.radians(15.0)
    normal = np.array([0.0, -math.sin(tilt), math.cos(tilt)])
    lean = math.radians(0.2)
    true = math.cos(lean) * normal + math.sin(lean) * np.array([1.0, 0.0, 0.0])
    mirrored = 2.0 * true[2] * true - np.array([0.0, 0.0, 1.0])
    for height, expected in ((0.0, 0.0), (0.1, math.degrees(0.1 * math.sin(tilt) / 300.0))):
        point = np.array([0.0, 0.0, height])
        place = point + mirrored * ((display.centre - point) @ display.outward) / (mirrored @ display.outward)
        u, v = ((place - display.centre) @ axis for axis in (display.across, display.along))
        arguments = (np.zeros((1, 3)), normal[None], np.array([u]), np.array([v]))
        found = slope_map(*arguments, camera=camera, display=display)
        assert found[0][0] == pytest.approx(0.2, abs=1e-4)
        assert abs(found[1][0]) == pytest.approx(expected, abs=0.05 * expected + 1e-4)


def test_second_periods_that_leave_places_ambiguous_are_refused(bench):
    lcd = "kind: display, size_mm: [300, 200], distance_mm: 300"
    pattern = "{period_mm: 20, second_period_mm: 60}"
    bench.edit("rig.yaml", "stage:", f"  - {{name: lcd, {lcd}, pattern: {pattern}}}\nstage:")
    with pytest.raises(InputError, match=r"second_period_mm: the phases repeat after 60 mm; .*, 320 mm"):
        load_rig(bench.rig)
    bench.edit("rig.yaml", "second_period_mm: 60", "second_period_mm: 15")
    with pytest.raises(InputError, match="expected more than period_mm, 20"):
        load_rig(bench.rig)
    bench.edit("rig.yaml", "second_period_mm: 15", "second_period_mm: 21")  # a beat of 420 mm
    names = [light.name for light in load_rig(bench.rig).lights]
    assert names[-1] == "lcd-16"


def test_render_derived(cli, bench):
    bench.edit("rig.yaml", "stage:", f"{LIGHTS}stage:")
    command = ("render", bench.rig, bench.part, "-o", bench.out, "--posture", "0,0", "--patches", "500", "--derived")
    ran = cli(*command, "--exposure", "1,1/4")
    assert ran.status == 0, ran.err
    assert "dome, posture (0°, 0°): 12 derived images\n" in ran.out
    folder = bench.out / "derived" / "posture_0_0"
    listed = json.loads((bench.out / "derived" / "derived.json").read_text())
    assert [one["light"] for one in listed["images"]] == ["light1", "light3", "dome", "leds", "lcd"]
    geometry = read_exr(bench.out / "posture_0_0" / "geometry.exr")
    dome = read_exr(folder / "dome.exr")
    faces = geometry["Z"] > 0
    for name, axis in (("east_minus_west", "N.X"), ("north_minus_south", "N.Y")):
        towards, away = (dome[name][faces & (side * geometry[axis] > 0.15)] for side in (1, -1))
        assert np.nanmedian(towards) > 0.3
        assert np.nanmedian(away) < -0.3
    leds = read_exr(folder / "leds.exr")
    # the first LED is in the west
    assert np.nanmean(leds["brightest"][faces & (geometry["N.X"] < -0.15)]) < 1.6
    assert np.nanmean(leds["brightest"][faces & (geometry["N.X"] > 0.15)]) > 2.4
    assert (leds["max_minus_min"][np.isfinite(leds["max_minus_min"])] >= 0).all()
    # a pixel has its level from the longest exposure at which it is not saturated, and none where there is none
    panel, linear = (read_exr(one) for one in (folder / "light1.exr", bench.out / "posture_0_0" / "light1.exr"))
    exposure, level = panel["longest_unsaturated.exposure"], panel["longest_unsaturated"]
    assert set(np.unique(exposure[np.isfinite(exposure)])) == {0.25, 1.0}
    assert (linear["Y"][exposure == 0.25] > 254).all()
    known = np.isfinite(level)
    np.testing.assert_allclose(level[known], linear["Y"][known], atol=2.01)
    assert (linear["Y"][~known] > 1015).all()
    unknown = int((~known).sum())
    assert unknown
    assert f"light1, posture (0°, 0°): 2 derived images, {unknown} saturated pixels unknown (NaN)" in ran.out
    assert set(read_exr(folder / "lcd.exr")) >= {"v.phase", "v.modulation", "v.mean", "v.curvature.x", "v.curvature.y"}
    assert read_metadata(folder / "lcd.v.phase.png")["white"] == pytest.approx(math.pi)
    # the same again is no change; a series of others is refused
    assert cli(*command, "--exposure", "1,1/4").status == 0
    (bench.out / "derived" / "derived.json").write_text('{"format": "lightopt-derived/1", "provenance": {}}')
    ran = cli(*command, "--exposure", "1,1/4")
    assert ran.status == 2
    assert "derived images of other inputs" in ran.err


@pytest.mark.slow
def test_phases_of_a_dome_are_azimuth_and_elevation(cli, bench):
    dome = "{name: dome, kind: dome, radius_mm: 150, camera_hole_mm: 40, pattern: {period_deg: 360}}"
    bench.edit("rig.yaml", "stage:", f"  - {dome}\nstage:")
    command = ("render", bench.rig, bench.part, "-o", bench.out, "--posture", "0,0", "--patches", "500", "--derived")
    ran = cli(*command)
    assert ran.status == 0, ran.err
    found = read_exr(bench.out / "derived" / "posture_0_0" / "dome.exr")
    assert {"u.phase", "v.phase", "v.modulation"} <= found.keys()
    assert not [name for name in found if "slope" in name or "place" in name]
    geometry = read_exr(bench.out / "posture_0_0" / "geometry.exr")
    x, y = geometry["N.X"], geometry["N.Y"]
    clear = (np.hypot(x, y) > 0.25) & np.isfinite(found["u.phase"])
    assert np.count_nonzero(clear) > 20
    off = np.angle(np.exp(1j * (found["u.phase"][clear] - np.arctan2(y, x)[clear])))
    assert np.median(np.abs(off)) < 0.3
    steep = (np.hypot(x, y) > 0.3) & np.isfinite(found["v.phase"])
    gentle = (np.hypot(x, y) < 0.2) & (geometry["Z"] > 0) & np.isfinite(found["v.phase"])
    assert np.median(found["v.phase"][steep]) < np.median(found["v.phase"][gentle])


def test_the_dark_field_is_that_of_images_in_which_a_good_part_is_dark(bench):
    bench.edit("rig.yaml", "stage:", f"{LIGHTS}stage:")
    rig, names = load_rig(bench.rig), ("leds-1", "leds-2", "leds-3")
    good = build_scene(rig, load_part(bench.part), lights=names)
    good = replace(good, postures=good.postures[:1])
    images = np.stack([one.level for one in next(iter(render(good))).lights]).astype(np.float64)
    dark = images < 0.1 * images.max(axis=0)
    number, row, column = (at[0] for at in np.nonzero(dark))
    images[number, row, column] = 77.0
    light = next(one for one in rig.lights if one.name == "leds-1")
    found = _array(_Series(light, images, 1.0, good))["dark_field"]
    assert found[row, column] == 77.0
    others = dark.any(axis=0)
    np.testing.assert_array_equal(np.isfinite(found), others)
    others[row, column] = False
    assert (found[others] < 0.1 * images.max(axis=0)[others]).all()


def test_parts_of_series_are_said(cli, bench):
    bench.edit("rig.yaml", "resolution_px: [160, 120]", "resolution_px: [80, 60]")
    bench.edit("rig.yaml", "pixel_size_um: 44", "pixel_size_um: 88")
    bench.edit("rig.yaml", "stage:", f"{LIGHTS}stage:")
    command = ("render", bench.rig, bench.part, "-o", bench.out, "--posture", "0,0", "--patches", "500", "--derived")
    ran = cli(*command, "--light", "dome-1", "--light", "light1", "--exposure", "1,1/4")
    assert "no derived images of dome, lcd, leds: not all channels are in the set" in ran.out


def test_sets_without_a_series_say_so(cli, bench):
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, "--posture", "0,0", "--patches", "500", "--derived")
    assert ran.status == 0
    assert "no derived images: no light of the set has a series of images that gives any" in ran.out


def test_inspect_derived(cli, bench):
    bench.edit("rig.yaml", "resolution_px: [160, 120]", "resolution_px: [80, 60]")
    bench.edit("rig.yaml", "pixel_size_um: 44", "pixel_size_um: 88")
    bench.edit("rig.yaml", "stage:", f"{LIGHTS}stage:")
    cli("render", bench.rig, bench.part, "-o", bench.out, "--posture", "0,0", "--patches", "500", "--noise", "1")
    out = bench.folder / "inspected"
    options = ("--no-register", "--no-report", "--detector", "residual", "--derived")
    ran = cli("inspect", bench.rig, bench.part, bench.out, "-o", out, *options)
    assert ran.status == 0, ran.err
    assert (out / "derived" / "posture_0_0" / "dome.residual.png").exists()
