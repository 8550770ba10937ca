"""Second opinions on a fit: evenly lit panels instead of point lights, the likelihood's view of the paper's answer."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import InputError
from lightopt.estimate.reflectance._estimate import Estimate, FreeParameters
from lightopt.estimate.reflectance._mismatch_causes import refuse_unexplained_images
from lightopt.estimate.reflectance._paper import PaperDiffuse, PaperSpecular
from lightopt.estimate.reflectance._quality import assess_quality, poor_fit_warnings
from lightopt.estimate.reflectance._result import FitResult, FittedValue
from lightopt.estimate.reflectance._samples import Samples, evenly_lit, subsample
from lightopt.estimate.reflectance._search import fit_reflectance, refit
from lightopt.estimate.reflectance._setup import FitOptions, FitSetup
from lightopt.geometry import RayCaster

BUDGET = 250
"""Pixels per octave, light and posture that a second opinion looks at."""

LEAST_RATIO = 100.0
"""Twice the logarithm of the likelihoods' ratio that is worth a word."""

LEAST_DIFFERENCE = 0.005
LEAST_PAPER_DIFFERENCE = 0.05
"""Of ln R_s or ln σ; the paper's σ is a multiple of a step."""


def evenly_lit_warnings(
    samples: Samples, found: Estimate, *, freed: FreeParameters, held: NDArray[np.float64], caster: RayCaster
) -> tuple[str, ...]:
    """What to say where ``points: auto`` describes the images better than the point lights that were fitted with."""
    lights = [group.layer.light for group in samples.groups if group.layer is not None]
    if any(light.points == "auto" or light.normalisation == "sum" for light in lights):
        return ()
    few = subsample(samples, BUDGET)
    even = evenly_lit(few, caster)
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
        f"and σ {panels.sigma:.4g} rad, and the intervals given here do not hold that. Use --points auto, or "
        "points: auto in the rig"
    )
    return (text,)


def paper_warnings(
    setup: FitSetup, samples: Samples, *, R_d: float | None, specular: tuple[float, float] | None
) -> tuple[str, ...]:
    """What the likelihood of all pixels says of the paper's answer, which comes from a mean, a count and a sum.

    R_d: As section 4.2 has it [grey level]; None where it was not asked for.
    specular: R_s [grey level] and σ [rad] as section 4.3 has them; None where they were not asked for.

    Raises InputError: the images do not look like the part.
    """
    few = subsample(samples, BUDGET)
    whole = fit_reflectance(few, freed=FreeParameters())
    quality = assess_quality(few, whole)
    placed = refuse_unexplained_images(setup, few, whole, quality)
    said = [*poor_fit_warnings(whole, quality, placed=placed)]
    pairs = [("R_d", R_d, whole.R_d)]
    if specular is not None:
        pairs += [("R_s", specular[0], whole.R_s), ("σ", specular[1], whole.sigma)]
    off = [
        f"{name} {value:.4g}, there {other:.4g}"
        for name, value, other in pairs
        if value is not None and abs(math.log(max(value, 1e-9) / max(other, 1e-9))) > LEAST_PAPER_DIFFERENCE
    ]
    if off:
        said.append(
            f"the default method, which looks at every pixel, finds other values on these images ({'; '.join(off)}): a "
            "mean, a count and a sum hardly tell these apart"
        )
    return tuple(said)


def paper_result(
    kind: Literal["diffuse", "specular"],
    setup: FitSetup,
    samples: Samples,
    r_d: float | None,
    specular: tuple[float, float] | None,
    options: FitOptions,
    paper: PaperDiffuse | PaperSpecular,
) -> FitResult:
    """R_d, or R_s and σ, as sections 4.2 and 4.3 of the paper find them; the others as the part file has them."""
    if options.gain or options.dark or options.shift or options.joint:
        raise InputError(
            "--method paper knows no --free and no --joint: it fits what sections 4.2 and 4.3 fit"
        )
    own = setup.scene.reflectance
    said = paper_warnings(setup, samples, R_d=r_d, specular=specular)
    r_s, sigma = specular or (own.R_s, own.sigma)
    values = (("R_d", own.R_d if r_d is None else r_d), ("R_s", r_s), ("sigma_rad", sigma))
    return FitResult(
        kind=kind,
        method="paper",
        points=setup.scene.lights[0].points,
        values=tuple(FittedValue(name=name, value=value) for name, value in values),
        fitted=("R_d",) if kind == "diffuse" else ("R_s", "sigma_rad"),
        observations=len(samples.sample),
        pixels=len(samples.diffuse),
        words=(*said, *paper.words()),
        paper=paper,
    )
