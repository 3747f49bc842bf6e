"""CSV: `PATH/agent_0.csv`, ..., `PATH/joint.csv`, with one column for each entry of a vector.

Numbers are written with as many digits as distinguish them from their neighbours: reading them as
float32 (the state as float64) gives the same bits.
"""

from collections.abc import Sequence
from pathlib import Path

from pyarrow import csv

from otc_dist.replay.export.formats import View
from otc_dist.replay.export.tables import Columns, place_columns, to_table, transition_columns
from otc_dist.replay.export.trajectories import Trajectory


def open_writer(folder: Path, view: View) -> "CSVWriter":
    """A `Writer` of one file."""
    return CSVWriter(folder / f"{view.name}.csv", view)


class CSVWriter:
    """Writes one file."""

    def __init__(self, path: Path, view: View) -> None:
        self._path, self._view, self._count = path, view, 0
        self._writer: csv.CSVWriter | None = None

    def write(self, batch: Sequence[Trajectory]) -> None:
        columns = place_columns(batch, self._count) | transition_columns(batch, self._view)
        table = to_table(_flat(columns))
        if self._writer is None:
            self._writer = csv.CSVWriter(self._path, table.schema)
        self._writer.write_table(table)
        self._count += len(batch)

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()


def _flat(columns: Columns) -> Columns:
    """Vectors (T, n) as n columns "name_0", ..., "name_<n-1>"."""
    flat: Columns = {}
    for name, values in columns.items():
        if values.ndim == 1:
            flat[name] = values
        else:
            flat |= {f"{name}_{entry}": values[:, entry] for entry in range(values.shape[1])}
    return flat
