"""Tolerance analysis: how far a score falls when lights or part are misaligned.

`_analysis` is the analysis, `_assessments` scores misaligned lights and parts, `_tolerances` are the request and the
misalignments to try.
"""
