"""Comparison of images and image sets with golden ones: differences in numbers and as a picture."""

from lightopt.images.comparison._channels import ComparisonThresholds as ComparisonThresholds
from lightopt.images.comparison._files import (
    FileComparison as FileComparison,
    SetComparison as SetComparison,
    compare_files as compare_files,
    compare_sets as compare_sets,
    comparison_provenance as comparison_provenance,
    difference_picture as difference_picture,
    diverging as diverging,
)
