"""The exact search over all combinations of candidate positions."""
