"""Predict the images of a good part at the registered placement, and compare the captured images with them."""
