"""What the images of a good part would look like where the part lies, beside those that were taken."""
