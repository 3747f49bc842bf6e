"""A real browser, without a window."""

import shutil
import subprocess
from pathlib import Path

import pytest

# Put in place of <head>: without a window Chromium draws one frame and no more.
FRAMES = """<head>
<script>
window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 16);
</script>
"""


def browse(profile: Path, url: str, *flags: str, seconds: float = 4.0) -> str:
    """What Chromium prints of a page after so many seconds of its own time; skips without it."""
    names = ("chromium", "chromium-browser", "google-chrome")
    chromium = next(filter(None, map(shutil.which, names)), None)
    if chromium is None:
        pytest.skip("no Chromium is installed (on Debian: apt-get install chromium)")
    done = subprocess.run(
        [
            chromium, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
            f"--user-data-dir={profile}", f"--virtual-time-budget={1000 * seconds:.0f}",
            *flags, url,
        ],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    return done.stdout
