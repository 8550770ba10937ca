"""What every other package builds on: errors, units, transforms, compiled kernels, threads, provenance."""
