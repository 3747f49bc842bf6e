"""Comparing sampling strategies from the same offline policies, and checking how OTC works.

`arms` names what is compared, `runs` makes one run of an arm, `scores` keeps its raw scores,
`statistics` and `report` tell what they show. `mechanism` measures what a sampler selects, on
joint data that no learner may see.
"""
