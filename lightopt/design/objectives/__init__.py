"""What a set of images is scored by. Add an objective here."""
