"""Is a new image, or a new image set, what the golden one says? Differences in numbers and in a picture."""

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
