"""metrics.jsonl: one JSON object a line for every report of a learner's training."""

import json
import math
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from otc_dist.learner.trainer import Progress


class MetricsFile:
    """Appends lines; a run that was resumed may repeat some, and the last of equals counts.

    All fields but `seconds`, the time since this process began, are the same in every run of a
    seed. Numbers that are not finite become null. A line is there whole or not at all: one that a
    process left torn, as it was killed or the disk was full, is cut off.

    Raises:
        OSError: the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a+b", buffering=0)
        self._size = _whole(path.read_bytes())
        self._file.truncate(self._size)
        self._start = time.monotonic()

    def write(self, progress: "Progress") -> None:
        """Append a line. Raises OSError: the file ends with the line before."""
        line = {
            "phase": progress.phase,
            "deployment": progress.deployment,
            "update": progress.update,
            "updates": progress.updates,
            "metrics": {
                name: value if math.isfinite(value) else None
                for name, value in progress.metrics.items()
            },
            "seconds": round(time.monotonic() - self._start, 3),
        }
        content = (json.dumps(line) + "\n").encode()
        try:
            written = 0
            while written < len(content):
                written += os.write(self._file.fileno(), content[written:])
        except OSError:
            self._file.truncate(self._size)
            raise
        self._size += len(content)


def _whole(content: bytes) -> int:
    """How many bytes of whole lines a file begins with."""
    return content.rfind(b"\n") + 1
