"""What to install for a part that needs more than `otc-dist` itself."""

import shlex
import sys
from collections.abc import Iterable
from importlib.metadata import requires
from importlib.util import find_spec

from otc_dist.terminal.errors import UserError


def install(extra: str) -> str:
    """The command that installs what an extra of ours names, for this very Python.

    Works wherever otc-dist is installed from: it names the packages, not ourselves.
    """
    mark = f'extra == "{extra}"'
    wanted = [text.partition(";")[0].strip() for text in requires("otc-dist") or () if mark in text]
    return shlex.join([sys.executable, "-m", "pip", "install", *wanted])


def check(what: str, packages: Iterable[str], extra: str) -> None:
    """Raises UserError, with what to install, if a package is not there; none is imported."""
    for package in packages:
        if find_spec(package) is None:
            raise UserError(f"{what} needs the package {package}: {install(extra)}")
