"""Reflection coefficients from images: maximum likelihood, the paper's procedure, and how far to trust either."""

from lightopt.fit._estimate import Estimate, Freed, ScanPoint, estimate, refine
from lightopt.fit._likelihood import DARK, FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D, Likelihood, predicted
from lightopt.fit._observations import Observation, observed_postures, read_observations
from lightopt.fit._profile import profile_interval
from lightopt.fit._samples import Samples, collect_samples, thinned

__all__ = [
    "DARK",
    "FIRST_GAIN",
    "LOG_R_S",
    "LOG_SIGMA",
    "R_D",
    "Estimate",
    "Freed",
    "Likelihood",
    "Observation",
    "Samples",
    "ScanPoint",
    "collect_samples",
    "estimate",
    "observed_postures",
    "predicted",
    "profile_interval",
    "read_observations",
    "refine",
    "thinned",
]
