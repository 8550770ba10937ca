"""Fuse the images of a posture into one without highlights."""
