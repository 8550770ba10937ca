"""Refusals and warnings: no highlight, values out of range, a climb that did not converge, an unsuitable R_d."""

from __future__ import annotations

import math

from lightopt.core.errors import InputError
from lightopt.estimate.reflectance._criterion import R_D, parameter_name
from lightopt.estimate.reflectance._estimate import Estimate
from lightopt.estimate.reflectance._samples import Samples

SIGMA_RANGE = 0.001, 0.2
"""Widths of lobes that the model is meant for [rad]: Ward found these on real surfaces (paper, section 4.3)."""

MOST_R_S = 1e11
"""Beyond this, R_s runs away along the ridge [grey level]."""

EDGE = 1.01
"""A value within this factor of an edge is at it."""


def refuse_no_highlight(samples: Samples, found: Estimate) -> None:
    """Refuse images that do not determine R_s and σ.

    Raises InputError: no pixel is brighter by a level for a highlight.
    """
    light = found.R_s * samples.specular(found.sigma)
    if float(light.max()) < 1.0:
        raise InputError(
            "no highlight in any image: nothing tells R_s and σ. Add images under lights that the surface mirrors "
            "into the camera, or at a longer exposure"
        )


def refuse_out_of_range(found: Estimate) -> None:
    """Refuse values that no real surface has.

    Raises InputError: σ at an edge of its range or beyond, or an R_s that runs away.
    """
    low, high = SIGMA_RANGE
    if found.sigma < low * EDGE:
        raise InputError(
            f"σ: the best fit is at {found.sigma:.3g} rad, at or below the lower end {low:g} of the range: the "
            "highlights are as sharp as mirror images of the panels, and nothing tells how much sharper. Check the "
            "panels' sizes, the part's shape and its place, or add images at a shorter exposure"
        )
    if found.sigma > high / EDGE:
        raise InputError(
            f"σ: the best fit is at {found.sigma:.3g} rad, at or beyond the upper end {high:g} of the range: the "
            "images show no highlight, or a haze that the model has no lobe for. Add images under lights that the "
            "surface mirrors into the camera, and check the part's shape and its place"
        )
    if found.R_s > MOST_R_S:
        raise InputError(
            f"R_s: the best fit is at {found.R_s:.2g} grey levels and not bounded: nothing but saturated pixels tells "
            "of the highlights. Add images at a shorter exposure"
        )


def convergence_warnings(found: Estimate) -> tuple[str, ...]:
    """Warn where the optimiser did not converge."""
    warnings: list[str] = []
    if not found.maximum.converged:
        lights = found.criterion.samples.lights
        names = [parameter_name(place, lights) for place in found.maximum.unsettled]
        along = f" along {', '.join(names)}" if names else ""
        warnings.append(
            f"the fit did not converge: after {found.maximum.steps} steps it still improves{along}; its values and "
            "intervals are not those of an optimum. Other images, or fewer parameters that are freed, may help"
        )
        return tuple(warnings)
    if found.unsettled_refits:
        warnings.append(
            f"{found.unsettled_refits} of the fits without one of the {found.scatter} each did not converge: the "
            "intervals, which come from their scatter, may be wrong"
        )
    best = max((optimum.value for optimum in found.optima if optimum.converged), default=-math.inf)
    warnings += [
        f"the climb from σ {optimum.start_sigma:.3g} rad did not converge at σ {optimum.sigma:.3g} rad, and is not "
        "worse than the best: another optimum may lie there"
        for optimum in found.optima
        if not optimum.converged and optimum.value >= best
    ]
    return tuple(warnings)


def held_r_d_warnings(found: Estimate) -> list[str]:
    """Warn where the slope of the criterion contradicts the value at which R_d was held."""
    if R_D in found.free:
        return []
    here = found.maximum.evaluation
    curvature = float(here.curvature[R_D, R_D])
    step = float(here.gradient[R_D]) / max(curvature, 1e-300)
    if abs(step) < 0.02 * max(found.R_d, 1e-9) or abs(step) * math.sqrt(curvature) < 5.0:
        return []
    text = (
        f"R_d is held at {found.R_d:.4g}, but these images want a {'larger' if step > 0.0 else 'smaller'} one, and R_s "
        "and σ suffer from it: run fit-diffuse first, or use --joint"
    )
    return [text]
