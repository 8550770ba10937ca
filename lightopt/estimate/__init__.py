"""Estimates from images: the placement of the part (`registration`) and its reflectance (`reflectance`)."""
