"""Which surface the camera sees at so grazing an angle that no image can be judged there."""

from __future__ import annotations

import math

GRAZING_DEG = 80.0
"""Surface that is seen at more than this angle to its normal is left out of every score and share [°].

A pixel's footprint there is six times as long as where the surface faces the camera, and more: it mixes with its
neighbours', and an error of the placement by a pixel shows another place of the part. A nearly vertical wall can make
up a quarter of the area that is seen and a pixel or two of the image; whether its patches are seen at all changes with
the mesh. It is left out of pixels whose light is predicted, of patches that are scored, and of the surface that an
inspection covers."""

GRAZING_COSINE = math.cos(math.radians(GRAZING_DEG))
"""Cosine of :data:`GRAZING_DEG`: a place with a smaller cosine between normal and view is seen at a grazing angle."""
