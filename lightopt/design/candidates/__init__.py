"""Candidate positions of the lights."""
