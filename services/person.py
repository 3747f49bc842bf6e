"""A person beside the run: who lets something begin, and who stops it, by files in its folder."""

import json
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from otc_dist.run.folder import RunFolder
from otc_dist.system import durable

from .process import FailureError, StoppedByFileError

_LOOK = 0.1  # seconds between two looks for a person's file


def wait_for(folder: RunFolder, approval: Path, content: Mapping[str, object]) -> None:
    """Return once a person has made `approval`.

    Args:
        content: what waiting.json says meanwhile; see `Waiting` of the launcher.

    Raises:
        FailureError: it cannot be said.
        StoppedByFileError: a person stops the run instead.
    """
    waiting = folder.waiting
    told = {**content, "approve_by": str(approval.relative_to(folder.root))}
    try:  # a signal may end this at any moment: nobody waits any more then
        durable.write(waiting, (json.dumps(told, indent=1) + "\n").encode())
        while not approval.exists():
            obey(folder)
            time.sleep(_LOOK)
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise FailureError(f"cannot write {waiting}: {reason}") from None
    finally:
        with suppress(OSError):
            waiting.unlink()


def stops(folder: RunFolder) -> bool:
    """Whether a person has asked to stop."""
    return folder.stop.exists()


def obey(folder: RunFolder) -> None:
    """End here if a person has asked for it; the file that did is taken away.

    Raises:
        StoppedByFileError: so it is.
    """
    if stops(folder):
        with suppress(OSError):
            folder.stop.unlink()
        raise StoppedByFileError(f"a person made {folder.stop}")
