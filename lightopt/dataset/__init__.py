"""Labelled training sets for defect detectors: randomised parts, rendered, labelled and written in common formats."""

from ._dataset import make_dataset
from ._draws import DatasetOptions
