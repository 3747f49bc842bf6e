"""What to install for a part that needs more than `otc-dist` itself."""

import shlex
import sys
from importlib.metadata import requires


def install(extra: str) -> str:
    """The command that installs what an extra of ours names, for this very Python.

    Works wherever otc-dist is installed from: it names the packages, not ourselves.
    """
    mark = f'extra == "{extra}"'
    wanted = [text.partition(";")[0].strip() for text in requires("otc-dist") or () if mark in text]
    return shlex.join([sys.executable, "-m", "pip", "install", *wanted])
