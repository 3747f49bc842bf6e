"""Vaults as `flashbax/vault/vault.py` writes them, by TensorStore alone."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tensorstore
from numpy.typing import NDArray

Tree = Mapping[str, Any]  # fields, of which the last are arrays (streams, rows, ...)


def write_vault(
    folder: Path,
    tree: Tree,
    *,
    version: object = 1.2,
    index: int | None = None,
    **metadata: object,
) -> Path:
    """Write a vault; `index` says otherwise than the arrays how many rows there are.

    Args:
        metadata: of each array, as `compressor`.
    """
    folder.mkdir(parents=True)
    context = tensorstore.Context()

    def opened(name: str, **more: Any) -> Any:
        base = {"driver": "file", "path": f"{folder}/"}
        store = {"driver": "ocdbt", "base": base, "path": name}
        specification = {"driver": "zarr", "kvstore": store, **more.pop("specification", {})}
        return tensorstore.open(specification, create=True, context=context, **more).result()

    rows = 0
    for name, values in leaves(tree).items():
        rows = values.shape[1]
        stored = {"compressor": {"id": "gzip", "level": 5}, **metadata}
        array = opened(
            f"{name}.",
            specification={"metadata": stored},
            dtype=values.dtype,
            shape=(values.shape[0], 10**13, *values.shape[2:]),
        )
        if "chunks" not in metadata:  # or they may be larger than the memory
            array[:, :rows] = values
    opened("vault_index", dtype=np.int32, shape=(1,))[0] = rows if index is None else index
    told = {
        "version": version,
        "structure_shape": shaped(tree, lambda values: str(values.shape)),
        "structure_dtype": shaped(tree, lambda values: values.dtype.name),
    }
    (folder / "metadata.json").write_text(json.dumps(told))
    return folder


def leaves(tree: Tree, group: str = "") -> dict[str, NDArray[Any]]:
    """The arrays by the names of their fields, as "infos.legals"."""
    found: dict[str, NDArray[Any]] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            found |= leaves(value, f"{group}{name}.")
        else:
            found[f"{group}{name}"] = value
    return found


def shaped(tree: Tree, what: Any) -> dict[str, Any]:
    return {
        name: shaped(value, what) if isinstance(value, Mapping) else what(value)
        for name, value in tree.items()
    }
