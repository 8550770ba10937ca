"""The sensor: scaling, rounding, clipping, noise statistics, reproducibility."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from lightopt.core.errors import InputError
from lightopt.optics import Sensor, expose, image_rng, saturated
from lightopt.optics._sensor import _poisson

EIGHT_BIT = Sensor(bit_depth=8)


def row(*values: float) -> np.ndarray:
    return np.array([values], np.float64)


def test_levels_of_an_eight_bit_sensor_are_the_reflectance_levels():
    quantised = expose(row(0, 1, 45, 254, 255, 1e9, -3), sensor=EIGHT_BIT, exposure=1, full_scale=255)
    assert quantised.dtype == np.uint8
    assert quantised.tolist() == [[0, 1, 45, 254, 255, 255, 0]]


def test_halves_round_up_everywhere_not_to_even():
    quantised = expose(row(0.5, 1.5, 2.5, 3.49999, 254.5), sensor=EIGHT_BIT, exposure=1, full_scale=255)
    assert quantised.tolist() == [[1, 2, 3, 3, 255]]


def test_black_level_exposure_and_full_scale_follow_the_formula():
    sensor = Sensor(bit_depth=12, black_level=64)
    quantised = expose(row(0, 100, 200), sensor=sensor, exposure=0.25, full_scale=255)
    expected = np.floor(64 + 0.25 * np.array([0, 100, 200]) * 4095 / 255 + 0.5)
    assert quantised.dtype == np.uint16
    assert quantised.tolist() == [expected.tolist()]


def test_twelve_bit_sensor_that_tops_out_at_4080():
    sensor = Sensor(bit_depth=12, saturation_level=4080)
    quantised = expose(row(254.0, 254.06, 254.07, 255), sensor=sensor, exposure=1, full_scale=255)
    assert quantised.tolist() == [[4079, 4080, 4080, 4095]]
    assert saturated(quantised, sensor).tolist() == [[False, True, True, True]]


def test_saturated_is_full_scale_by_default():
    assert saturated(np.array([[253, 254, 255]], np.uint8), EIGHT_BIT).tolist() == [[False, False, True]]


def test_noise_variance_is_that_of_exposed_levels_single_and_averaged():
    sensor = Sensor(bit_depth=12, black_level=100, read_noise_levels=3.0, electrons_per_level=4.0)
    signal = 60.0 * 4095 / 255
    frames = np.stack(
        [
            expose(np.full((200, 500), 60.0), sensor=sensor, exposure=1, full_scale=255, rng=np.random.default_rng(n))
            for n in range(4)
        ]
    ).astype(float)
    assert np.var(frames[0]) == pytest.approx(sensor.noise_variance(signal), rel=0.02)
    mean = np.floor(frames.mean(axis=0) + 0.5)
    assert np.var(mean) == pytest.approx(sensor.noise_variance(signal, frames=4), rel=0.02)


def test_noise_variance_keeps_shape_and_kind_and_knows_no_shot_noise_below_black():
    quiet = Sensor(bit_depth=8, read_noise_levels=2.0)
    signals = np.array([[-3.0, 0.0, 50.0]], np.float32)
    assert quiet.noise_variance(signals).tolist() == [[np.float32(4.0 + 1 / 12)] * 3]
    noisy = Sensor(bit_depth=8, read_noise_levels=2.0, electrons_per_level=10.0)
    variance = noisy.noise_variance(signals, frames=2)
    assert variance.dtype == np.float32
    assert variance == pytest.approx(np.array([[2.0, 2.0, 4.5]]) + 1 / 12)
    assert noisy.noise_variance(-3.0) == pytest.approx(4.0 + 1 / 12)


def test_shot_and_read_noise_have_the_mean_and_variance_of_the_model():
    sensor = Sensor(bit_depth=12, black_level=100, read_noise_levels=3.0, electrons_per_level=4.0)
    levels = np.full((600, 500), 60.0)
    signal = 60.0 * 4095 / 255
    noisy = expose(levels, sensor=sensor, exposure=1, full_scale=255, rng=np.random.default_rng(7)).astype(float)
    variance = signal / 4.0 + 3.0**2 + 1 / 12
    assert noisy.mean() == pytest.approx(100 + signal, abs=5 * np.sqrt(variance / noisy.size))
    assert noisy.var() == pytest.approx(variance, rel=5 * np.sqrt(2 / noisy.size))


@pytest.mark.slow
@pytest.mark.parametrize("mean", [0.1, 3.0, 19.9, 20.0, 300.0, 15000.0, 1e6])
def test_shot_noise_is_poisson(mean):
    # SciPy's quantiles of large means take long
    uniform = np.random.default_rng(1).random(100_000 if mean < 1e5 else 10_000)
    counts = _poisson(np.full(len(uniform), mean), uniform, stats.norm.ppf(uniform))
    exact = stats.poisson.ppf(uniform, mean)
    assert np.mean(counts != exact) < (0.01 if mean >= 20 else 1e-12)
    assert np.max(np.abs(counts - exact)) <= 1


def test_noise_of_a_pixel_does_not_depend_on_other_pixels():
    sensor = Sensor(bit_depth=12, read_noise_levels=0.8, electrons_per_level=2)
    levels = np.random.default_rng(0).uniform(0, 200, (60, 80))
    other = levels.copy()
    other[10:20, 30:40] = 0
    noisy, changed = (
        expose(image, sensor=sensor, exposure=1, full_scale=255, rng=image_rng(1, light=0, posture=0, exposure=0))
        for image in (levels, other)
    )
    differs = noisy != changed
    assert differs[10:20, 30:40].mean() > 0.9
    differs[10:20, 30:40] = False
    assert not differs.any()


def test_dark_pixels_get_read_noise_but_no_shot_noise():
    levels = np.zeros((200, 200))
    shot_only = Sensor(bit_depth=8, black_level=10, electrons_per_level=5)
    assert (expose(levels, sensor=shot_only, exposure=1, full_scale=255, rng=np.random.default_rng(0)) == 10).all()
    read = Sensor(bit_depth=8, black_level=10, read_noise_levels=2)
    noisy = expose(levels, sensor=read, exposure=1, full_scale=255, rng=np.random.default_rng(0))
    assert noisy.std() == pytest.approx(np.sqrt(4 + 1 / 12), rel=0.02)


def test_without_a_generator_there_is_no_noise():
    sensor = Sensor(bit_depth=8, read_noise_levels=5, electrons_per_level=1)
    assert (expose(np.full((9, 9), 77.0), sensor=sensor, exposure=1, full_scale=255) == 77).all()


def test_highlights_of_any_brightness_are_noisy_without_overflow():
    sensor = Sensor(bit_depth=8, electrons_per_level=60)
    quantised = expose(row(1e30, 1e12), sensor=sensor, exposure=1, full_scale=255, rng=np.random.default_rng(0))
    assert quantised.tolist() == [[255, 255]]


def test_large_image_in_blocks_equals_the_formula_and_is_reproducible():
    levels = np.random.default_rng(1).uniform(0, 300, (900, 1100)).astype(np.float32)
    quantised = expose(levels, sensor=EIGHT_BIT, exposure=1, full_scale=255)
    assert np.array_equal(quantised, np.clip(np.floor(levels.astype(float) + 0.5), 0, 255))
    noisy = Sensor(bit_depth=8, read_noise_levels=1, electrons_per_level=60)
    first, second = (
        expose(levels, sensor=noisy, exposure=1, full_scale=255, rng=image_rng(3, light=1, posture=0, exposure=2))
        for _ in range(2)
    )
    assert np.array_equal(first, second)


def test_generators_of_different_images_are_different_and_of_the_same_image_the_same():
    def draw(seed: int, light: int, posture: int, exposure: int) -> tuple[float, ...]:
        return tuple(image_rng(seed, light=light, posture=posture, exposure=exposure).random(3))

    keys = [(0, 0, 0, 0), (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)]
    assert len({draw(*key) for key in keys}) == len(keys)
    assert draw(5, 1, 2, 3) == draw(5, 1, 2, 3)


@given(st.integers(1, 16), st.floats(0, 1e6), st.floats(1e-3, 100), st.floats(1, 1e4))
def test_delivered_level_is_in_range_and_within_half_a_level(bits: int, level: float, exposure: float, full: float):
    sensor = Sensor(bit_depth=bits)
    delivered = int(expose(row(level), sensor=sensor, exposure=exposure, full_scale=full)[0, 0])
    exact = level * exposure * sensor.max_level / full
    assert 0 <= delivered <= sensor.max_level
    assert abs(delivered - min(exact, sensor.max_level)) <= 0.5 + 1e-9 * exact


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_levels_that_are_not_finite_are_an_error_that_says_where(bad: float):
    levels = np.zeros((400, 800))
    levels[390, 17] = bad
    with pytest.raises(InputError, match="row 390, column 17"):
        expose(levels, sensor=EIGHT_BIT, exposure=1, full_scale=255)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"bit_depth": 0}, "bit_depth"),
        ({"bit_depth": 17}, "bit_depth"),
        ({"bit_depth": 8, "saturation_level": 256}, "saturation_level"),
        ({"bit_depth": 8, "saturation_level": 0}, "saturation_level"),
        ({"bit_depth": 8, "black_level": 255}, "black_level"),
        ({"bit_depth": 8, "black_level": float("nan")}, "black_level"),
        ({"bit_depth": 8, "read_noise_levels": -1}, "read_noise_levels"),
        ({"bit_depth": 8, "electrons_per_level": 0}, "electrons_per_level"),
    ],
)
def test_impossible_sensors_are_refused_by_name(values: dict, named: str):
    with pytest.raises(InputError, match=named):
        Sensor(**values)


def test_all_problems_of_a_sensor_are_reported_at_once():
    with pytest.raises(InputError) as caught:
        Sensor(bit_depth=8, saturation_level=300, read_noise_levels=-1)
    assert len(caught.value.messages) == 2


@pytest.mark.parametrize("values", [{"exposure": 0}, {"exposure": float("nan")}, {"full_scale": -1}])
def test_exposure_and_full_scale_must_be_positive(values: dict):
    with pytest.raises(InputError, match=next(iter(values))):
        expose(row(1), **{"sensor": EIGHT_BIT, "exposure": 1, "full_scale": 255, **values})


def test_wrong_shape_and_negative_seed_are_errors():
    with pytest.raises(InputError, match=r"\(H, W\)"):
        expose(np.zeros(3), sensor=EIGHT_BIT, exposure=1, full_scale=255)
    with pytest.raises(InputError, match="seed"):
        image_rng(-1, light=0, posture=0, exposure=0)


def test_fixed_pattern_is_the_same_in_all_images_and_has_the_spread_of_the_data_sheet():
    sensor = Sensor(bit_depth=12, black_level=100, read_noise_levels=1.0, dsnu_levels=4.0, prnu=0.02)
    frames = {}
    for level in (0.0, 100.0):
        images = [
            expose(
                np.full((300, 500), level), sensor=sensor, exposure=1, full_scale=255, rng=np.random.default_rng(seed)
            )
            for seed in range(8)
        ]
        frames[level] = np.mean(images, axis=0)
    lit = 100.0 * 4095 / 255
    dsnu = frames[0.0].std()
    prnu = np.sqrt(np.var(frames[100.0]) - dsnu**2) / lit
    assert dsnu == pytest.approx(4.0, rel=0.02)
    assert prnu == pytest.approx(0.02, rel=0.02)
    single = expose(np.full((300, 500), 100.0), sensor=sensor, exposure=1, full_scale=255, rng=np.random.default_rng(9))
    assert np.var(single.astype(float)) == pytest.approx(sensor.noise_variance(lit), rel=0.02)
    assert np.var(frames[100.0]) == pytest.approx(sensor.noise_variance(lit, frames=8), rel=0.02)


def test_without_noise_pixels_are_alike():
    sensor = Sensor(bit_depth=8, dsnu_levels=4.0, prnu=0.02)
    assert np.ptp(expose(np.full((20, 20), 100.0), sensor=sensor, exposure=1, full_scale=255)) == 0


def test_linearity_error_is_that_of_the_standard():
    """Mean deviation from the line with the least relative deviations, from 5 to 95 % of saturation."""
    sensor = Sensor(bit_depth=16, black_level=500, linearity_error=0.003)
    levels = np.linspace(0, 255, 501)
    found = expose(levels[None], sensor=sensor, exposure=1, full_scale=255)[0].astype(float) - 500
    exact = levels * 65535 / 255
    top = 65535 - 500
    used = (exact >= 0.05 * top) & (exact <= 0.95 * top)
    x, y = exact[used], found[used]
    line = np.stack([np.ones_like(x), x], axis=1)
    fit = line @ np.linalg.lstsq(line / y[:, None], np.ones_like(y), rcond=None)[0]
    assert np.mean(np.abs(y - fit) / fit) == pytest.approx(0.003, rel=0.03)
    assert found[0] == 0
    assert (np.diff(found) >= 0).all()
    assert found[-1] == top


@pytest.mark.parametrize("key", ["dsnu_levels", "prnu", "linearity_error"])
def test_negative_figures_are_refused(key):
    with pytest.raises(InputError, match=key):
        Sensor(bit_depth=8, **{key: -0.1})
