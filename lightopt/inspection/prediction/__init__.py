"""Predict the images of a good part where the part lies, and compare the captured ones with them."""
