"""Reflection coefficients from images: maximum likelihood, the paper's procedure, and their uncertainty."""

from ._fit import fit_diffuse, fit_specular as fit_specular
from ._paper import PaperDiffuse, PaperOptions, PaperSpecular
from ._result import FitResult, FittedValue, fit_folder, format_interval, write_fit
from ._setup import FitOptions as FitOptions
