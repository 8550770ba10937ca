"""Reflection coefficients from images: maximum likelihood, the paper's procedure, and their uncertainty."""

from lightopt.estimate.reflectance._fit import fit_diffuse as fit_diffuse, fit_specular as fit_specular
from lightopt.estimate.reflectance._paper import (
    PaperDiffuse as PaperDiffuse,
    PaperOptions as PaperOptions,
    PaperSpecular as PaperSpecular,
)
from lightopt.estimate.reflectance._result import (
    FitResult as FitResult,
    FittedValue as FittedValue,
    fit_folder as fit_folder,
    format_interval as format_interval,
    write_fit as write_fit,
)
from lightopt.estimate.reflectance._setup import FitOptions as FitOptions
