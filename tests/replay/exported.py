"""Exported data sets as the formats' own libraries read them, trajectory after trajectory."""

import csv
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import minari
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tensorstore
from numpy.typing import NDArray

from .recorded import Arrays


def read_d4rl(out: Path, agent: str) -> Arrays:
    with h5py.File(out / f"{agent}.hdf5") as file:
        found = {name: file[name][()] for name in file}
    ends = found["terminals"] | found["timeouts"]
    return {
        "observations": found["observations"],
        "actions": found["actions"],
        "rewards": found["rewards"],
        "next_observations": found["next_observations"],
        "terminated": found["terminals"],
        "starts": np.flatnonzero(np.concatenate(([True], ends[:-1]))),
    }


def minari_episodes(out: Path, name: str) -> list[minari.EpisodeData]:
    return list(minari.MinariDataset(out / f"{name}-v0" / "data").iterate_episodes())


def read_minari(out: Path, agent: str) -> Arrays:
    episodes = minari_episodes(out, agent)
    parts = {
        "observations": [episode.observations[:-1] for episode in episodes],
        "actions": [episode.actions for episode in episodes],
        "rewards": [episode.rewards for episode in episodes],
        "next_observations": [episode.observations[1:] for episode in episodes],
        "terminated": [episode.terminations for episode in episodes],
        "truncated": [episode.truncations for episode in episodes],
    }
    found = {name: np.concatenate(arrays) for name, arrays in parts.items()}
    return {**found, "starts": _starts([len(episode) for episode in episodes])}


def read_parquet(out: Path, agent: str) -> Arrays:
    table = pq.read_table(out / f"{agent}.parquet")
    names = {
        "observation": "observations",
        "action": "actions",
        "reward": "rewards",
        "next_observation": "next_observations",
    }
    found = {names.get(name, name): column(table, name) for name in table.column_names}
    return {**found, "starts": _changes(found["trajectory"])}


def read_lerobot(out: Path, agent: str) -> Arrays:
    """As the format's description says: info.json names the files, and the episodes' rows."""
    root = out / agent
    info = json.loads((root / "meta" / "info.json").read_text())
    assert (info["codebase_version"], info["total_tasks"]) == ("v3.0", 1)
    assert pq.read_table(root / "meta" / "tasks.parquet").column("task_index").to_pylist() == [0]
    episodes = pq.read_table(root / "meta" / "episodes").to_pylist()
    assert [row["episode_index"] for row in episodes] == list(range(info["total_episodes"]))
    files = dict.fromkeys((row["data/chunk_index"], row["data/file_index"]) for row in episodes)
    paths = [root / info["data_path"].format(chunk_index=c, file_index=f) for c, f in files]
    assert sorted(paths) == sorted((root / "data").rglob("*.parquet"))
    table = pa.concat_tables([pq.read_table(path) for path in paths])
    assert table.num_rows == info["total_frames"] == episodes[-1]["dataset_to_index"]
    assert column(table, "index").tolist() == list(range(table.num_rows))
    assert set(table.column_names) == set(info["features"])
    statistics = json.loads((root / "meta" / "stats.json").read_text())
    for name, feature in info["features"].items():
        values = column(table, name)
        assert (str(values.dtype), list(values.shape[1:]) or [1]) == (
            feature["dtype"],
            feature["shape"],
        )
        for statistic in ("min", "max", "mean", "std"):
            expected = np.atleast_1d(getattr(values.astype(np.float64), statistic)(axis=0))
            np.testing.assert_allclose(statistics[name][statistic], expected, atol=1e-9)
        assert statistics[name]["count"] == [table.num_rows]
    found = {name: column(table, name) for name in table.column_names}
    starts = [row["dataset_from_index"] for row in episodes]
    assert starts == _changes(found["episode_index"]).tolist()
    assert np.flatnonzero(found["frame_index"] == 0).tolist() == starts
    assert (found["next.done"] == (found["next.terminated"] | found["next.truncated"])).all()
    rows = table.num_rows
    return {
        "observations": found["observation.state"].reshape(rows, -1),
        "actions": found["action"].reshape(rows, -1),
        "rewards": found["next.reward"],
        "next_observations": found["next.observation.state"].reshape(rows, -1),
        "terminated": found["next.terminated"],
        "truncated": found["next.truncated"],
        "exploring": found["exploring"],
        "starts": np.array(starts),
    }


def read_csv(out: Path, agent: str) -> Arrays:
    with (out / f"{agent}.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    found = dict(zip(header, zip(*rows, strict=True), strict=True))

    def floats(*names: str) -> NDArray[np.float32]:
        return np.array([[np.float32(text) for text in found[name]] for name in names]).T.copy()

    def flags(name: str) -> NDArray[np.bool_]:
        assert set(found[name]) <= {"true", "false"}
        return np.array([text == "true" for text in found[name]])

    def vector(name: str) -> NDArray[np.float32]:
        return floats(*(entry for entry in header if entry.rpartition("_")[0] == name))

    return {
        "observations": vector("observation"),
        "actions": vector("action"),
        "rewards": floats("reward")[:, 0],
        "next_observations": vector("next_observation"),
        "terminated": flags("terminated"),
        "truncated": flags("truncated"),
        "exploring": flags("exploring"),
        "starts": _changes(np.array(found["trajectory"], np.int64)),
        **{name: np.array(found[name], np.int64) for name in ("log", "copy", "step")},
    }


def read_vault(out: Path, agent: str) -> Arrays:
    """As `flashbax.vault` opens it: metadata.json names the arrays, vault_index how many rows."""
    root = out / f"{agent}.vlt" / "data"
    metadata = json.loads((root / "metadata.json").read_text())
    assert metadata["version"] // 1 == 1

    def opened(name: str) -> Any:
        store = {"driver": "ocdbt", "base": f"file://{root}", "path": name}
        return tensorstore.open({"driver": "zarr", "kvstore": store}).result()

    rows = int(opened("vault_index").read().result()[0])
    found = {}
    for name, dtype in _leaves(metadata["structure_dtype"]).items():
        values = opened(f"{name}.")[:, :rows].read().result()
        shape = _leaves(metadata["structure_shape"])[name]
        assert values.dtype.name == dtype and values.shape[0] == 1
        assert list(values.shape[2:]) == json.loads(f"[{shape[1:-1]}]")[2:]
        found[name] = values[0]
    masks = {name: found.get(f"infos.{name}") for name in ("legals", "next_legals")}
    seen = {"legals": found["observations"], "next_legals": found["infos.next_observations"]}
    before, after = (
        own[:, 0] if masks[name] is None else np.concatenate((own, masks[name]), axis=2)[:, 0]
        for name, own in seen.items()
    )
    cut = found["infos.cut"][:, 0]
    assert not cut[:-1].any() or (np.diff(found["infos.trajectory"][:, 0])[cut[:-1]] == 1).all()
    return {
        "observations": before,
        "actions": found["actions"].reshape(rows, -1).astype(np.float32),
        "rewards": found["rewards"][:, 0],
        "next_observations": after,
        "terminated": found["terminals"][:, 0],
        "truncated": found["truncations"][:, 0] & ~cut,
        "exploring": found["infos.exploring"][:, 0],
        "starts": _changes(found["infos.trajectory"][:, 0]),
        **{name: found[f"infos.{name}"][:, 0] for name in ("log", "copy", "step")},
    }


def _leaves(tree: Mapping[str, Any], group: str = "") -> dict[str, str]:
    found: dict[str, str] = {}
    for name, value in tree.items():
        found |= _leaves(value, f"{name}.") if isinstance(value, dict) else {group + name: value}
    return found


READERS: Mapping[str, Callable[[Path, str], Arrays]] = {
    "minari": read_minari,
    "d4rl": read_d4rl,
    "parquet": read_parquet,
    "lerobot": read_lerobot,
    "csv": read_csv,
    "vault": read_vault,
}


def column(table: pa.Table, name: str) -> NDArray[Any]:
    """A column as (T,), or (T, n) where its values are lists of one size."""
    array = table.column(name).combine_chunks()
    if isinstance(array, pa.ChunkedArray):
        array = array.chunk(0)
    if pa.types.is_fixed_size_list(array.type):
        flat = array.flatten().to_numpy()
        return flat.reshape(-1, array.type.list_size)
    return np.asarray(array.to_numpy(zero_copy_only=False))


def _changes(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))


def _starts(lengths: list[int]) -> NDArray[np.int64]:
    return np.cumsum([0, *lengths[:-1]])
