"""What a fit hands on of the paper's procedure."""

from __future__ import annotations

from typing import Literal

from lightopt.core.errors import InputError
from lightopt.estimate.reflectance._comparisons import paper_warnings
from lightopt.estimate.reflectance._options import FitOptions
from lightopt.estimate.reflectance._paper import PaperDiffuse, PaperSpecular
from lightopt.estimate.reflectance._result import FitResult, FittedValue
from lightopt.estimate.reflectance._samples import Samples
from lightopt.estimate.reflectance._setup import FitSetup


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
    said = paper_warnings(setup, samples, R_d=r_d, specular=specular, threads=options.threads)
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
