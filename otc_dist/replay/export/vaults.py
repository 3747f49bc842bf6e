"""Flashbax vaults in OG-MARL's layout: `PATH/joint.vlt/data`, `PATH/agent_0.vlt/data`, ...

    observations, actions, rewards, terminals, truncations   (1, T, N, ...) each
    infos.legals                      the masks of discrete actions, which then are indices
    infos.state                       the simulator's, before the step, in the joint vault
    infos.next_observations, infos.next_legals     the true successors
    infos.exploring, infos.cut, infos.log, infos.deployment, infos.copy, infos.trajectory,
    infos.episode_seed, infos.step    what else the row is

Trajectories stand one after the other, so `truncations` is set wherever one stops without an end,
and `infos.cut` with it. Vectors that are narrower than another agent's are filled up with zeros.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import tensorstore
from numpy.typing import NDArray

from otc_dist.replay.export.formats import View
from otc_dist.replay.export.tables import Columns, place_columns
from otc_dist.replay.export.trajectories import Trajectory

_FLASHBAX = 1.2  # of Flashbax's vaults
_TIME = 10**13  # length of the time axis; `vault_index` says how much of it was written
_CHUNK = 4096  # rows that are compressed together
_COMPRESSOR = {"id": "gzip", "level": 5}  # Flashbax's own


def open_writer(folder: Path, view: View) -> "VaultWriter":
    """A `Writer` of one vault."""
    return VaultWriter(folder / f"{view.name}.vlt" / "data", view)


class VaultWriter:
    """Writes one vault, whole chunks at a time: of one that is written again both would stay."""

    def __init__(self, folder: Path, view: View) -> None:
        self._folder, self._view = folder, view
        self._rows = self._trajectories = 0
        self._waiting: Columns = {}
        self._arrays: dict[str, tensorstore.TensorStore] = {}
        self._database = tensorstore.Context()  # one for all arrays, or they do not know each other
        folder.mkdir(parents=True)

    def write(self, batch: Sequence[Trajectory]) -> None:
        columns = _columns(batch, self._view, self._trajectories)
        self._trajectories += len(batch)
        if self._waiting:
            columns = {
                name: np.concatenate((self._waiting[name], columns[name])) for name in columns
            }
        rows = len(columns["rewards"])
        whole = rows - rows % _CHUNK
        self._append({name: values[:whole] for name, values in columns.items()})
        self._waiting = {name: values[whole:] for name, values in columns.items()}

    def _append(self, columns: Columns) -> None:
        count = len(columns["rewards"])
        with _disk_errors():
            with tensorstore.Transaction(
                atomic=True
            ) as together:  # or each would be a commit of its own
                arrays = {
                    name: self._arrays[name].with_transaction(together)
                    if name in self._arrays
                    else self._created(name, values, together)
                    for name, values in columns.items()
                }
                for name, values in columns.items():
                    arrays[name][0, self._rows : self._rows + count] = values
            self._arrays = {name: array.with_transaction(None) for name, array in arrays.items()}
        self._rows += count

    def _created(
        self, name: str, values: NDArray[Any], together: tensorstore.Transaction
    ) -> tensorstore.TensorStore:
        zarr = {
            "shape": [1, _TIME, *values.shape[1:]],
            "chunks": [1, _CHUNK, *values.shape[1:]],
            "dtype": values.dtype.str,
            "compressor": _COMPRESSOR,
        }
        return self._opened(f"{name}.", {"metadata": zarr}, transaction=together)

    def _opened(self, name: str, more: dict[str, Any], **options: Any) -> tensorstore.TensorStore:
        base = {"driver": "file", "path": f"{self._folder.resolve()}/"}
        kvstore = {"driver": "ocdbt", "base": base, "path": name}
        specification = {"driver": "zarr", "kvstore": kvstore, **more}
        return tensorstore.open(
            specification, create=True, context=self._database, **options
        ).result()

    def close(self) -> None:
        self._append(self._waiting)
        with _disk_errors():
            index = self._opened("vault_index", {}, dtype=np.int32, shape=(1,))
            index[0] = self._rows
        found = {name: (array.shape, array.dtype.name) for name, array in self._arrays.items()}
        shapes = {name: str((1, _CHUNK, *shape[2:])) for name, (shape, _) in found.items()}
        metadata = {
            "version": _FLASHBAX,
            "structure_shape": _tree(shapes),
            "structure_dtype": _tree({name: dtype for name, (_, dtype) in found.items()}),
            "otc_dist": json.loads(self._view.about),
        }
        (self._folder / "metadata.json").write_text(json.dumps(metadata), encoding="utf-8")


@contextmanager
def _disk_errors() -> Iterator[None]:
    """What TensorStore says where the disk refuses something, as the error that others raise."""
    try:
        yield
    except (ValueError, RuntimeError) as error:
        raise OSError(str(error).partition(" [")[0]) from None


def _tree(leaves: dict[str, str]) -> dict[str, Any]:
    """What has the name "infos.cut" as {"infos": {"cut": ...}}."""
    tree: dict[str, Any] = {}
    for name, leaf in leaves.items():
        group, _, field = name.rpartition(".")
        (tree.setdefault(group, {}) if group else tree)[field] = leaf
    return tree


def _columns(batch: Sequence[Trajectory], view: View, first: int) -> Columns:
    """The arrays by their names, (rows, ...); `first` is the number of the first trajectory."""

    def of(name: str) -> list[NDArray[Any]]:
        return [np.concatenate([getattr(part, name)[i] for part in batch]) for i in view.agents]

    found: Columns = {}
    choices = [view.team.agents[i].choices for i in view.agents]
    for name, observed in (("", of("observations")), ("infos.next_", of("next_observations"))):
        sizes = [seen.shape[1] - count for seen, count in zip(observed, choices, strict=True)]
        parts = list(zip(observed, sizes, strict=True))
        found[f"{name}observations"] = _stacked([seen[:, :size] for seen, size in parts])
        if any(choices):
            masks = _stacked([seen[:, size:] for seen, size in parts])
            found["infos.next_legals" if name else "infos.legals"] = masks
    actions = _stacked(of("actions"))
    found["actions"] = actions[:, :, 0].astype(np.int32) if all(choices) else actions
    found["rewards"] = np.stack(of("rewards"), axis=1)
    terminated = np.concatenate([part.terminated for part in batch])
    truncated = np.concatenate([part.truncated for part in batch])
    cut = np.zeros(len(terminated), np.bool_)
    cut[np.cumsum([len(part) for part in batch]) - 1] = True
    cut &= ~(terminated | truncated)
    for name, ends in (("terminals", terminated), ("truncations", truncated | cut)):
        found[name] = np.repeat(ends[:, np.newaxis], len(choices), axis=1)
    found["infos.exploring"] = np.stack(of("exploring"), axis=1)
    if view.agent is None and view.team.state_size:
        found["infos.state"] = np.concatenate([part.state for part in batch])
    places = {"cut": cut, **place_columns(batch, first)}
    return found | {f"infos.{name}": values[:, np.newaxis] for name, values in places.items()}


def _stacked(vectors: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """N x (rows, n), each of its own n, as (rows, N, the largest n)."""
    widest = max(vector.shape[1] for vector in vectors)
    return np.stack(
        [np.pad(vector, ((0, 0), (0, widest - vector.shape[1]))) for vector in vectors], axis=1
    )
