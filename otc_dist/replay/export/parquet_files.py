"""Parquet: `PATH/agent_0.parquet`, ..., `PATH/joint.parquet`; see `tables` for the columns."""

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from otc_dist.replay.export.formats import View
from otc_dist.replay.export.tables import place_columns, to_table, transition_columns
from otc_dist.replay.export.trajectories import Trajectory


def open_writer(folder: Path, view: View) -> "ParquetWriter":
    """A `Writer` of one file."""
    return ParquetWriter(folder / f"{view.name}.parquet", view)


def rows_writer(path: Path, schema: pa.Schema) -> pq.ParquetWriter:
    """How all our Parquet files are written: floats hardly ever repeat, so no dictionaries."""
    numbers = [f.name for f in schema if pa.types.is_integer(f.type) or pa.types.is_boolean(f.type)]
    return pq.ParquetWriter(path, schema, compression="zstd", use_dictionary=numbers)


class ParquetWriter:
    """Writes one file, a row group a batch."""

    def __init__(self, path: Path, view: View) -> None:
        self._path, self._view, self._count = path, view, 0
        self._writer: pq.ParquetWriter | None = None

    def write(self, batch: Sequence[Trajectory]) -> None:
        columns = place_columns(batch, self._count) | transition_columns(batch, self._view)
        table = to_table(columns, {"otc_dist": self._view.about})
        if self._writer is None:
            self._writer = rows_writer(self._path, table.schema)
        self._writer.write_table(table)
        self._count += len(batch)

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()
