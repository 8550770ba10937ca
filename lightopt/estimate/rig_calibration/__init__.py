"""Calibration of the rig from images."""
