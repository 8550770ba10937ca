"""What images tell of the part: where it lies (`registration`) and how it reflects (`reflectance`)."""
