"""Choice of exposures.

`_plan_exposures` adds further exposures to given postures and lights; `_selection` takes those that show enough more.
`_joint_choice` chooses postures, lights and exposures together.
"""
