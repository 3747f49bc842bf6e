"""Where what can be made again is kept: data sets and compiled code."""

import os
from pathlib import Path

import platformdirs


def cache_root() -> Path:
    """$OTC_DIST_CACHE, or the user's cache folder."""
    chosen = os.environ.get("OTC_DIST_CACHE")
    return Path(chosen) if chosen else platformdirs.user_cache_path("otc_dist", appauthor=False)
