"""From a rig, a part and images to fitted reflectance: the two fits that the command line has."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lightopt.config import PartConfig, RigConfig
from lightopt.estimate.reflectance._comparisons import evenly_lit_warnings, paper_result
from lightopt.estimate.reflectance._criterion import FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D
from lightopt.estimate.reflectance._cross_validation import leave_lights_out, unseen
from lightopt.estimate.reflectance._estimate import FreeParameters
from lightopt.estimate.reflectance._highlights import LEAST_R_S, WIDENINGS, diffuse_only
from lightopt.estimate.reflectance._mismatch_causes import refuse_unexplained_images
from lightopt.estimate.reflectance._noise import measure_noise, noise_warnings
from lightopt.estimate.reflectance._paper import paper_diffuse, paper_specular
from lightopt.estimate.reflectance._predicted_images import PointsRow, compare_regions
from lightopt.estimate.reflectance._quality import assess_quality, mean_levels, poor_fit_warnings, words
from lightopt.estimate.reflectance._result import (
    FitResult,
    FittedValue,
    fitted_dark,
    fitted_gains,
    fitted_values,
    negative_black_level_warnings,
    separate_region_warnings,
)
from lightopt.estimate.reflectance._samples import Samples
from lightopt.estimate.reflectance._search import fit_reflectance
from lightopt.estimate.reflectance._setup import FitOptions, FitSetup, Points, Progress, collect, prepare_fit
from lightopt.estimate.reflectance._warnings import (
    convergence_warnings,
    held_r_d_warnings,
    refuse_no_highlight,
    refuse_out_of_range,
)
from lightopt.estimate.registration import Observation
from lightopt.images import ImageSet
from lightopt.scene import coarse_points

Float64 = NDArray[np.float64]
KeepImage = Callable[[Observation, NDArray[np.float32]], None]


def fit_diffuse(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    options: FitOptions | None = None,
    progress: Progress | None = None,
) -> FitResult:
    """Fit R_d to the pixels that are away from every highlight.

    Where the highlights are is found by a fit of the whole model first.

    Parameters
    ----------
    rig, part
        What the images show.
    image_set
        Rendered or captured.
    options
        How to fit; the first number of points counts.

    Raises
    ------
    InputError
        Images that are not the rig's or not the part's, or that do not tell R_d.
    """
    options = options or FitOptions()
    points = options.points[0] if options.points else None
    setup = prepare_fit(rig, part, image_set, points, options, progress)
    if options.method == "paper":
        samples = collect(setup, options, progress, uniform=True)
        record = paper_diffuse(samples, options.paper)
        return paper_result("diffuse", setup, samples, record.R_d, None, options, paper=record)
    samples = collect(setup, options, progress)
    freed = FreeParameters(gain=options.gain, dark=options.dark)
    whole = fit_reflectance(samples, freed=freed, progress=progress)
    first_quality = assess_quality(samples, whole)
    placed = refuse_unexplained_images(setup, samples, whole, first_quality)
    plain, widening = diffuse_only(samples, whole.x)
    held = np.array([whole.R_d, LEAST_R_S, whole.sigma])
    found = fit_reflectance(plain, freed=replace(freed, specular=False), held=held, progress=progress)
    quality = assess_quality(plain, found)
    first = [f"where the highlights are: {text}" for text in convergence_warnings(whole)]
    said = [
        *setup.warnings,
        *first,
        *convergence_warnings(found),
        *poor_fit_warnings(found, quality, placed=placed),
    ]
    if widening < max(WIDENINGS):
        said.append(
            f"few pixels are away from the highlights: R_d comes from those beyond {widening:g} times the width of "
            "the lobe that was found, and heavier tails than a Gaussian's would raise it"
        )
    values = fitted_values(found, full_scale=setup.scene.reflectance.full_scale)[:1]
    kept = (
        FittedValue(name="R_s", value=setup.scene.reflectance.R_s),
        FittedValue(name="sigma_rad", value=setup.scene.reflectance.sigma),
    )
    dark = fitted_dark(setup.scene, found) if options.dark else None
    said += negative_black_level_warnings(dark)
    noise = measure_noise(plain, mean_levels(plain, found), describes=quality.describes)
    if options.write_noise:
        said += noise_warnings(noise)
    return FitResult(
        kind="diffuse",
        method="likelihood",
        points=setup.scene.lights[0].points,
        values=(*values, *kept),
        fitted=("R_d",),
        gains=fitted_gains(setup.scene, found) if options.gain else None,
        dark=dark,
        noise=noise,
        write_noise=options.write_noise,
        registration=setup.registration,
        in_file=setup.in_file,
        first=whole,
        observations=len(found.criterion.samples.sample),
        pixels=len(np.unique(found.criterion.samples.sample)),
        quality=quality,
        words=tuple(said),
        estimate=replace(found, scan=whole.scan),
    )


def fit_specular(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    options: FitOptions | None = None,
    progress: Progress | None = None,
    keep: KeepImage | None = None,
) -> FitResult:
    """Fit R_s and σ, and R_d along where asked.

    Parameters
    ----------
    rig, part, image_set, options, progress
        As in :func:`fit_diffuse`. With several numbers of points each is fitted, and the one under which the images are
        likeliest is kept.
    keep
        Called with each image that validation predicted without having seen it, and its prediction.

    Raises
    ------
    InputError
        Images that are not the rig's or not the part's, or that do not tell R_s and σ.
    """
    options = options or FitOptions()
    tried: list[tuple[FitResult, FitSetup, Samples, PointsRow | None]] = []
    choices: tuple[Points | None, ...] = options.points or (None,)
    for points in choices:
        setup = prepare_fit(rig, part, image_set, points, options, progress)
        result, samples = _fit_one(setup, options, progress)
        row = None
        if len(choices) > 1:
            row = compare_regions(
                setup.scene,
                _parameters(result, setup),
                setup.observations,
                points=setup.scene.lights[0].points,
                caster=setup.caster,
                likelihood=None if result.estimate is None else result.estimate.mean_log_likelihood,
                threads=options.threads,
            )
        tried.append((result, setup, samples, row))
    result, setup, samples, _ = max(tried, key=lambda one: _rank(one[3]))
    result = replace(result, rows=tuple(t[3] for t in tried if t[3] is not None))
    if result.estimate is not None and "auto" not in options.points:
        even = evenly_lit_warnings(
            samples, result.estimate, freed=options.freed, held=setup.held, caster=setup.caster
        )
        result = replace(result, words=(*result.words, *even))
    if options.validate and result.estimate is not None:
        left_out = leave_lights_out(
            setup.scene,
            samples,
            result.estimate,
            caster=setup.caster,
            keep=keep,
            progress=None if progress is None else lambda share: progress("validating", share),
        )
        result = replace(
            result, left_out=left_out, words=(*result.words, *unseen(left_out, setup.scene.sensor))
        )
    return result


def _fit_one(setup: FitSetup, options: FitOptions, progress: Progress | None) -> tuple[FitResult, Samples]:
    reflectance = setup.scene.reflectance
    if options.method == "paper":
        samples = collect(setup, options, progress, uniform=True)
        record = paper_specular(
            samples,
            options.paper,
            R_d=reflectance.R_d,
            progress=None if progress is None else lambda share: progress("sweeping σ", share),
        )
        pair = record.R_s, record.sigma
        return paper_result("specular", setup, samples, None, pair, options, paper=record), samples
    samples = collect(setup, options, progress)
    found = fit_reflectance(samples, freed=options.freed, held=setup.held, progress=progress)
    quality = assess_quality(samples, found)
    placed = refuse_unexplained_images(setup, samples, found, quality)
    refuse_no_highlight(samples, found)
    refuse_out_of_range(found)
    values = fitted_values(found, full_scale=reflectance.full_scale)
    interval = next(v.interval for v in values if v.name == "R_s")
    exposures = {o.exposure for o in setup.observations}
    said = [*setup.warnings, *convergence_warnings(found)]
    said += separate_region_warnings(values)
    said += words(found, quality, interval, shorter=len(exposures) > 1, placed=placed)
    said += held_r_d_warnings(found)
    noise = measure_noise(samples, mean_levels(samples, found), describes=quality.describes)
    if options.write_noise:
        said += noise_warnings(noise)
    panels = (coarse_points(light, found.sigma) for light in setup.scene.lights)
    said += [text for text in panels if text is not None]
    dark = fitted_dark(setup.scene, found) if options.dark else None
    said += negative_black_level_warnings(dark)
    result = FitResult(
        kind="specular",
        method="likelihood",
        points=setup.scene.lights[0].points,
        values=values,
        fitted=("R_d", "R_s", "sigma_rad") if options.joint else ("R_s", "sigma_rad"),
        gains=fitted_gains(setup.scene, found) if options.gain else None,
        dark=dark,
        noise=noise,
        write_noise=options.write_noise,
        registration=setup.registration,
        in_file=setup.in_file,
        correlation=found.correlation(LOG_R_S, LOG_SIGMA),
        # least squares have done with fewer
        observations=len(found.criterion.samples.sample),
        pixels=len(found.criterion.samples.diffuse),
        quality=quality,
        words=tuple(said),
        estimate=found,
    )
    return result, samples


def _rank(row: PointsRow | None) -> float:
    # the likelihood where there is one; the paper looks at area and perimeter
    if row is None:
        return 0.0
    return -row.misfit if row.likelihood is None else row.likelihood


def _parameters(result: FitResult, setup: FitSetup) -> Float64:
    if result.estimate is not None:
        return result.estimate.x
    x = np.zeros(FIRST_GAIN + len(setup.scene.lights))
    x[R_D] = result.value("R_d")
    x[LOG_R_S] = math.log(max(result.value("R_s"), LEAST_R_S))
    x[LOG_SIGMA] = math.log(result.value("sigma_rad"))
    return x
