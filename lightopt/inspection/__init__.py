"""Inspecting a part: the images of a posture fused into one without highlights."""

from lightopt.inspection._fusion import FUSIONS, Fusion
from lightopt.inspection._poisson import PoissonGrid, poisson_grid
from lightopt.inspection._synthetic import SyntheticImage, fuse_images, trust_weights

__all__ = [
    "FUSIONS",
    "Fusion",
    "PoissonGrid",
    "SyntheticImage",
    "fuse_images",
    "poisson_grid",
    "trust_weights",
]
