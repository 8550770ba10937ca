"""What a fit must not hide: values out of range, unbounded ends, a climb that did not end, noise and misfit."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lightopt import load_rig
from lightopt.core.errors import InputError
from lightopt.estimate.reflectance import FitResult, FittedValue, _fit, _fit_samples, format_interval
from lightopt.estimate.reflectance._estimate import Estimate, Optimum, ScanPoint, has_settled, maximise, profile_regions
from lightopt.estimate.reflectance._likelihood import Evaluation
from lightopt.estimate.reflectance._quality import convergence_warnings, poor_fit_warnings, refuse_out_of_range
from lightopt.estimate.reflectance._result import bounded, separate_region_warnings
from lightopt.estimate.reflectance._sigma_scan import peaks, profile_over_sigma
from lightopt.estimate.reflectance._validation import Comparison, LeftOut, validation_warnings
from lightopt.estimate.reflectance._vector import DARK, FIRST_GAIN, LOG_SIGMA, R_D, parameter_name
from lightopt.optics import SpecularModel


class Landscape:
    """A criterion of R_d and ln σ that is written down here."""

    size = FIRST_GAIN + 1 + 2
    sigma_range = -6.0, 0.0

    def __init__(self, value, *, gradient=None, bend=4.0):
        self.value, self.given, self.bend = value, gradient, bend

    def evaluate(self, x):
        gradient = np.zeros(self.size)
        for place in (R_D, LOG_SIGMA):
            ahead, behind = x.copy(), x.copy()
            ahead[place] += 1e-5
            behind[place] -= 1e-5
            gradient[place] = (self.value(ahead) - self.value(behind)) / 2e-5
        if self.given is not None:
            gradient[:] = self.given
        return Evaluation(self.value(x), gradient, self.bend * np.eye(self.size))


def at(r_d, log_sigma):
    x = np.zeros(Landscape.size)
    x[R_D], x[LOG_SIGMA] = r_d, log_sigma
    return x


# --- the optimiser


def test_a_climb_ends_at_the_maximum():
    found = maximise(Landscape(lambda x: -((x[R_D] - 3.0) ** 2)), at(1.0, -2.0), [R_D])
    assert found.converged
    assert found.unsettled == ()
    assert found.x[R_D] == pytest.approx(3.0, abs=0.01)


def test_a_climb_that_stalls_where_the_criterion_still_rises_has_not_converged():
    """Each step promises 6 nat and none of them keeps it, however much it is damped."""
    slope = np.zeros(Landscape.size)
    slope[LOG_SIGMA] = 5.0
    found = maximise(Landscape(lambda x: -abs(x[LOG_SIGMA] + 2.0), gradient=slope), at(1.0, -2.0), [R_D, LOG_SIGMA])
    assert not found.converged
    assert found.unsettled == (LOG_SIGMA,)
    assert parameter_name(found.unsettled[0], ("one",)) == "σ"


def test_too_few_steps_have_not_converged():
    found = maximise(Landscape(lambda x: -((x[R_D] - 3.0) ** 4)), at(-9.0, -2.0), [R_D], most_steps=3)
    assert not found.converged
    assert parameter_name(found.unsettled[0], ("one",)) == "R_d"


def test_a_step_that_is_short_beside_the_standard_error_is_none():
    found = maximise(Landscape(lambda x: -((x[R_D] - 3.0) ** 4)), at(-9.0, -2.0), [R_D], most_steps=3)
    left = abs(float(found.evaluation.gradient[R_D])) / 4.0  # by a curvature of 4
    assert not has_settled(found, [R_D], np.array([9.0 * left]))
    assert has_settled(found, [R_D], np.array([11.0 * left]))


def test_fits_without_a_light_that_did_not_converge_are_counted_and_named():
    """Those that intervals come from, and those of validation."""
    found = SimpleNamespace(maximum=SimpleNamespace(converged=True), unsettled_refits=3, scatter="12 lights", optima=())
    (said,) = convergence_warnings(found)
    assert said.startswith("3 of the fits without one of the 12 lights each did not converge")
    image = Comparison(image="a", rms=1.0, rms_sensor=1.0, iou=None, border=None, area=0, predicted_area=0)
    left_out = tuple(
        LeftOut(light=name, x=at(45.0, -2.3), images=(image,), converged=name != "two") for name in ("one", "two")
    )
    (said,) = validation_warnings(left_out, SimpleNamespace(max_level=255))
    assert "1 of the 2 fits without one light each did not converge (without two)" in said
    assert left_out[1].as_dict()["converged"] is False
    result = FitResult(
        kind="specular", method="likelihood", model=SpecularModel(), points=4, values=(), fitted=(), left_out=left_out
    )
    assert not result.converged
    assert replace(result, left_out=left_out[:1]).converged


def test_the_optimum_of_the_most_value_on_all_samples_is_the_best():
    """Whatever the few pixels of the scan prefer; climbs that ended in the same place are one."""

    def found(log_sigma, value, *, far=False):
        top = SimpleNamespace(x=at(1.0, log_sigma), value=value, converged=True)
        return Optimum(0.1, top, None), None if far else SimpleNamespace(maximum=top)

    ends = [found(-3.0, 5.0), found(-2.0, 9.0), found(-2.01, 8.0), found(-1.0, -99.0, far=True)]
    best, kept = _fit_samples.best_first(ends)
    assert best is ends[1][1]
    assert [optimum.top.value for optimum, _ in kept] == [9.0, 5.0, -99.0]


def test_a_profile_over_sigma_finds_every_peak_and_the_best_first():
    def value(x):
        ln = x[LOG_SIGMA]
        two = 3.0 * math.exp(-((ln + 4.0) ** 2)) + 5.0 * math.exp(-((ln + 1.0) ** 2))
        return 1000.0 * (two - (x[R_D] + ln) ** 2)

    row = [float(ln) for ln in np.linspace(-6.0, 0.0, 25)]
    profile = profile_over_sigma(
        lambda _: Landscape(value, bend=2000.0), lambda number: [at(0.0, row[number])], row, [R_D, LOG_SIGMA]
    )
    tops = peaks(profile)
    assert [round(float(top.x[LOG_SIGMA]), 2) for top in tops] == [-1.0, -4.0]
    assert all(one.x[R_D] == pytest.approx(-one.x[LOG_SIGMA], abs=0.05) for one in profile)


# --- values


@pytest.mark.parametrize(
    ("sigma", "r_s", "word"),
    [(0.0009, 1e3, "lower end"), (0.001, 1e3, "lower end"), (0.2, 1e3, "upper end"), (0.28, 1e3, "upper end"),
     (0.05, 1e12, "without an upper bound")],
)  # fmt: skip
def test_values_out_of_the_documented_range_are_refused(sigma, r_s, word):
    with pytest.raises(InputError, match=word):
        refuse_out_of_range(SimpleNamespace(sigma=sigma, R_s=r_s), 1e3, SpecularModel())


def test_values_of_the_documented_range_are_not():
    for sigma in (0.0011, 0.05, 0.19):
        refuse_out_of_range(SimpleNamespace(sigma=sigma, R_s=1e6), 1e3, SpecularModel())


def test_an_end_that_nothing_bounds_is_none():
    interval = bounded((math.log(0.0444), math.inf), math.exp)
    assert interval == (pytest.approx(0.0444), None)
    value = FittedValue(name="sigma_rad", value=0.05, standard_error=0.1, interval=interval)
    assert json.loads(json.dumps(value.as_dict()))["interval_95"] == [pytest.approx(0.0444), None]


def test_it_is_said_in_words():
    assert format_interval((0.0444, None)) == "from 0.0444, no upper bound"
    assert format_interval((None, 3.0)) == "up to 3, no lower bound"
    assert format_interval((1.0, 2.0)) == "1 to 2"


# --- reasons of a poor fit


def poor(*, free=(), lights=(0, 1)):
    """A fit to images of some lights that the model does not describe."""
    light = np.array(lights)
    samples = SimpleNamespace(facts=SimpleNamespace(light=light), image=np.arange(len(light)))
    criterion = SimpleNamespace(samples=samples, size=FIRST_GAIN + 2 + 2)
    found = SimpleNamespace(free=(R_D, *free), criterion=criterion, scatter="4 lights", describes=False)
    quality = SimpleNamespace(noise=1.0, image_noise=1.0, describes=False, misfit=4.0, rms=4.0)
    return found, quality


def test_only_what_was_not_fitted_is_a_possible_reason():
    everything = ("register the part", "fit the gains", "fit it")
    for options, placed, left in (
        ({}, False, everything),
        ({}, True, ("fit the gains", "fit it")),
        ({"free": (DARK,)}, False, ("register the part", "fit the gains")),
        ({"free": (FIRST_GAIN + 1,)}, True, ("fit it",)),
        ({"lights": (1, 1)}, True, ("fit it",)),
    ):
        (said,) = poor_fit_warnings(*poor(**options), placed=placed)
        assert "dirt, the mesh's normals" in said
        assert [option for option in everything if option in said] == list(left)


# --- intervals over several optima

FIRST, SECOND = -3.0, -1.5


def two_optima(drop):
    """A criterion of ln σ with two parabolas, the second `drop` below the first: twice the fall; and its estimate."""

    def value(x):
        ln = x[LOG_SIGMA]
        return -min(200.0 * (ln - FIRST) ** 2, 200.0 * (ln - SECOND) ** 2 + 0.5 * drop)

    criterion = Landscape(value, bend=400.0)
    tops = [maximise(criterion, at(0.0, start), [LOG_SIGMA]) for start in (FIRST - 0.05, SECOND + 0.05)]
    optima = tuple(Optimum(0.1, top, criterion) for top in tops)
    return Estimate(
        x=tops[0].x,
        free=(LOG_SIGMA,),
        covariance=np.array([[1.0 / 400.0]]),
        inflation=np.ones(1),
        criterion=criterion,
        maximum=tops[0],
        scan=(),
        optima=optima,
        mean_log_likelihood=0.0,
        unexplained=0.0,
    )


def profile_interval(found, place):
    """From the lowest region to the highest."""
    regions = profile_regions(found, place)
    return regions[0][0], regions[-1][1]


def half(fall):
    """From a maximum to where twice the criterion has fallen by so much."""
    return math.sqrt(fall / 400.0)


def test_an_interval_reaches_over_an_optimum_that_the_images_do_not_exclude():
    found = two_optima(1.0)
    critical = found.critical
    first, second = profile_regions(found, LOG_SIGMA)
    assert first == (pytest.approx(FIRST - half(critical), abs=2e-3), pytest.approx(FIRST + half(critical), abs=2e-3))
    assert second == (
        pytest.approx(SECOND - half(critical - 1.0), abs=2e-3),
        pytest.approx(SECOND + half(critical - 1.0), abs=2e-3),
    )
    assert profile_interval(found, LOG_SIGMA) == (first[0], second[1])
    value = FittedValue(
        name="sigma_rad",
        value=found.sigma,
        interval=bounded((first[0], second[1]), math.exp),
        regions=tuple(bounded(ends, math.exp) for ends in (first, second)),
    )
    assert len(value.as_dict()["regions_95"]) == 2
    (said,) = separate_region_warnings([value])
    assert "do not decide between separate ranges (sigma_rad 0.045" in said


def test_an_interval_does_not_reach_over_one_that_they_do():
    found = two_optima(4.0)
    assert profile_regions(found, LOG_SIGMA) == (profile_interval(found, LOG_SIGMA),)
    assert profile_interval(found, LOG_SIGMA)[1] == pytest.approx(FIRST + half(found.critical), abs=2e-3)
    wide = replace(found, inflation=np.array([1.1]))
    assert profile_interval(wide, LOG_SIGMA)[1] > SECOND


def test_an_interval_reaches_every_point_of_the_scan_that_is_not_excluded():
    row = [(-3.3, 36.0), (-3.05, 1.0), (-2.7, 36.0), (-1.6, 2.0), (-1.4, 3.0), (-1.2, 50.0)]
    scan = tuple(ScanPoint(x=at(0.0, ln), value=-0.5 * fall, drop=fall) for ln, fall in row)
    found = replace(two_optima(1.0), optima=(), scan=scan)
    first, second = profile_regions(found, LOG_SIGMA)
    assert first[1] == pytest.approx(FIRST + half(found.critical), abs=2e-3)
    assert second == (-1.6, -1.4)


# --- on the command line


@pytest.fixture(scope="module")
def noisy(shared_bench, tmp_path_factory):
    """Images of the knob with noise of 2 levels and 30 electrons per level."""
    from lightopt.cli._main import run

    folder = tmp_path_factory.mktemp("noisy")
    rig = folder / "noisy.yaml"
    text = shared_bench.rig.read_text(encoding="utf-8")
    rig.write_text(
        text.replace(
            "read_noise_levels: 0.8, electrons_per_level: 60", "read_noise_levels: 2, electrons_per_level: 30"
        ),
        encoding="utf-8",
    )
    words = ("render", rig, shared_bench.part, "-o", folder / "set", "-q", "--patches", "500", "--noise", "3")
    assert run([str(word) for word in (*words, "--exposure", "1,1/16")]) == 0
    return folder / "set"


def fit(cli, bench, images, out, *more, rig=None, pixels=1500):
    return cli(
        "fit-specular", rig or bench.rig, bench.part, images, "-o", out, "--joint", "--no-validate",
        "--pixels", pixels, *more,
    )  # fmt: skip


@pytest.mark.slow
def test_the_noise_of_the_images_is_written_into_the_rig(cli, bench, noisy):
    first = fit(cli, bench, noisy, bench.out, "--write-noise", pixels=5_000)
    assert first.status == 0
    assert "by the rig file: give read_noise_levels" in first.err
    assert "noise written" in first.out
    written = load_rig(bench.out / "rig.fitted.yaml").camera.sensor
    figures = json.loads((bench.out / "fit.json").read_text())["noise"]
    assert written.read_noise_levels == pytest.approx(2.0, rel=0.1)
    assert written.electrons_per_level == pytest.approx(30.0, rel=0.25)
    assert abs(figures["read_noise_levels"] - 2.0) < 4.0 * figures["read_noise_standard_error"]
    before, after = (bench.rig.read_text().splitlines(), (bench.out / "rig.fitted.yaml").read_text().splitlines())
    assert [a for a, b in zip(after, before, strict=True) if a != b] == [
        line for line in after if "read_noise_levels" in line
    ]
    again = fit(cli, bench, noisy, bench.folder / "again", rig=bench.out / "rig.fitted.yaml", pixels=5_000)
    assert (again.status, again.err) == (0, "")


@pytest.mark.slow
def test_the_noise_of_dull_pixels_is_written_into_the_rig(cli, bench, noisy):
    ran = cli("fit-diffuse", bench.rig, bench.part, noisy, "-o", bench.out, "--pixels", 6000, "--write-noise")
    assert ran.status == 0
    assert "noise written" in ran.out
    assert str(bench.out / "rig.fitted.yaml") in ran.out.splitlines()
    written = load_rig(bench.out / "rig.fitted.yaml").camera.sensor
    figures = json.loads((bench.out / "fit.json").read_text())["noise"]
    assert written.read_noise_levels == pytest.approx(figures["read_noise_levels"], rel=1e-3)
    assert written.read_noise_levels == pytest.approx(2.0, rel=0.2)


@pytest.mark.slow
@pytest.mark.usefixtures("few_pixels_for_the_rest")
def test_a_misfit_is_not_written_as_noise(cli, bench, noisy, monkeypatch):
    from lightopt.estimate.reflectance import _fit_samples, _quality

    for module in (_fit_samples, _quality):
        monkeypatch.setattr(module, "MOST_MISFIT", 0.1)
    ran = fit(cli, bench, noisy, bench.out, "--write-noise")
    assert ran.status == 0
    assert "the noise is not written: the model does not describe these images" in ran.err
    assert "least squares" in ran.err
    assert not (bench.out / "rig.fitted.yaml").exists()
    figures = json.loads((bench.out / "fit.json").read_text())
    assert figures["criterion"] == "least squares"
    assert figures["uncertainty_from"] == "4 lights and postures"
    assert figures["noise"]["read_noise_levels"] is None
    assert figures["noise"]["hindrance"].startswith("the model does not describe these images")


@pytest.mark.slow
def test_what_did_not_converge_is_said_and_exits_1(cli, bench, noisy, monkeypatch):
    def few_steps(criterion, x, free, **options):
        return maximise(criterion, x, free, **{**options, "most_steps": 2})

    monkeypatch.setattr(_fit_samples, "maximise", few_steps)
    monkeypatch.setattr(_fit_samples, "MOST_TABLES", 1)
    # a fit that did not end is poor: other places are looked for, which is tested elsewhere
    monkeypatch.setattr(_fit, "refuse_unexplained_images", lambda *_, **__: None)
    ran = fit(cli, bench, noisy, bench.out, pixels=1500)
    assert ran.status == 1
    assert "did not converge" in ran.err
    assert "still improves along" in ran.err
    assert json.loads((bench.out / "fit.json").read_text())["converged"] is False
    assert (bench.out / "part.fitted.yaml").exists()
    allowed = fit(cli, bench, noisy, bench.out, "--allow-unconverged", "--force", pixels=1500)
    assert allowed.status == 0
    assert "did not converge" in allowed.err


@pytest.mark.slow
def test_the_first_fit_of_fit_diffuse_has_to_converge_too(cli, bench, noisy, monkeypatch):
    """Where the highlights are comes from it, and R_d from the pixels beside."""

    def few_steps(criterion, x, free, **options):
        whole = LOG_SIGMA in free
        return maximise(criterion, x, free, **({**options, "most_steps": 2} if whole else options))

    monkeypatch.setattr(_fit_samples, "maximise", few_steps)
    monkeypatch.setattr(_fit_samples, "MOST_TABLES", 1)
    monkeypatch.setattr(_fit, "refuse_unexplained_images", lambda *_, **__: None)
    ran = cli("fit-diffuse", bench.rig, bench.part, noisy, "-o", bench.out, "--pixels", 6000)
    assert ran.status == 1
    assert "first fit, which locates the highlights: the fit did not converge" in ran.err
    assert json.loads((bench.out / "fit.json").read_text())["converged"] is False


@pytest.mark.slow
@pytest.mark.usefixtures("few_pixels_for_the_rest")
def test_a_search_for_the_place_that_did_not_converge_exits_1(cli, bench, noisy, monkeypatch):
    from lightopt.estimate.registration import _registration

    monkeypatch.setattr(_registration, "STAGE_ITERATIONS", 1)
    monkeypatch.setattr(_registration, "STAGES", 1)
    monkeypatch.setattr(_fit, "refuse_unexplained_images", lambda *_, **__: None)
    ran = fit(cli, bench, noisy, bench.out, "--register", pixels=1000)
    assert ran.status == 1
    assert "the registration did not converge" in ran.err
    facts = json.loads((bench.out / "fit.json").read_text())
    assert facts["converged"] is False
    assert facts["registration"]["converged"] is False
    assert facts["registration"]["iterations"] >= 1


@pytest.mark.slow
@pytest.mark.parametrize("more", [pytest.param((), marks=pytest.mark.nightly), ("--free", "gain")])
def test_the_profile_that_is_drawn_peaks_at_the_reported_value(cli, bench, noisy, more):
    assert fit(cli, bench, noisy, bench.out, *more).status == 0
    figures = json.loads((bench.out / "fit.json").read_text())
    drawn = min(figures["ridge"], key=lambda point: point["twice_log_likelihood_below_best"])
    sigma = figures["values"]["sigma_rad"]["value"]
    assert drawn["sigma_rad"] == sigma
    assert figures["optima"][0]["sigma"] == sigma
    assert figures["optima"][0]["R_s"] == figures["values"]["R_s"]["value"]
    compared = [optimum["value"] for optimum in figures["optima"]]
    assert compared == sorted(compared, reverse=True)
    assert figures["converged"] is True
