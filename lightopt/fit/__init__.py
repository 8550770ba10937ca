"""Reflection coefficients from images: maximum likelihood, the paper's procedure, and how far to trust either."""

from lightopt.fit._criterion import DARK, FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D
from lightopt.fit._estimate import Estimate, Freed, Interval, Optimum, ScanPoint
from lightopt.fit._fit import fit_diffuse, fit_specular
from lightopt.fit._likelihood import Likelihood, predicted
from lightopt.fit._noise import MeasuredNoise
from lightopt.fit._options import FitOptions
from lightopt.fit._paper import (
    OPTION_NAMES,
    PaperDiffuse,
    PaperOptions,
    PaperSpecular,
    paper_diffuse,
    paper_specular,
)
from lightopt.fit._predict import predict_images
from lightopt.fit._profile import profile_interval, profile_regions
from lightopt.fit._quality import Quality, appraise
from lightopt.fit._regions import PointsRow, compare_regions
from lightopt.fit._result import FitResult, FittedValue, interval_words
from lightopt.fit._samples import Samples, collect_samples, thinned
from lightopt.fit._search import estimate, refine
from lightopt.fit._validate import Comparison, LeftOut, compare_image, leave_lights_out
from lightopt.fit._write import FitFolder, fit_provenance

__all__ = [
    "DARK",
    "FIRST_GAIN",
    "LOG_R_S",
    "LOG_SIGMA",
    "OPTION_NAMES",
    "R_D",
    "Comparison",
    "Estimate",
    "FitFolder",
    "FitOptions",
    "FitResult",
    "FittedValue",
    "Freed",
    "Interval",
    "LeftOut",
    "Likelihood",
    "MeasuredNoise",
    "Optimum",
    "PaperDiffuse",
    "PaperOptions",
    "PaperSpecular",
    "PointsRow",
    "Quality",
    "Samples",
    "ScanPoint",
    "appraise",
    "collect_samples",
    "compare_image",
    "compare_regions",
    "estimate",
    "fit_diffuse",
    "fit_provenance",
    "fit_specular",
    "interval_words",
    "leave_lights_out",
    "paper_diffuse",
    "paper_specular",
    "predict_images",
    "predicted",
    "profile_interval",
    "profile_regions",
    "refine",
    "thinned",
]
