"""Second opinions on a fit: evenly lit panels instead of point lights, the likelihood's view of the paper's answer."""

import math
from collections.abc import Mapping

from lightopt.core.errors import InputError
from lightopt.estimate.reflectance._estimate import Estimate, FreeParameters
from lightopt.estimate.reflectance._fit_samples import fit_reflectance, refit
from lightopt.estimate.reflectance._mismatch_causes import refuse_unexplained_images
from lightopt.estimate.reflectance._paper import PaperDiffuse, PaperSpecular
from lightopt.estimate.reflectance._quality import assess_quality, poor_fit_warnings
from lightopt.estimate.reflectance._result import FitResult, FittedValue
from lightopt.estimate.reflectance._samples import Samples, evenly_lit, subsample
from lightopt.estimate.reflectance._setup import FitSetup

BUDGET = 250  # pixels per octave, light and posture of a second opinion
LEAST_RATIO = 100.0  # twice the logarithm of the likelihoods' ratio that is reported

LEAST_DIFFERENCE = 0.005
LEAST_PAPER_DIFFERENCE = 0.05  # of ln R_s or ln σ; the paper's σ is a multiple of a step


def evenly_lit_warnings(setup: FitSetup, samples: Samples, found: Estimate) -> tuple[str, ...]:
    """Warn where ``points: auto`` describes the images better than the point lights of the fit."""
    lights = [group.layer.light for group in samples.groups if group.layer is not None]
    if any(light.points == "auto" or light.normalisation == "sum" for light in lights):
        return ()
    few = subsample(samples, BUDGET)
    even = evenly_lit(few, setup.caster)
    freed, held = setup.options.freed, setup.held
    # the fit itself was the best of all σ; what evenly lit panels would give may lie far from it
    panels = fit_reflectance(even, freed=freed, held=held)
    points = refit(few, found) if found.describes else fit_reflectance(few, freed=freed, held=held)
    count = len(few.level)
    ratio = 2.0 * count * (panels.mean_log_likelihood - points.mean_log_likelihood)
    moved = max(abs(math.log(panels.R_s / found.R_s)), abs(math.log(panels.sigma / found.sigma)))
    if ratio < LEAST_RATIO or moved < LEAST_DIFFERENCE:
        return ()
    number = lights[0].points
    lit = "1 point" if number == 1 else f"{number} points"
    text = (
        f"evenly lit panels describe these images better than {lit} per panel: R_s would be about {panels.R_s:.4g} "
        f"and σ {panels.sigma:.4g} rad, and the intervals given here do not hold that. Use "
        "points: auto in the rig"
    )
    return (text,)


def paper_result(setup: FitSetup, samples: Samples, paper: PaperDiffuse | PaperSpecular) -> FitResult:
    """R_d, or R_s and σ, as sections 4.2 and 4.3 of the paper find them; the others from the part file."""
    options, own = setup.options, setup.scene.reflectance
    if options.gain or options.dark or options.register or options.joint:
        raise InputError(
            "the paper's method frees nothing else and fits nothing jointly: it fits what sections 4.2 and 4.3 fit"
        )
    more = paper.warnings() if isinstance(paper, PaperSpecular) else ()
    fitted = {"R_d": paper.R_d} if isinstance(paper, PaperDiffuse) else {"R_s": paper.R_s, "sigma_rad": paper.sigma}
    values = {"R_d": own.R_d, "R_s": own.R_s, "sigma_rad": own.sigma, **fitted}
    return FitResult(
        kind="diffuse" if isinstance(paper, PaperDiffuse) else "specular",
        method="paper",
        points=setup.scene.lights[0].points,
        values=tuple(FittedValue(name=name, value=value) for name, value in values.items()),
        fitted=tuple(fitted),
        observations=len(samples.sample),
        pixels=len(samples.diffuse),
        warnings=(*_likelihood_warnings(setup, samples, fitted), *more),
        paper=paper,
    )


def _likelihood_warnings(setup: FitSetup, samples: Samples, fitted: Mapping[str, float]) -> tuple[str, ...]:
    # compare the paper's answer, which comes from a mean, a count and a sum, with the likelihood of all pixels
    few = subsample(samples, BUDGET)
    whole = fit_reflectance(few, freed=FreeParameters())
    quality = assess_quality(few, whole)
    placed = refuse_unexplained_images(setup, few, whole, quality)
    warnings = [*poor_fit_warnings(whole, quality, placed=placed)]
    likeliest = {"R_d": whole.R_d, "R_s": whole.R_s, "sigma_rad": whole.sigma}
    off = [
        f"{name.replace('sigma_rad', 'σ')} {value:.4g}, there {likeliest[name]:.4g}"
        for name, value in fitted.items()
        if abs(math.log(max(value, 1e-9) / max(likeliest[name], 1e-9))) > LEAST_PAPER_DIFFERENCE
    ]
    if off:
        warnings.append(
            f"the default method, which uses every pixel, finds other values on these images ({'; '.join(off)}): a "
            "mean, a count and a sum hardly distinguish these"
        )
    return tuple(warnings)
