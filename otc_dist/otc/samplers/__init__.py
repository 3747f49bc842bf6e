"""Sampling strategies, one file each; `STRATEGIES` in `otc_dist/description/kinds.py` lists them.

mixing.py, offline.py and priorities.py are parts of them.
"""
