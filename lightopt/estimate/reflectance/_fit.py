"""The two fits, diffuse and specular: from a rig, a part and images to reflectance."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.estimate.reflectance import _form_parameters, _quality, _result, _validation
from lightopt.estimate.reflectance._estimate import Estimate, FreeParameters
from lightopt.estimate.reflectance._fit_samples import fit_reflectance, refit
from lightopt.estimate.reflectance._mismatch_causes import refuse_unexplained_images
from lightopt.estimate.reflectance._paper import PaperDiffuse, PaperSpecular, paper_diffuse, paper_specular
from lightopt.estimate.reflectance._result import FitResult, FittedValue, RegionFit
from lightopt.estimate.reflectance._samples import Samples, relit, subsample
from lightopt.estimate.reflectance._setup import FitOptions, FitSetup, Points, prepare_fit
from lightopt.estimate.reflectance._validation import ModelRow, PointsRow, SavePrediction
from lightopt.estimate.reflectance._vector import FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D
from lightopt.images import ImageSet
from lightopt.optics import LAMBERT, ModelName, Reflectance, farthest_exponent
from lightopt.scene import coarse_points, scene_of_region

HIGHLIGHT_LEVEL = 0.1  # pixels that a highlight lights by less than this are diffuse only [grey level at exposure 1]
# for that, the lobe is taken this much wider than it was found, as far as any pixels are left: real lobes have heavier
# tails than a Gaussian, and what is left of them goes into R_d
WIDENINGS = (2.0, 1.5, 1.2, 1.0)
MODELS: tuple[ModelName, ...] = ("torrance-sparrow", "ggx", "two-lobe")  # the simplest first
MODEL_MARGIN = 1.02  # a simpler form is kept where it predicts lights that are left out this much worse, or less
LEAST_PIXELS = 200  # so many pixels must be left
LEAST_R_S = 1e-3
_Fitted = tuple[FitResult, FitSetup, Samples]
_Form = _form_parameters.FittedParameter | _form_parameters.WideLobe | None
_FittedLobe = tuple[_Fitted, tuple[ModelRow, ...]]  # and the forms of the lobe that were tried
# second opinions: their pixels per octave, light and posture, the least change of ln R_s or ln σ to report, and the
# least for twice the logarithm of the likelihoods' ratio
SECOND_BUDGET = 250
LEAST_DIFFERENCE, LEAST_RATIO = 0.005, 100.0
LEAST_PAPER_DIFFERENCE = 0.05  # the paper's σ is a multiple of a step


def fit_diffuse(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    options: FitOptions | None = None,
    run: RunContext | None = None,
) -> FitResult:
    """Fit R_d to the pixels that are away from every highlight, which a fit of the whole model finds first.

    options: Of the numbers of points only the first is used.
    Raises InputError: images that are not the rig's or not the part's, or that do not determine R_d.
    """
    options, run = options or FitOptions(), run or RunContext()
    points = options.points[0] if options.points else None
    setup = prepare_fit(rig, part, image_set, points, options, run)
    try:
        result = _fit_diffuse(setup)
    except InputError as error:
        result = _unfitted_outside(setup, error, "diffuse")
    result = _with_regions(result, setup, _fit_diffuse)
    run.warn(*result.warnings)
    return result


def _fit_diffuse(setup: FitSetup) -> FitResult:
    options, run = setup.options, setup.run
    if options.method == "paper":
        samples = setup.collect(uniform=True)
        return _paper_result(setup, samples, paper_diffuse(samples, options.paper))
    samples = setup.collect()
    freed = FreeParameters(gain=options.gain, dark=options.dark)
    whole = fit_reflectance(samples, freed=freed, run=run)
    first_quality = _quality.assess_quality(samples, whole)
    placed = refuse_unexplained_images(setup, samples, whole, first_quality)
    plain, widening, found, quality = samples, max(WIDENINGS), whole, first_quality
    # the tails of GGX leave no pixel to diffuse light alone
    if samples.model.name != "ggx":
        plain, widening = _diffuse_only(samples, whole)
        held = np.array([whole.R_d, LEAST_R_S, whole.sigma])
        found = fit_reflectance(plain, freed=replace(freed, specular=False), held=held, run=run)
        quality = _quality.assess_quality(plain, found)
    located = () if found is whole else _quality.convergence_warnings(whole)
    first = [f"first fit, which locates the highlights: {text}" for text in located]
    warnings = [*setup.warnings, *first, *_quality.convergence_warnings(found)]
    warnings += _quality.poor_fit_warnings(found, quality, placed=placed)
    if widening < max(WIDENINGS):
        warnings.append(
            f"few pixels are away from the highlights: R_d was fitted to those beyond {widening:g} times the width of "
            "the fitted lobe. If the true lobe has heavier tails than a Gaussian, R_d is too high"
        )
    values = _result.fitted_values(found, full_scale=setup.scene.reflectance.full_scale, model=samples.model)[:1]
    held = _unfitted(setup, "diffuse").values[1:]
    result = _likelihood_result("diffuse", setup, plain, found, quality, (*values, *held), warnings)
    pixels, estimate = len(np.unique(found.criterion.samples.sample)), replace(found, scan=whole.scan)
    return replace(result, highlight_fit=None if found is whole else whole, pixels=pixels, estimate=estimate)


def _unfitted(setup: FitSetup, kind: Literal["diffuse", "specular"]) -> FitResult:
    # with the values of the part file
    own = setup.scene.reflectance
    values = {"R_d": own.R_d, "R_s": own.R_s, own.model.width_key: own.model.width_factor * own.sigma}
    return FitResult(
        kind=kind,
        method="likelihood",
        model=own.model,
        diffuse=own.diffuse,
        points=setup.scene.lights[0].points,
        values=tuple(FittedValue(name=name, value=value) for name, value in values.items()),
        fitted=(),
        registration=setup.registration,
        file_placement=setup.file_placement,
        warnings=setup.warnings,
    )


def fit_specular(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    options: FitOptions | None = None,
    run: RunContext | None = None,
    save_prediction: SavePrediction | None = None,
) -> FitResult:
    """Fit R_s and σ, and R_d where ``options.joint``.

    options: Each number of points is fitted, and the one under which the images are likeliest is kept. With model
        auto so is each form of the lobe; kept is the one that predicts the images of left-out lights best.
    save_prediction: Called with each image that validation predicted without having seen it, and its prediction.
    Raises InputError: images that are not the rig's or not the part's, or that do not determine R_s and σ.
    """
    options, run = options or FitOptions(), run or RunContext()
    if options.diffuse is not None and not options.joint:
        raise InputError("another form of the diffuse component has another R_d: fit that, too, with option 'joint'")
    choices: list[Points | None] = [*options.points] or [None]

    def prepared(points: Points | None, model: ModelName | None) -> FitSetup:
        return prepare_fit(rig, part, image_set, points, options, run, model=model)

    try:
        first, models = _fit_lobe(lambda model: prepared(choices[0], model), options)
    except InputError as error:
        if not part.regions or len(choices) > 1:
            raise
        setup = prepared(choices[0], None)
        result = _with_regions(_unfitted_outside(setup, error, "specular"), setup, _fit_specular_region)
        run.warn(*result.warnings)
        return result
    tried = [first, *(_fit_one(prepared(points, first[0].model.name)) for points in choices[1:])]
    rows = tuple(_points_row(result, setup) for result, setup, _ in tried) if len(tried) > 1 else ()
    best = max(range(len(rows)), key=lambda number: rows[number].rank, default=0)
    result, setup, samples = tried[best]
    result = replace(result, rows=rows, models=models)
    if result.estimate is not None and "auto" not in options.points:
        result = replace(result, warnings=(*result.warnings, *_evenly_lit_warnings(setup, samples, result.estimate)))
    result = _with_regions(_validated((result, setup, samples), save_prediction), setup, _fit_specular_region)
    run.warn(*result.warnings)
    return result


def _fit_lobe(prepared: Callable[[ModelName | None], FitSetup], options: FitOptions) -> _FittedLobe:
    # with the form of the lobe that the options name or, if they want it chosen, that predicts lights that are left out
    # best; the simplest of those about as good
    if options.model != "auto":
        return _fit_one(prepared(options.model)), ()
    if options.method == "paper":
        raise InputError("the paper's method knows one Gaussian lobe: there is no form of the lobe to choose")
    rows: list[ModelRow] = []
    fits: dict[str, _Fitted] = {}
    for model in MODELS:
        setup = prepared(model)
        if len({o.light for o in setup.observations}) < 2:
            raise InputError("model auto: expected images under at least two lights, to predict each; give the model")
        try:
            result, setup, samples = fits[model] = _fit_one(setup)
        except InputError as error:
            # a form that these images do not determine, such as two lobes of a surface that has one
            rows.append(ModelRow(model=model, refused=error.args[0]))
            continue
        assert result.estimate is not None
        left_out = _validation.leave_lights_out(setup, samples, result.estimate)
        rows.append(_validation.model_row(model, left_out, result.estimate))
    least = min((row.rms for row in rows if row.rms is not None), default=None)
    if least is None:
        raise InputError(*(f"model {row.model}: {row.refused}" for row in rows))
    chosen = next(row.model for row in rows if row.rms is not None and row.rms <= MODEL_MARGIN * least)
    return fits[chosen], tuple(rows)


def _validated(fitted: _Fitted, save_prediction: SavePrediction | None = None) -> FitResult:
    result, setup, samples = fitted
    if not setup.options.validate or result.estimate is None:
        return result
    left_out = _validation.leave_lights_out(setup, samples, result.estimate, save_prediction)
    noted = _validation.validation_warnings(left_out, setup.scene.sensor)
    return replace(result, left_out=left_out, warnings=(*result.warnings, *noted))


def _fit_specular_region(setup: FitSetup) -> FitResult:
    start = setup if setup.options.diffuse is None else setup.with_form(LAMBERT)
    fitted, models = _fit_lobe(start.with_lobe, setup.options)
    return replace(_validated(fitted), models=models)


def _unfitted_outside(setup: FitSetup, error: InputError, kind: Literal["diffuse", "specular"]) -> FitResult:
    # of a part whose surface outside the regions is not determined by the images
    if not setup.scene.regions or setup.options.gain or setup.options.dark:
        raise error
    refused = f"outside the regions: not fitted, it keeps the reflectance of the part file: {error.args[0]}"
    return replace(_unfitted(setup, kind), warnings=(*setup.warnings, refused))


def _with_regions(result: FitResult, setup: FitSetup, fit: Callable[[FitSetup], FitResult]) -> FitResult:
    # and the fits of the part's regions, with the placement, gains and dark level of the first
    if not setup.scene.regions:
        return result
    scene, gains = setup.scene, {name: gain.value for name, gain in (result.gains or {}).items()}
    lights = tuple(replace(light, gain=gains.get(light.name, light.gain)) for light in scene.lights)
    black = scene.sensor.black_level if result.dark is None else result.dark.value
    scene = replace(scene, lights=lights, sensor=replace(scene.sensor, black_level=black))
    options = replace(setup.options, gain=False, dark=False)

    def fitted(number: int, name: str) -> RegionFit:
        try:
            region = replace(setup, scene=scene_of_region(scene, number), options=options)
            return RegionFit(name=name, result=fit(region))
        except InputError as error:
            return RegionFit(name=name, refused=error.args[0])

    regions = tuple(fitted(number, region.name) for number, region in enumerate(scene.regions, 1))
    if not result.fitted and not any(region.result for region in regions):
        raise InputError(result.warnings[-1], *(f"region {one.name}: {one.refused}" for one in regions))
    noted = [f"region {one.name}: {text}" for one in regions for text in one.warnings]
    return replace(result, regions=regions, warnings=(*result.warnings, *noted))


def _fit_one(setup: FitSetup) -> _Fitted:
    options, reflectance = setup.options, setup.scene.reflectance
    if options.method == "paper":
        samples = setup.collect(uniform=True)
        record = paper_specular(samples, options.paper, R_d=reflectance.R_d, progress=setup.run.stage("sweeping σ"))
        return _paper_result(setup, samples, record), setup, samples
    formed, setup, samples = _with_fitted_form(setup, setup.collect())
    found = fit_reflectance(samples, freed=options.freed, held=setup.held, run=setup.run)
    quality = _quality.assess_quality(samples, found)
    placed = refuse_unexplained_images(setup, samples, found, quality)
    _quality.refuse_out_of_range(found, float(found.R_s * samples.specular(found.sigma).max()), samples.model)
    values = _result.fitted_values(found, full_scale=reflectance.full_scale, model=samples.model)
    if formed is not None:
        values = formed.values(found, values, samples.model)
    interval = next(v.interval for v in values if v.name == "R_s")
    shorter = len({o.exposure for o in setup.observations}) > 1
    warnings = [*setup.warnings, *_quality.convergence_warnings(found), *_result.separate_region_warnings(values)]
    warnings += _quality.fit_warnings(found, quality, interval, shorter=shorter, placed=placed)
    result = _likelihood_result("specular", setup, samples, found, quality, values, warnings)
    if isinstance(formed, _form_parameters.FittedParameter):
        result = replace(result, fitted=(*result.fitted, values[-1].name))
    return replace(result, correlation=found.correlation(LOG_R_S, LOG_SIGMA)), setup, samples


def _with_fitted_form(setup: FitSetup, samples: Samples) -> tuple[_Form, FitSetup, Samples]:
    # what of the form is fitted, and setup and samples with it
    options, model, form = setup.options, samples.model, setup.scene.reflectance.diffuse
    name = options.diffuse if options.diffuse in ("exponent", "oren-nayar") else None
    if model.name == "two-lobe":
        if name is not None:
            raise InputError("model two-lobe: the diffuse form is not fitted at once; give it in the part file")
        wide = _form_parameters.fit_wide_lobe(samples, freed=options.freed, held=setup.held, run=setup.run)
        return wide, setup.with_model(wide.model), replace(samples, model=wide.model)
    if name is None and options.joint and model.across_ratio > 1.0:
        name = "across"
    if name is None:
        return None, setup, samples
    found = _form_parameters.fit_form_parameter(samples, name, caster=setup.caster, freed=options.freed, run=setup.run)
    model, form = _form_parameters.changed_form(model, form, name, found.value)
    if name == "across":
        return found, setup.with_model(model), replace(samples, model=model)
    return found, setup.with_form(form), relit(samples, setup.caster, form=form)


def _likelihood_result(
    kind: Literal["diffuse", "specular"],
    setup: FitSetup,
    samples: Samples,
    found: Estimate,
    quality: _quality.Quality,
    values: tuple[FittedValue, ...],
    warnings: Sequence[str],
) -> FitResult:
    options, own = setup.options, setup.scene.reflectance
    noise = _quality.measure_noise(samples, _quality.mean_levels(samples, found), describes=quality.describes)
    dark = _result.fitted_dark(setup.scene, found) if options.dark else None
    more = [*_quality.noise_warnings(noise)] if options.write_noise else []
    fitted = ("R_d",)
    if kind == "specular":
        fitted = (*(fitted if options.joint else ()), *_result.fitted_names(samples.model))
        coarse = (coarse_points(light, replace(own, sigma=found.sigma)) for light in setup.scene.lights)
        more += [text for text in coarse if text is not None]
    return replace(
        _unfitted(setup, kind),
        model=samples.model,
        values=values,
        fitted=fitted,
        gains=_result.fitted_gains(setup.scene, found) if options.gain else None,
        dark=dark,
        noise=noise,
        write_noise=options.write_noise,
        # least squares have done with fewer
        observations=len(found.criterion.samples.sample),
        pixels=len(found.criterion.samples.diffuse),
        quality=quality,
        warnings=(*warnings, *more, *_result.negative_black_level_warnings(dark)),
        estimate=found,
    )


def _points_row(result: FitResult, setup: FitSetup) -> PointsRow:
    if result.estimate is not None:
        return _validation.compare_regions(setup, result.estimate.x, result.estimate.mean_log_likelihood)
    x = np.zeros(FIRST_GAIN + len(setup.scene.lights))
    x[R_D] = result.value("R_d")
    x[LOG_R_S] = math.log(max(result.value("R_s"), LEAST_R_S))
    x[LOG_SIGMA] = math.log(result.value("sigma_rad"))
    return _validation.compare_regions(setup, x, None)


def _diffuse_only(samples: Samples, found: Estimate) -> tuple[Samples, float]:
    # the observations that a lobe wider than the one found leaves dark, and how much wider it was taken
    x = found.x
    peak = max(found.R_s, LEAST_R_S) * float(np.exp(np.max(np.abs(x[FIRST_GAIN:-2]))))
    lobe = Reflectance(R_d=0.0, R_s=1.0, sigma=found.sigma, model=samples.model).lobe
    # in σ
    reach = math.sqrt(2.0 * farthest_exponent(math.log(max(peak / HIGHLIGHT_LEVEL, 1.0)), lobe))
    deflection = samples.deflection[samples.sample]
    lit = samples.diffuse[samples.sample] > 0.0
    unlit = deflection == np.pi
    for widening in WIDENINGS:
        plain = lit & (deflection > widening * found.sigma * reach)
        if np.count_nonzero(plain & ~samples.saturated) >= LEAST_PIXELS:
            return samples.select(plain | unlit), widening
    raise InputError("no diffuse-only pixel: add images under other lights, or use fit-specular with option 'joint'")


def _evenly_lit_warnings(setup: FitSetup, samples: Samples, found: Estimate) -> Iterator[str]:
    # where ``points: auto`` describes the images better than the point lights of the fit
    lights = [group.layer.light for group in samples.groups if group.layer is not None]
    if any(light.points == "auto" or light.normalisation == "sum" for light in lights):
        return
    few = subsample(samples, SECOND_BUDGET)
    even = relit(few, setup.caster, evenly_lit=True)
    freed, held = setup.options.freed, setup.held
    # the fit itself was the best of all σ; what evenly lit panels would give may lie far from it
    panels = fit_reflectance(even, freed=freed, held=held)
    points = refit(few, found) if found.describes else fit_reflectance(few, freed=freed, held=held)
    count = len(few.level)
    ratio = 2.0 * count * (panels.mean_log_likelihood - points.mean_log_likelihood)
    moved = max(abs(math.log(panels.R_s / found.R_s)), abs(math.log(panels.sigma / found.sigma)))
    if ratio < LEAST_RATIO or moved < LEAST_DIFFERENCE:
        return
    number = lights[0].points
    lit = "1 point" if number == 1 else f"{number} points"
    yield (
        f"evenly lit panels describe these images better than {lit} per panel: R_s would be about {panels.R_s:.4g} "
        f"and σ {panels.sigma:.4g} rad, which the intervals given here do not take into account. Use points: auto in "
        "the rig file"
    )


def _paper_result(setup: FitSetup, samples: Samples, paper: PaperDiffuse | PaperSpecular) -> FitResult:
    # R_d, or R_s and σ, as sections 4.2 and 4.3 of the paper find them; the others from the part file
    options, own = setup.options, setup.scene.reflectance
    if options.gain or options.dark or options.register or options.joint:
        raise InputError("the paper's method has no free gains, dark level, placement or joint fit")
    if setup.scene.regions:
        raise InputError("the paper's method knows one reflectance: it cannot fit a part with regions")
    if own.model.name != "torrance-sparrow":
        raise InputError(f"the paper's method knows one Gaussian lobe: it cannot fit the model {own.model.name}")
    more = paper.warnings() if isinstance(paper, PaperSpecular) else ()
    fitted = {"R_d": paper.R_d} if isinstance(paper, PaperDiffuse) else {"R_s": paper.R_s, "sigma_rad": paper.sigma}
    held = _unfitted(setup, "diffuse" if isinstance(paper, PaperDiffuse) else "specular")
    return replace(
        held,
        method="paper",
        values=tuple(replace(one, value=fitted.get(one.name, one.value)) for one in held.values),
        fitted=tuple(fitted),
        observations=len(samples.sample),
        pixels=len(samples.diffuse),
        warnings=(*_likelihood_warnings(setup, samples, fitted), *more),
        paper=paper,
    )


def _likelihood_warnings(setup: FitSetup, samples: Samples, fitted: Mapping[str, float]) -> Iterator[str]:
    # compare the paper's answer, which comes from a mean, a count and a sum, with the likelihood of all pixels
    few = subsample(samples, SECOND_BUDGET)
    whole = fit_reflectance(few, freed=FreeParameters())
    quality = _quality.assess_quality(few, whole)
    placed = refuse_unexplained_images(setup, few, whole, quality)
    yield from _quality.poor_fit_warnings(whole, quality, placed=placed)
    likeliest = {"R_d": whole.R_d, "R_s": whole.R_s, "sigma_rad": whole.sigma}
    off = [
        f"{name.replace('sigma_rad', 'σ')} {value:.4g} instead of {likeliest[name]:.4g}"
        for name, value in fitted.items()
        if abs(math.log(max(value, 1e-9) / max(likeliest[name], 1e-9))) > LEAST_PAPER_DIFFERENCE
    ]
    if off:
        yield (
            f"the default method, which uses every pixel, disagrees on these images ({'; '.join(off)}): the "
            "mean, count and sum of the paper's method hardly distinguish these values"
        )
