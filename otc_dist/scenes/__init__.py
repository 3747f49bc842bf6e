"""Scenes: what a task looks like, worked out from the state that the log keeps.

One notion for all that shows deployments. `scene` says what a scene is, `robots`, `particles`
and `skirmish` give those of their family, and `families.find` the one of an environment.
"""
