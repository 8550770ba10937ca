"""Responses of the surface to each candidate light: delivered levels, and which defects each image shows."""
