"""The launcher: one command that prepares, starts, shows and stops a run's processes.

Modules import each other relatively: in the checkout this folder is `launch/`, installed it is
`otc_dist.launch`.
"""
