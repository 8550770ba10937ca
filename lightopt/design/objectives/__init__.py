"""Objectives: scores of a combination of light positions.

To add an objective, write a module with a class that has the methods of `_objective.Objective`, and name it in
`_registry`. `_scores_by_…` sum the scores of all combinations at once: from classes of levels, from the number of
images that show a defect, from the least and greatest levels.
"""
