"""Images laid over a prediction: what is saturated is a lower bound, with ambient light subtracted too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage, special

from lightopt import build_scene, load_rig
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Observation, refuse_mismatch
from lightopt.inspection import InspectOptions, predict
from lightopt.inspection._inspect import inspection_warnings
from lightopt.inspection.detection._deviation import deviations
from lightopt.inspection.prediction._posture_view import posture_view
from lightopt.rendering import cast_rays_at, render_posture

FLAT = Posture(0.0, 0.0)


@pytest.fixture(scope="module")
def good(shared_bench):
    """A scene, and its part under one light without noise."""
    scene = build_scene(shared_bench.rig, shared_bench.part, postures=(FLAT,), lights=("light1",))
    return scene, predict(scene, FLAT, cast_rays_at(scene), lights=("light1",))


def taken(good, ambient, *, reported=True, model=None, shown=None):
    """Deviations of an image over so many levels of ambient light, subtracted afterwards, and which are saturated.

    From the prediction itself, or from another model; `shown` are other levels than the prediction's.
    """
    scene, prediction = good
    sensor = scene.sensor
    scale = sensor.max_level / scene.reflectance.full_scale
    level = prediction.images.lights[0].level if shown is None else shown
    signal = level * scale + sensor.black_level
    delivered = np.minimum(np.floor(signal + ambient + 0.5), sensor.max_level)
    saturated = delivered >= sensor.saturated_from
    image = Observation(
        light="light1",
        posture=FLAT,
        exposure=1.0,
        levels=(delivered - ambient).astype(np.float32),
        saturated=saturated,
        half_width=0.5,
        source=Path("made-by-test.png"),
        subtracted=np.full(saturated.shape, ambient, np.float32) if reported else 0.0,
    )
    view = posture_view(scene, [image], model or prediction, where="test")
    return deviations(view), saturated & prediction.clean


@pytest.mark.parametrize("ambient", [0.0, 20.0])
def test_a_good_part_is_not_darker_in_a_highlight_or_around_it(good, ambient):
    found, full = taken(good, ambient)
    assert full.sum() > 20
    assert np.abs(found.z).max() < 1.5  # quantisation only


@pytest.mark.parametrize("rays", [1, 4])
def test_a_good_part_deviates_nowhere_whether_pixels_show_means_or_centres(good, rays):
    scene, prediction = good
    images = render_posture(scene, FLAT, caster=cast_rays_at(scene), supersample=rays)
    found, _ = taken(good, 0.0, model=prediction, shown=images.lights[0].level)
    edge = prediction.clean & (np.abs(prediction.images.lights[0].inside) > 2.0)
    assert edge.sum() > 20
    assert np.abs(found.z[0][edge]).max() < 3.0
    assert np.abs(found.z).max() < 4.0


def test_a_lower_bound_is_never_darker_even_where_what_was_subtracted_is_not_known(good):
    found, full = taken(good, 20.0, reported=False)
    assert found.z[0][full].min() >= 0.0


def test_mirrored_images_of_a_nearly_symmetric_part_are_refused(good):
    scene, prediction = good
    light, clean = prediction.images.lights[0], prediction.clean

    def part(own):
        mixed = own * light.level + (1.0 - own) * light.level[:, ::-1]
        return np.ascontiguousarray(np.minimum(mixed, 200.0))

    def with_level(level):
        lights = (replace(light, level=level, specular=np.zeros_like(level)),)
        return replace(prediction, images=replace(prediction.images, lights=lights))

    def explained(model):
        seen = model[:, ::-1][clean]
        return 1.0 - float(np.mean((seen - model[clean]) ** 2) / np.var(seen))

    def mirrored(model):
        taken((scene, with_level(np.ascontiguousarray(model[:, ::-1]))), 0.0, model=with_level(model))

    mirrored(part(0.5))  # nothing tells
    model = next(model for model in map(part, np.arange(0.5, 1.0, 0.01)) if explained(model) < 0.85)
    assert explained(model) > 0.65
    taken((scene, with_level(model)), 0.0, model=with_level(model))
    with pytest.raises(InputError, match="they fit far better mirrored left to right") as caught:
        mirrored(model)
    assert "flip the images" in str(caught.value)


@pytest.mark.parametrize(
    ("spoilt", "reported"),
    [
        (lambda level, top: level[:, ::-1, ::-1], "far better rotated by 180°.*rotate them, or correct the camera's"),
        (lambda level, top: level[:, :, ::-1], "far better mirrored left to right.*flip the images; a rotation"),
        (lambda level, top: 0.0 * level, "they are black: 0 grey levels, predicted "),
        (lambda level, top: np.where(level > 1.0, top, level), "100 % of their evaluable pixels are saturated"),
        (lambda level, top: np.roll(level, 20, 2), "check that rig, part, placement"),
    ],
)
def test_images_that_are_not_of_this_part_are_refused_with_what_they_show(spoilt, reported):
    rng = np.random.default_rng(2)
    model = rng.uniform(2.0, 180.0, (2, 30, 40)).astype(np.float32)
    limit = np.full_like(model, 200.0)
    seen = np.ascontiguousarray(spoilt(model, limit), np.float32)
    everywhere = np.arange(30 * 40)
    refuse_mismatch(model, model, limit, np.ones_like(model), everywhere, "set")
    with pytest.raises(InputError, match=reported):
        refuse_mismatch(seen, model, limit, np.ones_like(model), everywhere, "set")


def test_an_even_plate_is_not_refused_for_having_no_variance():
    """A model explains nothing of noise; a plate that is 20 % brighter on one side is still a plate."""
    rng = np.random.default_rng(2)
    model = np.full((2, 30, 40), 90.0, np.float32)
    noise = np.ones_like(model)
    seen = (90.0 + rng.normal(size=model.shape) + np.linspace(-10.0, 10.0, 40)).astype(np.float32)
    refuse_mismatch(seen, model, 255.0 * noise, noise, np.arange(30 * 40), "set")


@pytest.mark.parametrize(
    ("noise", "reported"),
    [
        ("read_noise_levels: 0.8, electrons_per_level: 60", False),
        ("read_noise_levels: 0.8", False),
        ("electrons_per_level: 60", False),
        ("read_noise_levels: 0", True),
    ],
)
def test_a_sensor_without_noise_is_warned_of(bench, noise, reported):
    bench.edit("rig.yaml", "read_noise_levels: 0.8, electrons_per_level: 60", noise)
    words = inspection_warnings(load_rig(bench.rig), [], InspectOptions())
    assert any("read_noise_levels" in word for word in words) == reported


def test_warnings_of_the_registration_are_said(bench):
    words = inspection_warnings(load_rig(bench.rig), [], InspectOptions(), registration=("the turn is unknown",))
    assert words == ("the turn is unknown",)


def test_on_a_dark_field_a_glint_deviates_and_rounding_does_not(good):
    scene, _ = good
    polished = replace(scene, reflectance=replace(scene.reflectance, R_d=0.5))
    rendered = predict(polished, FLAT, cast_rays_at(polished), lights=("light1",))
    light = rendered.images.lights[0]
    noise = np.sqrt(scene.sensor.noise_variance(0.0))
    dark = rendered.clean & (light.level > 0.0) & (light.level < 0.5 * noise)
    # the middle of the largest square of dark pixels has a glint, the tenth of them furthest down lies in shadow
    side = ndimage.distance_transform_cdt(dark)
    row, column = np.unravel_index(int(side.argmax()), side.shape)
    assert side.max() > 3
    shadow = dark & (np.arange(len(dark)) > np.quantile(np.nonzero(dark)[0], 0.9))[:, None]
    dark &= ~shadow
    glint = np.zeros(dark.shape, np.float32)
    glint[row - 1 : row + 2, column - 1 : column + 2] = 30.0 / scene.sensor.max_level * scene.reflectance.full_scale

    def with_level(level):
        images = replace(rendered.images, lights=(replace(light, level=level),))
        return replace(rendered, images=images)

    level = np.where(shadow, np.float32(0.0), light.level)
    found, _ = taken((polished, with_level(level + glint)), 0.0, model=with_level(level))
    assert found.usable[0][dark].all()
    assert not found.lit[0][dark].any()
    assert (found.z[0][dark & (glint > 0)] > 5).all()
    assert (found.z[0][dark & (glint == 0)] == 0).all()
    assert shadow.any()
    assert not found.usable[0][shadow].any()


def test_the_hard_edge_of_a_shadow_may_be_a_pixel_off_and_a_smooth_edge_may_not():
    def off(predicted, level):
        ones = np.ones_like(predicted)
        view = SimpleNamespace(
            level=level, predicted=predicted, deviation=0.8 * ones, slack=0.0 * ones, limit=255.0 * ones,
            saturated=ones < 0, clean=ones[0] > 0, lights=("light1",),
        )  # fmt: skip
        return np.abs(deviations(view).z[0])

    row, column = np.mgrid[:60.0, :80.0].astype(np.float32)
    shading = 40.0 + 0.2 * row

    def hard(by):
        return (shading - 11.0 * (column + row // 7 >= 40 + by))[None].astype(np.float32)

    def smooth(by):
        return (shading + 60.0 * special.expit((column - 40.0 - by) / 2.0))[None].astype(np.float32)

    assert off(hard(0), hard(1)).max() < 0.5
    assert off(hard(0), 0.5 * (hard(0) + hard(1))).max() < 0.5
    assert off(hard(0), hard(2)).max() > 3.0
    # darker or brighter than both sides is a defect there as anywhere
    for change in (-22.0, 22.0):
        spot = hard(0)
        spot[0, 30, 34:38] += change
        assert np.all(off(hard(0), spot)[30, 34:38] > 3.0)
    assert off(smooth(0), smooth(1)).max() > 3.0
    # nor may the flank of a highlight that is saturated beyond it: only clipped it is as hard
    flank = (shading + 1200.0 * special.expit((column - 40.0) / 0.25))[None].astype(np.float32)
    assert np.sum(flank[0, 30] > 255.0) > 30
    wrong = flank.copy()
    place = int(np.flatnonzero(flank[0, 30] < 150.0)[-1])
    wrong[0, 30, place] += 60.0
    assert off(flank, wrong)[30, place] > 3.0
