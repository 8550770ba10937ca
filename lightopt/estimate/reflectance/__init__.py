"""Reflection coefficients from images: maximum likelihood, the paper's procedure, and their uncertainty."""

from lightopt.estimate.reflectance._files import FitFolder, fit_provenance
from lightopt.estimate.reflectance._fit import fit_diffuse, fit_specular
from lightopt.estimate.reflectance._noise import MeasuredNoise
from lightopt.estimate.reflectance._paper import PaperDiffuse, PaperOptions, PaperSpecular
from lightopt.estimate.reflectance._result import FitResult, FittedValue, format_interval
from lightopt.estimate.reflectance._setup import FitOptions

__all__ = [
    "FitFolder",
    "FitOptions",
    "FitResult",
    "FittedValue",
    "MeasuredNoise",
    "PaperDiffuse",
    "PaperOptions",
    "PaperSpecular",
    "fit_diffuse",
    "fit_provenance",
    "fit_specular",
    "format_interval",
]
