"""Choice of postures and exposures, with one set of light positions for all postures.

`_plan_postures` is the entry: it chooses all three together, and scores the choice by all images of the plan.
`_posture_search` chooses postures and lights alternately: `_cover_search` postures for given lights, `_light_positions`
lights for given postures. `_exposures` adds further exposures.
"""
