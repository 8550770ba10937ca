"""A rig that is not there: simulated firmware and a camera that sees what the firmware does."""

from lightopt.virtualbench._process import BenchProcess

__all__ = ["BenchProcess"]
