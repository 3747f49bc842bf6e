"""metrics.jsonl: one JSON object a line for every report of a learner's training."""

import json
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from otc_dist.learner import Progress


class MetricsFile:
    """Appends lines; a run that was resumed may repeat some, and the last of equals counts.

    All fields but `seconds`, the time since this process began, are the same in every run of a
    seed. Numbers that are not finite become null.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a", encoding="utf-8", buffering=1)  # by lines
        self._start = time.monotonic()

    def write(self, progress: "Progress") -> None:
        """Append a line. Raises OSError."""
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
        self._file.write(json.dumps(line) + "\n")
