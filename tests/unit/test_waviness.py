"""Waviness of good parts: its slopes, its share in images, and the noise that planning and inspection take it for."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from lightopt import load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.defects import SCALES_PX, Waviness, clipped_variance
from lightopt.images import read_image_set, read_png
from lightopt.inspection import InspectOptions, inspect_set, predict
from lightopt.rendering import RenderOptions, cast_rays_at, render_image_set, render_posture
from lightopt.rig.capture import CaptureOptions, capture, connect_devices, wiring_of
from lightopt.rig.capture._wiring import start_bench
from lightopt.rig.simulated import BenchTruth
from lightopt.scene import build_scene

SLOPE = math.radians(0.1)
BAND = ((SLOPE, 1.5),)
BANDS = ((0.8 * SLOPE, 0.6), (0.6 * SLOPE, 3.0))  # with the same slope


def plane(side_mm, step_mm):
    y, x = np.mgrid[0:side_mm:step_mm, 0:side_mm:step_mm]
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, 3.0)], axis=1)
    return points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), x.shape


@pytest.mark.parametrize("bands", [BAND, BANDS])
def test_slopes_have_their_root_mean_square_and_sums_over_gaussians_their_variance(bands):
    points, normals, shape = plane(50.0, 0.25)
    ratios = []
    for seed in range(6):
        leant = Waviness(bands=bands, seed=seed).normals(points, normals)
        np.testing.assert_allclose(np.linalg.norm(leant, axis=1), 1.0, atol=1e-12)
        assert math.sqrt(np.mean(np.sum(leant[:, :2] ** 2, axis=1))) == pytest.approx(SLOPE, rel=0.12)
        slopes = leant[:, 0].reshape(shape) / (SLOPE / math.sqrt(2.0))
        sums = [ndimage.gaussian_filter(slopes, s, mode="reflect") * math.sqrt(4.0 * math.pi) * s for s in SCALES_PX]
        ratios.append([np.var(one) for one in sums])
    waviness = Waviness(bands=bands)
    expected = [waviness.correlated_pixels(0.25, (scale,)) for scale in SCALES_PX]
    np.testing.assert_allclose(np.mean(ratios, axis=0), expected, rtol=0.25)
    assert waviness.correlated_pixels(0.25, SCALES_PX) == max(expected)


def test_sums_over_the_walls_of_a_hill_have_their_variance():
    step, scale = 0.25, 3.0
    y, x = np.mgrid[-14:15, -14:15]
    walls = x * np.exp(-(x**2 + y**2) / (2.0 * scale**2))
    walls /= np.sqrt(np.sum(walls**2))
    points, normals, shape = plane(50.0, step)
    sums = []
    for seed in range(6):
        leant = Waviness(bands=BAND, seed=seed).normals(points, normals)
        slopes = leant[:, 0].reshape(shape) / (SLOPE / math.sqrt(2.0))
        sums.append(np.var(ndimage.correlate(slopes, walls)[15:-15, 15:-15]))
    waviness = Waviness(bands=BAND)
    assert np.mean(sums) == pytest.approx(waviness.correlated_pixels(step, (scale,), walls=True), rel=0.25)
    assert waviness.correlated_pixels(step, (6.0,), walls=True) > waviness.correlated_pixels(step, (6.0,))


def test_waves_much_finer_than_a_pixel_are_independent_from_pixel_to_pixel():
    assert Waviness(bands=((SLOPE, 0.01),)).correlated_pixels(0.25, SCALES_PX) == 1.0


def test_a_surface_without_a_seed_is_the_smooth_one():
    points, normals, _ = plane(2.0, 0.5)
    np.testing.assert_array_equal(Waviness(bands=BAND).normals(points, normals), normals)


@pytest.mark.parametrize(("level", "spread", "limit"), [(100, 20, 120), (130, 20, 120), (100, 20, 900), (135, 10, 120)])
def test_the_variance_of_clipped_levels(level, spread, limit):
    drawn = np.random.default_rng(1).normal(level, spread, 400_000)
    off = np.minimum(drawn, limit) - min(level, limit)
    assert clipped_variance(level, spread, limit) == pytest.approx(np.mean(off**2), rel=0.05)
    assert clipped_variance(level, 0.0, limit) == 0.0


@pytest.fixture
def wavy(bench):
    """A rig with more pixels than the small one, and a part with the waviness above."""
    bench.edit("rig.yaml", "resolution_px: [160, 120]", "resolution_px: [320, 240]")
    bench.edit("rig.yaml", "pixel_size_um: 44", "pixel_size_um: 22")
    text = bench.part.read_text(encoding="utf-8") + "surface: {waviness_deg: 0.1, waviness_mm: 1.5}\n"
    bench.part.write_text(text, encoding="utf-8")
    return bench


def test_images_of_a_wavy_part_differ_from_those_of_a_smooth_one_by_what_is_predicted(wavy):
    scene = build_scene(wavy.rig, wavy.part, defects=False)
    posture, caster = scene.postures[0], cast_rays_at(scene)
    predicted = predict(scene, posture, caster, lights=[light.name for light in scene.lights])
    assert predicted.waviness is not None
    squares, seeds = 0.0, 12
    for seed in range(seeds):
        shown = replace(scene, waviness=replace(scene.waviness, seed=seed))
        images = render_posture(shown, posture, caster=caster, averaged=predicted.clean)
        differences = [a.level - b.level for a, b in zip(images.lights, predicted.images.lights, strict=True)]
        np.testing.assert_array_equal(images.geometry.normals, predicted.images.geometry.normals)
        squares += np.stack(differences).astype(float) ** 2 / seeds
    clean = predicted.clean & np.all([image.level > 0.0 for image in predicted.images.lights], axis=0)
    for square, image in zip(squares, predicted.images.lights, strict=True):
        spread = predicted.waviness.spread[image.light]
        assert np.mean(square[clean]) == pytest.approx(np.mean(spread[clean] ** 2.0), rel=0.25)
        dim = clean & (image.level < 60.0)
        assert np.mean(square[dim]) == pytest.approx(np.mean(spread[dim] ** 2.0), rel=0.25)


@pytest.mark.nightly
def test_a_good_wavy_part_raises_no_false_alarms_where_its_file_says_that_it_is(wavy):
    part = load_part(wavy.part)
    options = RenderOptions(postures=(Posture(elevation_deg=0.0, rotation_deg=0.0),), noise=1)
    render_image_set(wavy.rig, wavy.part, wavy.out, options=options)
    regions = [
        len(
            inspect_set(
                load_rig(wavy.rig),
                believed,
                read_image_set(wavy.out),
                options=InspectOptions(fusion=None, register=False),
            ).defects
        )
        for believed in (part, part.model_copy(update={"surface": None}))
    ]
    assert regions[0] == 0
    assert regions[1] >= 3


@pytest.mark.parametrize("gain", [1.0, 1.03])
def test_long_waves_do_not_pass_for_the_brightness_of_the_lights(wavy, gain):
    wavy.edit("part.yaml", "waviness_mm: 1.5", "waviness_mm: 3")
    rig, part = load_rig(wavy.rig), load_part(wavy.part)
    wavy.edit("rig.yaml", "gain: 0.8", f"gain: {0.8 * gain:g}")
    options = RenderOptions(postures=(Posture(elevation_deg=0.0, rotation_deg=0.0),), noise=1)
    render_image_set(wavy.rig, wavy.part, wavy.out, options=options)
    result = inspect_set(
        rig, part, read_image_set(wavy.out), options=InspectOptions(fusion=None, detector="residual", register=False)
    )
    found = result.postures[0].view.photometry.gains
    assert found == pytest.approx({"light1": 1.0, "light3": gain}, abs=0.002)


def test_every_part_on_the_simulated_rig_has_a_surface_of_its_own(wavy):
    rig, part = load_rig(wavy.rig), load_part(wavy.part)
    frames = []
    for seed in (1, 1, 2):
        truth = BenchTruth(seed=seed)
        with start_bench(rig, wiring_of(rig), part=part, truth=truth) as bench:
            folder = wavy.folder / f"captured-{len(frames)}"
            capture(
                rig, part, folder,
                options=CaptureOptions(postures=(Posture(elevation_deg=0.0, rotation_deg=0.0),), lights=("light1",)),
                connect=lambda plan, bench=bench: connect_devices(rig, plan.wiring, part=part, plan=plan, bench=bench),
            )  # fmt: skip
        frames.append(read_png(folder / read_image_set(folder).images[0].png))
    np.testing.assert_array_equal(frames[0], frames[1])
    # on the flank of the highlight, far beyond noise
    assert np.abs(frames[2].astype(float) - frames[0]).max() > 20.0


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("waviness_deg: 0.1", "expected waviness_deg and waviness_mm, or bands"),
        ("waviness_deg: 0.1, bands: [{waviness_deg: 0.1, waviness_mm: 1}]", "remove one or the other"),
        ("bands: [{waviness_deg: 0.1}]", 'bands\\[0\\]: missing key "waviness_mm"'),
    ],
)
def test_bands_take_the_place_of_one_slope_and_length(wavy, keys, words):
    wavy.edit("part.yaml", "waviness_deg: 0.1, waviness_mm: 1.5", keys)
    with pytest.raises(InputError, match=words):
        load_part(wavy.part)


def test_a_part_file_has_several_bands(wavy):
    bands = "bands: [{waviness_deg: 0.05, waviness_mm: 0.3}, {waviness_deg: 0.1, waviness_mm: 3}]"
    wavy.edit("part.yaml", "waviness_deg: 0.1, waviness_mm: 1.5", bands)
    scene = build_scene(wavy.rig, wavy.part)
    assert np.allclose(scene.waviness.bands, [(math.radians(0.05), 0.3), (math.radians(0.1), 3.0)])


@pytest.mark.parametrize("line", ["waviness_deg: 9", "waviness_deg: 0", "waviness_mm: 0"])
def test_a_waviness_out_of_range_names_the_line(wavy, line):
    key = line.split(":")[0]
    text = re.sub(rf"{key}: [0-9.]+", line, wavy.part.read_text(encoding="utf-8"))
    wavy.part.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=rf"part.yaml:7.*{key}"):
        load_part(wavy.part)
