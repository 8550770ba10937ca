"""Is a new image, or a new image set, what the golden one says? Differences in numbers and in a picture."""

from lightopt.compare._channels import ChannelDifference, Thresholds, compare_arrays
from lightopt.compare._files import FileComparison, compare_files
from lightopt.compare._picture import DifferencePicture, difference_picture
from lightopt.compare._provenance import comparison_provenance
from lightopt.compare._sets import SetComparison, compare_sets

__all__ = [
    "ChannelDifference",
    "DifferencePicture",
    "FileComparison",
    "SetComparison",
    "Thresholds",
    "compare_arrays",
    "compare_files",
    "compare_sets",
    "comparison_provenance",
    "difference_picture",
]
