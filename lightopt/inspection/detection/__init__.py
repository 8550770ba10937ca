"""Find defects: deviations, scores, regions, measurements, and how much of the surface was inspected."""
