"""Comparing sampling strategies from the same offline policies, and checking how OTC works.

`arms` names what is compared, `runs` makes one run of an arm, `scores` keeps its raw scores, which
`collected` finds again. `judgement` says what a run is judged by, `score_statistics` and
`intervals` compare arms with the reference, `conclusion`, `tables` and `report` present it.
`campaign` puts several comparisons together, beside what is published of them. `mechanism` measures
what a sampler selects, on joint data that no learner may see.
"""
