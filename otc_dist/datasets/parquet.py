"""Reading columns of Parquet files as arrays; damage is one line for the user."""

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.datasets.stored import most
from otc_dist.system.extras import install
from otc_dist.terminal.errors import UserError

if TYPE_CHECKING:
    import pyarrow as pa

_WIDEST = 8  # bytes of a number


def read(files: Sequence[Path], wanted: Collection[str]) -> dict[str, NDArray[Any]]:
    """The columns of these names that the files have, one file behind the other: (T, n) each.

    Args:
        files: at least one.

    Raises:
        UserError: pyarrow is not installed; damage, other columns in one file than in another,
            lists of several sizes, values that are missing, or more of them than the files can
            hold.
    """
    try:
        import pyarrow.parquet as pq
    except ImportError:
        raise UserError(f"importing Parquet needs pyarrow: {install('lerobot')}") from None
    left = most(sum(path.stat().st_size for path in files))
    parts: dict[str, list[NDArray[Any]]] = {}
    for number, path in enumerate(files):
        with _damage(path), pq.ParquetFile(path) as file:
            names = [name for name in file.schema_arrow.names if name in wanted]
            if number and set(names) != set(parts):
                raise UserError(f"{path} has other columns than {files[0]}")
            left -= _WIDEST * _values(file.metadata, names)
            if left < 0:
                raise UserError(f"{path} is to hold more numbers than it stores")
            table = file.read(columns=names)
            for name in names:
                parts.setdefault(name, []).append(_array(table.column(name), f"{path}: {name}"))
    return {name: _joined(arrays, f"{files[0]}: {name}") for name, arrays in parts.items()}


def columns_of(path: Path) -> list[str]:
    """The names of a file's columns. UserError: it is damaged."""
    import pyarrow.parquet as pq

    with _damage(path), pq.ParquetFile(path) as file:
        return list(file.schema_arrow.names)


def _values(metadata: Any, names: Collection[str]) -> int:
    """How many numbers these columns are to have."""
    total = 0
    for group in map(metadata.row_group, range(metadata.num_row_groups)):
        for column in map(group.column, range(group.num_columns)):
            if any(f"{column.path_in_schema}.".startswith(f"{name}.") for name in names):
                total += column.num_values
    return total


def _array(column: "pa.ChunkedArray", where: str) -> NDArray[Any]:
    import pyarrow as pa
    import pyarrow.compute as pc

    size = 1
    if column.null_count:
        raise UserError(f"{where} lacks values")
    if pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
        sizes = pc.unique(pc.list_value_length(column)).to_pylist()
        if len(sizes) > 1:
            raise UserError(f"{where} has lists of several sizes")
        size = sizes[0] if sizes else 0
        column = pc.list_flatten(column)
    rows = len(column) // size if size else 0
    return np.asarray(column.to_numpy()).reshape(rows, size)


def _joined(arrays: Sequence[NDArray[Any]], where: str) -> NDArray[Any]:
    if len({array.shape[1] for array in arrays}) > 1:
        raise UserError(f"{where} is of another size in another file")
    return np.concatenate(arrays)


@contextmanager
def _damage(path: Path) -> Iterator[None]:
    import pyarrow as pa

    try:
        yield
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise UserError(f"{path} cannot be read as Parquet, or is damaged: {reason}") from None
