"""Mean, standard deviation and range of columns that come in parts."""

from dataclasses import dataclass, field

import numpy as np

from otc_dist.replay.export.tables import Columns
from otc_dist.transitions import Float64


@dataclass
class _Running:
    """Of the rows so far, by entry (n,); the parts' moments are added as Chan et al. (1979) do."""

    count: int
    mean: Float64
    squares: Float64  # sum of the squared distances from the mean
    minimum: Float64
    maximum: Float64


@dataclass
class Statistics:
    """Statistics of every column, by entry."""

    _running: dict[str, _Running] = field(default_factory=dict)

    def add(self, columns: Columns) -> None:
        """Take more rows: (T,) or (T, n) each, T > 0."""
        for name, values in columns.items():
            rows = values.reshape(len(values), -1).astype(np.float64)
            mean = rows.mean(axis=0)
            more = _Running(
                count=len(rows),
                mean=mean,
                squares=np.square(rows - mean).sum(axis=0),
                minimum=rows.min(axis=0),
                maximum=rows.max(axis=0),
            )
            before = self._running.get(name)
            self._running[name] = more if before is None else _sum(before, more)

    def to_dict(self) -> dict[str, dict[str, list[float]]]:
        """Column -> its min, max, mean, std and count."""
        return {
            name: {
                "min": found.minimum.tolist(),
                "max": found.maximum.tolist(),
                "mean": found.mean.tolist(),
                "std": np.sqrt(found.squares / found.count).tolist(),
                "count": [found.count],
            }
            for name, found in self._running.items()
        }


def _sum(a: _Running, b: _Running) -> _Running:
    count, apart = a.count + b.count, b.mean - a.mean
    return _Running(
        count=count,
        mean=a.mean + apart * (b.count / count),
        squares=a.squares + b.squares + np.square(apart) * (a.count * b.count / count),
        minimum=np.minimum(a.minimum, b.minimum),
        maximum=np.maximum(a.maximum, b.maximum),
    )
