"""Reflection coefficients from images: maximum likelihood, the paper's procedure, and their uncertainty."""

from lightopt.estimate.reflectance._fit import fit_diffuse as fit_diffuse, fit_specular as fit_specular
from lightopt.estimate.reflectance._paper import (
    PaperDiffuse as PaperDiffuse,
    PaperOptions as PaperOptions,
    PaperSpecular as PaperSpecular,
)
from lightopt.estimate.reflectance._result import (
    FitFolder as FitFolder,
    FitResult as FitResult,
    FittedValue as FittedValue,
    fit_provenance as fit_provenance,
    format_interval as format_interval,
)
from lightopt.estimate.reflectance._setup import FitOptions as FitOptions
