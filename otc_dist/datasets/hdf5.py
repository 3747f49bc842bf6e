"""Reading HDF5 so that damage, which h5py reports by many exceptions, is one line for the user."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.datasets.stored import most
from otc_dist.system.extras import install
from otc_dist.terminal.errors import UserError

if TYPE_CHECKING:
    import h5py

_DAMAGE = (OSError, KeyError, RuntimeError, ValueError, TypeError, MemoryError)


@contextmanager
def opened(path: Path) -> Iterator["h5py.File"]:
    """An HDF5 file, open for reading.

    Raises:
        UserError: h5py is not installed, or this is no HDF5 file.
    """
    try:
        import h5py
    except ImportError:
        raise UserError(f"importing needs h5py: {install('import')}") from None
    with _damage(str(path)):
        file = h5py.File(path, "r")
    with file:
        yield file


def names(group: "h5py.Group", source: str, inside: str = "/") -> tuple[str, ...]:
    """The names in a file, or in a group of it; none if it has none such. UserError if damaged."""
    with _damage(source):
        found = group.get(inside, ())
        return () if hasattr(found, "shape") else tuple(found)


def array(group: "h5py.Group", name: str, source: str) -> NDArray[Any] | None:
    """An array of a file or group, or None if it has none of that name.

    Raises:
        UserError: it is damaged, lies in another file, or is larger than what is stored of it can
            be compressed from.
    """
    with _damage(source):
        if name not in group or not hasattr(group[name], "shape"):
            return None
        found = group[name]
        if found.external or found.is_virtual or found.file.filename != group.file.filename:
            raise UserError(f"{source}: {name} lies in another file, and no other is read")
        stored, size = found.id.get_storage_size(), found.size * found.dtype.itemsize
        if size > most(stored):
            raise UserError(
                f"{source}: {name} is to take {size:,} bytes, of which {stored:,} are stored"
            )
        return np.asarray(found[()])


def attributes(group: "h5py.Group", name: str, source: str) -> dict[str, object]:
    """The attributes of a group in a file or group. UserError if damaged."""
    with _damage(source):
        return dict(group[name].attrs)


@contextmanager
def _damage(source: str) -> Iterator[None]:
    try:
        yield
    except _DAMAGE as error:
        reason = str(error.args[-1] if error.args else error).splitlines() or ["unreadable"]
        raise UserError(f"{source} cannot be read as HDF5, or is damaged: {reason[0]}") from None
