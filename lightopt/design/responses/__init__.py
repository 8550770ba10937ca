"""What the camera would deliver of every patch, with and without defects, under every candidate position."""
