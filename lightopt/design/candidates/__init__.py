"""Candidate positions of the lights: angles, positions that are possible, combinations that are allowed."""
