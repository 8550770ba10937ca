"""Thresholds and systematic deviations learned from good parts."""
