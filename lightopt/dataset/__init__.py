"""Labelled training sets for defect detectors: randomised parts, rendered, labelled and written in common formats."""

from lightopt.dataset._dataset import make_dataset
from lightopt.dataset._draws import DatasetOptions
