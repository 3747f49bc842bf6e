"""Whether what comes next fits on the disk, asked before it is written.

HDF5 does not take a full disk well: it fails again and again while its files are closed, and says
so each time. So the space is asked for first, and given back to be written to.
"""

import os
from collections.abc import Sequence
from pathlib import Path

from otc_dist.replay.export.formats import Format
from otc_dist.replay.export.trajectories import Trajectory

_LAST = 2**20  # bytes, at most, that come when all transitions are written


def require_space(folder: Path, form: Format, batch: Sequence[Trajectory]) -> None:
    """Raises OSError where `folder` has no space for `batch` in all data sets of an export."""
    raw = sum(part.nbytes for part in batch)
    agents = len(batch[0].observations)
    views = 2 if form.joint else 1  # everything is written as an agent's, and in the joint set
    size = int(views * (form.growth * raw + form.overhead * agents * len(batch)))
    path = folder / ".space"
    with path.open("wb") as file:
        try:
            os.posix_fallocate(file.fileno(), 0, size + _LAST)
        finally:
            path.unlink()
