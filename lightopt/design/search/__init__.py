"""The exact search over combinations of light positions.

`_best_positions` runs it for all postures and objectives. `_exact_search` is the branch-and-bound search.
`_between_steps` bounds what positions between the candidates score.
"""
