"""Comparing sampling strategies from the same offline policies, and checking how OTC works.

`arms` names what is compared, `runs` makes one run of an arm, `scores` keeps its raw scores, which
`collected` finds again. `judgement` says what a run is judged by, `statistics` and `intervals` hold
arms against the reference, `conclusion`, `tables` and `report` tell it. `mechanism` measures what a
sampler selects, on joint data that no learner may see.
"""
