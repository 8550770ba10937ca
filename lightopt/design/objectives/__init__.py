"""What a set of images is scored by.

To add an objective, write a module with a class that has the methods of `_objective.Objective`, and name it in
`_registry`. The other modules sum scores over all combinations at once: `_class_runs` and `_bit_sums` for classes of
levels, `_bit_runs` and `_count_runs` for bits per patch, `_level_sums` for least and greatest levels.
"""
