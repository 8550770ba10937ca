"""Reflection coefficients from images: maximum likelihood, the paper's procedure, and their uncertainty."""

from lightopt.estimate.reflectance._fit import fit_diffuse, fit_specular as fit_specular
from lightopt.estimate.reflectance._paper import PaperDiffuse, PaperOptions, PaperSpecular
from lightopt.estimate.reflectance._result import FitResult, FittedValue, fit_folder, format_interval, write_fit
from lightopt.estimate.reflectance._setup import FitOptions as FitOptions
