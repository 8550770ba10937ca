"""Comparison of images and image sets with golden ones: differences in numbers and as a picture."""

from ._channels import ComparisonThresholds
from ._files import (
    FileComparison,
    SetComparison,
    compare_files,
    compare_sets,
    comparison_provenance,
    difference_picture,
    diverging,
)
