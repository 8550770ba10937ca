"""The exact search over combinations of light positions.

`_exact_search` is the branch-and-bound search, `_ranking` orders what it enumerates, `_answers` compares the best set
of each objective, `_all_objectives` runs it for all postures and objectives, `_curves` are sections through the
optimum.
"""
