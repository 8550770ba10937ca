"""Choice of postures, with one set of light positions for all of them.

`_plan_postures` is the entry. `_posture_grid` lists the candidate postures. `_multi_start_search` runs
`_alternating_search` from several starts: `_greedy_cover` and `_best_set` choose postures for given lights,
`_light_positions` chooses lights for given postures. `_counts` and `_combinations` count in how many images pairs of
patch and defect are seen; `_image_evaluator` computes what an image shows. `_choice` is the result;
`_planned_scores` scores it by all images of the plan.
"""
