"""Which further exposures the images of a plan need."""
