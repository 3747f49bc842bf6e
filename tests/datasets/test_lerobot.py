"""LeRobot's data sets become a team's: frames with a true successor, split among the agents."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from otc_dist.datasets import store
from otc_dist.datasets.importers import import_files
from otc_dist.system.extras import install
from otc_dist.terminal.errors import UserError

LENGTHS = (7, 5, 8)  # of the episodes
FRAMES = sum(LENGTHS)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "cache"))


def frames() -> dict[str, Any]:
    """As a robot's recorder has them: one state that all see, one action, no successors."""
    draw = np.random.default_rng(0)
    last = np.cumsum(LENGTHS) - 1
    return {
        "observation.state": draw.standard_normal((FRAMES, 11)).astype(np.float32),
        "action": draw.uniform(-1, 1, (FRAMES, 3)).astype(np.float32),
        "next.reward": draw.standard_normal(FRAMES).astype(np.float32),
        "next.done": np.isin(np.arange(FRAMES), last),
        "timestamp": np.arange(FRAMES, dtype=np.float32) / 30,
        "frame_index": np.concatenate([np.arange(n) for n in LENGTHS]),
        "episode_index": np.repeat(np.arange(3), LENGTHS),
        "index": np.arange(FRAMES),
        "task_index": np.zeros(FRAMES, np.int64),
        "observation.effort": np.zeros((FRAMES, 2), np.float32),
    }


def write(
    root: Path, columns: dict[str, Any], version: object = "v3.0", split: int = 9, **info: object
) -> Path:
    """In two files, with lists as `datasets` writes them."""
    (root / "meta").mkdir(parents=True)
    told = {"codebase_version": version, "robot_type": "so101", "fps": 30, **info}
    (root / "meta" / "info.json").write_text(json.dumps(told))
    (root / "videos" / "observation.images.front").mkdir(parents=True)
    for number, rows in enumerate((slice(0, split), slice(split, None))):
        path = root / "data" / "chunk-000" / f"file-{number:03d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table({name: column(x[rows]) for name, x in columns.items()}), path)
    return root


def column(values: Any) -> pa.Array:
    return pa.array(values.tolist() if values.ndim > 1 else values)


def test_frames_with_a_successor_are_split_among_the_agents(tmp_path: Path) -> None:
    held = frames()
    card = import_files([write(tmp_path / "walked", held)], "mine", "hopper-3x1")
    kept = np.flatnonzero(~held["next.done"])
    joint = store.load_joint("hopper-3x1/mine")
    for i in range(3):
        np.testing.assert_array_equal(joint.observations[i], held["observation.state"][kept])
        np.testing.assert_array_equal(
            joint.next_observations[i], held["observation.state"][kept + 1]
        )
        np.testing.assert_array_equal(joint.actions[i][:, 0], held["action"][kept, i])
        np.testing.assert_array_equal(joint.rewards[i], held["next.reward"][kept])
    assert joint.episodes.tolist() == held["episode_index"][kept].tolist()
    assert (card.transitions, card.terminated, card.incomplete_episodes) == (17, 0, 3)
    assert card.notes == (
        "recorded with the robot so101",
        "no next.terminated in it: whether a task had ended is not known",
        "all agents see the whole state",
        "3 transitions were dropped: the file lacks their true successor",
        "features not taken: observation.effort, observation.images.front",
    )
    assert import_files([tmp_path / "walked"], "mine", "hopper-3x1") == card


def test_states_of_all_agents_one_behind_the_other_are_split(tmp_path: Path) -> None:
    held = frames()
    held["observation.state"] = np.tile(held["observation.state"], 3)
    held["observation.state"][:, 11:22] += 1
    held["next.reward"] = np.stack([held["next.reward"] + i for i in range(3)], axis=1)
    import_files([write(tmp_path / "a", held)], "mine", "hopper-3x1")
    joint = store.load_joint("hopper-3x1/mine")
    kept = np.flatnonzero(~held["next.done"])
    for i in range(3):
        own = held["observation.state"][kept, 11 * i : 11 * i + 11]
        np.testing.assert_array_equal(joint.observations[i], own)
        np.testing.assert_array_equal(joint.rewards[i], held["next.reward"][kept, i])


def changed(**fields: Any) -> dict[str, Any]:
    """The frames with other columns; None: without."""
    named = {name.replace("__", "."): value for name, value in fields.items()}
    return {name: value for name, value in {**frames(), **named}.items() if value is not None}


def bad(name: str, row: int, value: float) -> dict[str, Any]:
    tree = frames()
    tree[name] = tree[name].astype(np.float32)
    tree[name][row] = value
    return tree


BAD: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    (changed(next__reward=None), {}, "has no next.reward"),
    (changed(observation__state=np.zeros((FRAMES, 14))), {}, "shape (20, 14), not (any, 33)"),
    (changed(action=np.zeros((FRAMES, 2))), {}, "action has shape (20, 2), not (any, 3)"),
    (changed(action=np.full((FRAMES, 3), "x")), {}, "not numbers"),
    (bad("next.reward", 4, np.nan), {}, "not finite (NaN or infinity) in row 4"),
    (bad("next.done", 4, 2), {}, "holds values other than 0 and 1"),
    (changed(index=np.arange(FRAMES) + 1), {}, "are not 0, 1, 2, ... by their index"),
    (changed(episode_index=-np.arange(FRAMES)), {}, "episode_index is not ascending"),
    (frames(), {"version": "v2.1"}, "is of LeRobot's format 'v2.1'; v3.0 is read"),
    (frames(), {"version": ["v3.0"]}, "v3.0 is read"),
]


@pytest.mark.parametrize(("columns", "settings", "message"), BAD)
def test_a_bad_set_is_refused_in_one_line(
    tmp_path: Path, columns: dict[str, Any], settings: dict[str, Any], message: str
) -> None:
    assert message in refusal(write(tmp_path / "a", columns, **settings))


def refusal(root: Path, env_id: str = "hopper-3x1") -> str:
    with pytest.raises(UserError) as caught:
        import_files([root], "mine", env_id)
    assert "\n" not in str(caught.value) and str(root) in str(caught.value)
    return str(caught.value)


def first(root: Path) -> Path:
    return root / "data" / "chunk-000" / "file-000.parquet"


def many_rows(root: Path) -> None:
    """Ten million zeros in some hundred bytes."""
    zeros = pa.chunked_array([pa.array(np.zeros(10**6, np.float32))] * 10)
    pq.write_table(pa.table({"index": zeros}), first(root))


def ragged(root: Path) -> None:
    table = pq.read_table(first(root))
    rows = [[0.0] * (3 - t % 2) for t in range(len(table))]
    place = table.column_names.index("action")
    pq.write_table(table.set_column(place, "action", pa.array(rows)), first(root))


def missing(root: Path) -> None:
    table = pq.read_table(first(root))
    place = table.column_names.index("next.reward")
    column = pa.array([None, *[0.0] * (len(table) - 1)])
    pq.write_table(table.set_column(place, "next.reward", column), first(root))


DAMAGE: list[tuple[Callable[[Path], object], str]] = [
    (lambda root: first(root).write_bytes(b"PAR1"), "cannot be read as Parquet"),
    (lambda root: first(root).write_bytes(first(root).read_bytes()[:-9]), "cannot be read"),
    (lambda root: (root / "meta" / "info.json").write_text("["), "is not LeRobot's"),
    (lambda root: [path.unlink() for path in root.rglob("*.parquet")], "has no data/*/*.parquet"),
    (lambda root: first(root).unlink(), "are not 0, 1, 2, ... by their index"),
    (many_rows, "is to hold more numbers than it stores"),
    (ragged, "action has lists of several sizes"),
    (missing, "next.reward lacks values"),
]


@pytest.mark.parametrize(("damage", "message"), DAMAGE)
def test_a_damaged_set_is_refused_in_one_line(
    tmp_path: Path, damage: Callable[[Path], object], message: str
) -> None:
    root = write(tmp_path / "a", frames())
    damage(root)
    assert message in refusal(root)


def test_the_environment_and_the_library_are_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = write(tmp_path / "a", frames())
    assert "say it with --env" in refusal(root, "")
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(UserError, match="needs pyarrow") as caught:
        import_files([root], "mine", "hopper-3x1")
    assert install("lerobot") in str(caught.value)
