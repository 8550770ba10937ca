"""Comparison of images and image sets with golden ones: differences in numbers and as a picture."""

from lightopt.images.comparison._channels import ComparisonThresholds
from lightopt.images.comparison._files import FileComparison, compare_files
from lightopt.images.comparison._picture import difference_picture
from lightopt.images.comparison._sets import SetComparison, compare_sets, comparison_provenance

__all__ = [
    "ComparisonThresholds",
    "FileComparison",
    "SetComparison",
    "compare_files",
    "compare_sets",
    "comparison_provenance",
    "difference_picture",
]
