"""Inspections compared with ground truth."""
