"""Reading Flashbax's vaults by TensorStore, of which they are made; JAX is not needed.

    metadata.json         version; shape and type of each array, as a tree of its fields
    manifest.ocdbt, d/*   TensorStore's database: "observations.", "infos.legals.", ..., each an
                          array (streams, time, ...), and `vault_index` (1,)

The time axis is 10^13 long, of which the first `vault_index` steps were written. That is
`flashbax/vault/vault.py` of Flashbax 0.1, whose vaults have the version 1.x.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.datasets.stored import files_sha256, most, regular_files
from otc_dist.system.extras import install
from otc_dist.terminal.errors import UserError

if TYPE_CHECKING:
    import tensorstore

METADATA, MANIFEST, INDEX = "metadata.json", "manifest.ocdbt", "vault_index"
FLASHBAX_MAJOR = 1
_LARGEST_METADATA = 2**24  # bytes
_LARGEST_CHUNK = 2**26  # bytes; Flashbax's take about 2^22
_COMPRESSORS = ("gzip", "zlib", "blosc")  # none that makes more of a byte than Deflate does


def is_vault(path: Path) -> bool:
    """Whether that is a vault's folder, or one that holds vaults, as `3m.vlt` does."""
    return path.is_dir() and (path.suffix == ".vlt" or (path / MANIFEST).exists())


class Vault:
    """A vault, open for reading: `rows` steps in each stream, in arrays by the fields' names.

    Args:
        folder: the vault, as `3m.vlt/Good`, or a folder that holds one and no more.

    Raises:
        UserError: TensorStore is not installed; no vault, several, one of another version, or
            damage.
    """

    def __init__(self, folder: Path) -> None:
        try:
            import tensorstore
        except ImportError:
            raise UserError(f"importing a vault needs TensorStore: {install('vault')}") from None
        self._tensorstore, self._context = tensorstore, tensorstore.Context()
        self.folder = _only(folder)
        metadata = _metadata(self.folder)
        self.names = tuple(_leaves(metadata.get("structure_shape"), self.folder))
        self.about: object = metadata.get("otc_dist")  # of our own exports
        files = regular_files(self.folder)
        self._left = most(sum(path.stat().st_size for path in files))  # bytes
        index = self._open(INDEX)
        with self._damage(INDEX):
            if index.shape != (1,) or index.dtype.numpy_dtype.kind not in "iu":
                raise ValueError("it is no number")
            self.rows = int(index.read().result()[0])
        if self.rows < 1:
            raise UserError(f"{self.folder} is empty")

    def array(self, name: str) -> NDArray[Any] | None:
        """What was written of an array, (streams, rows, ...), or None if there is none.

        Args:
            name: its fields from the root on, as "infos.legals".

        Raises:
            UserError: it is damaged, shorter than the vault, or larger than what is stored can be
                compressed from.
        """
        if name not in self.names:
            return None
        found = self._open(f"{name}.")
        if found.rank < 2 or found.shape[1] < self.rows:
            raise UserError(
                f"{self.folder}: {name} has shape {found.shape}, and {self.rows:,} steps were"
                " written"
            )
        size = (
            prod((found.shape[0], self.rows, *found.shape[2:])) * found.dtype.numpy_dtype.itemsize
        )
        self._left -= size
        if self._left < 0:
            raise UserError(f"{self.folder}: {name} is to take {size:,} bytes, and is not stored")
        with self._damage(name):
            return np.asarray(found[:, : self.rows].read().result())

    def sha256(self) -> str:
        """Of all files, by their names."""
        return files_sha256(self.folder, regular_files(self.folder))

    def _open(self, name: str) -> "tensorstore.TensorStore":
        base = {"driver": "file", "path": f"{self.folder.resolve()}/"}
        store = {"driver": "ocdbt", "base": base, "path": name}
        with self._damage(name):
            found = self._tensorstore.open(
                {"driver": "zarr", "kvstore": store}, read=True, context=self._context
            ).result()
            stored = found.spec().to_json()["metadata"]
            if prod(stored["chunks"]) * found.dtype.numpy_dtype.itemsize > _LARGEST_CHUNK:
                raise ValueError(f"it is stored in parts of {stored['chunks']}")
            compressor = stored["compressor"]
            if compressor is not None and compressor["id"] not in _COMPRESSORS:
                raise ValueError(f"it is compressed by {compressor['id']}, which is not read")
            return found

    @contextmanager
    def _damage(self, name: str) -> Iterator[None]:
        try:
            yield
        except (ValueError, OSError, RuntimeError, TypeError, MemoryError) as error:
            reason = str(error).partition(" [")[0].partition(" in OCDBT")[0].splitlines()
            said = reason[0] if reason else "unreadable"
            raise UserError(f"{self.folder}: {name} is damaged, or no array: {said}") from None


def _only(folder: Path) -> Path:
    """The vault in a folder. Raises UserError for none, or several."""
    if (folder / MANIFEST).exists():
        return folder
    found = sorted(path.parent for path in folder.glob(f"*/{MANIFEST}"))
    if len(found) == 1:
        return found[0]
    if found:
        raise UserError(f"{folder} holds {len(found)} vaults; name one, such as {found[0]}")
    raise UserError(f"{folder} is no vault: it has no {MANIFEST}")


def _metadata(folder: Path) -> Mapping[str, Any]:
    path = folder / METADATA
    try:
        if path.stat().st_size > _LARGEST_METADATA:
            raise UserError(f"{path} has {path.stat().st_size:,} bytes, which a vault's has not")
        found = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(found, dict):
            raise ValueError
    except (OSError, ValueError, RecursionError):
        raise UserError(f"{path} cannot be read, or is not a vault's") from None
    version = found.get("version")
    if isinstance(version, int | float) and FLASHBAX_MAJOR <= version < FLASHBAX_MAJOR + 1:
        return found
    shown = repr(version)[:20]
    raise UserError(f"{folder} is a vault of version {shown}; version {FLASHBAX_MAJOR}.x is read")


def _leaves(tree: object, folder: Path) -> Iterator[str]:
    """The names of the arrays: "observations", "infos.legals", ..."""
    waiting: list[tuple[str, object]] = [("", tree)]
    if not isinstance(tree, dict):
        raise UserError(f"{folder / METADATA} names no arrays")
    while waiting:
        name, found = waiting.pop()
        if isinstance(found, dict):
            waiting += [(f"{name}.{field}" if name else field, f) for field, f in found.items()]
        else:
            yield name
