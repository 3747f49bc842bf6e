"""OG-MARL's vaults become data sets: what of them has a true successor, and nothing else."""

import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from otc_dist.datasets import store
from otc_dist.datasets.card import DatasetCard
from otc_dist.datasets.importers import import_files
from otc_dist.description import user_code
from otc_dist.system.extras import install
from otc_dist.terminal.errors import UserError

from .vaults import write_vault

PUSH = "mpe2.simple_push_v3:parallel_env"  # agents that observe 8 and 19 numbers, and 5 choices
ROWS = 30


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "cache"))


def battle() -> dict[str, Any]:
    """What `flashbax_0.1.3.zip` holds: 24 rows of five agents; each seventh ends an episode."""
    t, i, k = np.arange(24), np.arange(5), np.arange(55)
    legals = np.ones((1, 24, 5, 12), np.float32)
    legals[..., 0] = 0
    shape = (1, 24, 5)
    return {
        "observations": (t[:, None, None] + i[:, None] / 8 + k / 1024)[None].astype(np.float32),
        "actions": ((t[:, None] + i) % 11 + 1)[None].astype(np.int32),
        "rewards": np.broadcast_to(t[:, None], shape[1:])[None].astype(np.float32),
        "terminals": np.broadcast_to(t[:, None] % 7 == 6, shape[1:])[None].astype(np.float32),
        "truncations": np.zeros(shape, np.float32),
        "infos": {"legals": legals, "state": np.zeros((1, 24, 98), np.float32)},
    }


def hoppers(streams: int = 1) -> dict[str, Any]:
    """Three agents with continuous actions; episodes are terminal or truncated, in turns."""
    draw = np.random.default_rng(0)
    shape = (streams, ROWS, 3)
    ends = np.broadcast_to((np.arange(ROWS) % 6 == 5)[:, None], shape)
    odd = np.broadcast_to((np.arange(ROWS) % 12 == 5)[:, None], shape)
    return {
        "observations": draw.standard_normal((*shape, 11)).astype(np.float32),
        "actions": draw.uniform(-1, 1, (*shape, 1)).astype(np.float32),
        "rewards": draw.standard_normal(shape).astype(np.float32),
        "terminals": ends & odd,
        "truncations": ends & ~odd,
        "infos": {"state": np.zeros((*shape[:2], 19), np.float32)},
    }


def taken(path: Path, env_id: str) -> tuple[DatasetCard, Any]:
    card = import_files([path], "mine", env_id)
    return card, store.load_joint(f"{env_id}/mine")


def test_a_vault_that_flashbax_wrote_is_read_without_it(tmp_path: Path) -> None:
    with zipfile.ZipFile(Path(__file__).with_name("flashbax_0.1.3.zip")) as archive:
        archive.extractall(tmp_path)
    card, joint = taken(tmp_path / "5m_vs_6m.vlt", "5m_vs_6m")
    held = battle()
    lost = [6, 13, 20, 23]
    kept = np.delete(np.arange(24), lost)
    assert (card.transitions, card.terminated, card.truncated) == (20, 0, 0)
    for i in range(5):
        seen = np.hstack((held["observations"][0, :, i], held["infos"]["legals"][0, :, i]))
        np.testing.assert_array_equal(joint.observations[i], seen[kept])
        np.testing.assert_array_equal(joint.next_observations[i], seen[kept + 1])
        np.testing.assert_array_equal(joint.actions[i][:, 0], held["actions"][0, kept, i])
        np.testing.assert_array_equal(joint.rewards[i], held["rewards"][0, kept, i])
    assert joint.episodes.tolist() == (kept // 7).tolist()
    # The steps that were dropped count in the returns.
    assert (card.episodes, card.incomplete_episodes) == (3, 1)
    assert card.returns is not None and card.returns.maximum == sum(range(14, 21))
    assert card.notes == (
        "the vault names no environment: 5m_vs_6m",
        "4 transitions were dropped: the file lacks their true successor; 3 of them terminated, "
        "0 that terminated are left, so learners cannot see that falling ends an episode",
        "arrays not taken: infos.state",
    )
    assert card.recipe["vault"] == "5m_vs_6m.vlt/Good"
    assert import_files([tmp_path / "5m_vs_6m.vlt" / "Good"], "mine", "5m_vs_6m") == card


def test_what_this_package_writes_flashbax_reads(tmp_path: Path) -> None:
    """And what `write_vault` writes: the other tests stand on it."""
    vault = pytest.importorskip("flashbax.vault", reason="Flashbax brings JAX: 600 MB")
    held = battle()
    write_vault(tmp_path / "a.vlt" / "Good", held)
    read = vault.Vault("a.vlt", vault_uid="Good", rel_dir=str(tmp_path)).read().experience
    np.testing.assert_array_equal(read["infos"]["legals"], held["infos"]["legals"])


@pytest.mark.parametrize("by_agent", [False, True])
def test_streams_follow_one_another_and_none_goes_on_in_the_next(
    tmp_path: Path, by_agent: bool
) -> None:
    held = hoppers(streams=2)
    tree = dict(held)
    if by_agent:  # as OG-MARL's recorder has them
        for name in ("observations", "actions", "rewards", "terminals", "truncations"):
            tree[name] = {f"agent_{i}": held[name][:, :, i] for i in range(3)}
    card, joint = taken(write_vault(tmp_path / "a", tree), "hopper-3x1")
    row = np.arange(2 * ROWS)
    kept = row[row % 6 != 5]
    assert card.transitions == len(kept) == 50
    assert (card.episodes, card.incomplete_episodes) == (6, 4)  # cut before the task's limit
    seen = held["observations"].reshape(2 * ROWS, 3, 11)
    for i in range(3):
        np.testing.assert_array_equal(joint.observations[i], seen[kept, i])
        np.testing.assert_array_equal(joint.next_observations[i], seen[kept + 1, i])
        np.testing.assert_array_equal(joint.actions[i], held["actions"].reshape(-1, 3, 1)[kept, i])


def test_a_stream_that_has_no_end_loses_its_last_row(tmp_path: Path) -> None:
    held = {**hoppers(streams=2)}
    held["terminals"] = held["truncations"] = np.zeros((2, ROWS, 3), np.bool_)
    card, joint = taken(write_vault(tmp_path / "a", held), "hopper-3x1")
    assert card.transitions == 2 * (ROWS - 1) and card.incomplete_episodes == 2
    assert np.unique(joint.episodes).tolist() == [0, 1]


def pushers() -> dict[str, Any]:
    """Agents that observe 8 and 19 numbers: OG-MARL fills the narrower up with zeros."""
    draw = np.random.default_rng(0)
    seen = draw.standard_normal((1, ROWS, 2, 19)).astype(np.float32)
    seen[:, :, 0, 8:] = 0
    return {
        "observations": seen,
        "actions": draw.integers(0, 5, (1, ROWS, 2)).astype(np.int32),
        "rewards": draw.standard_normal((1, ROWS, 2)).astype(np.float32),
        "terminals": np.zeros((1, ROWS, 2), np.bool_),
    }


def test_narrower_vectors_lose_what_they_were_filled_up_with(tmp_path: Path) -> None:
    user_code.allow(PUSH)
    held = pushers()
    card, joint = taken(write_vault(tmp_path / "a", held), PUSH)
    for i, size in enumerate((8, 19)):
        np.testing.assert_array_equal(
            joint.observations[i][:, :size], held["observations"][0, :-1, i, :size]
        )
        assert (
            joint.observations[i].shape[1] == size + 5
            and (joint.observations[i][:, size:] == 1).all()
        )
    assert card.notes[1:3] == (
        "no infos.legals in the vault: every action was taken to be available",
        "no truncations in the vault: no episode was taken to be cut",
    )
    held["observations"][0, 4, 0, 12] = 1
    with pytest.raises(UserError, match="observations of adversary_0 are more than 8 numbers"):
        import_files([write_vault(tmp_path / "b", held)], "other", PUSH)


def test_an_agent_that_ends_before_the_others_is_told(tmp_path: Path) -> None:
    held = hoppers()
    terminals = held["terminals"].copy()
    terminals[0, 2:5, 1] = True
    card, _ = taken(write_vault(tmp_path / "a", {**held, "terminals": terminals}), "hopper-3x1")
    assert "in 3 steps some agents had ended, and the team had not" in card.notes


def test_successors_of_ours_are_taken_and_steps_that_did_not_happen_are_not(tmp_path: Path) -> None:
    held = hoppers()
    after = held["observations"] + 1
    held["truncations"] = held["truncations"] | held["terminals"]  # the simulator broke off
    held["infos"]["next_observations"] = after
    card, joint = taken(write_vault(tmp_path / "a", held), "hopper-3x1")
    broken = [5, 17, 29]
    assert "without 3 steps whose simulator broke off" in card.notes
    assert (card.transitions, card.terminated, card.truncated) == (27, 0, 2)
    kept = np.delete(np.arange(ROWS), broken)
    np.testing.assert_array_equal(joint.next_observations[1], after[0, kept, 1])


def changed(**fields: object) -> dict[str, Any]:
    """The hoppers with other arrays; None: without."""
    tree = {**hoppers(), **fields}
    return {name: value for name, value in tree.items() if value is not None}


def bad(name: str, row: int, value: float) -> NDArray[Any]:
    array = hoppers()[name].astype(np.float32)
    array[0, row, 1] = value
    return array


def legal(row: int, action: int, value: float) -> dict[str, Any]:
    tree = battle()
    tree["infos"]["legals"][0, row, 2, action] = value
    return tree


BAD: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    (changed(rewards=None), {}, "has no rewards"),
    (changed(observations=None), {}, "has no observations"),
    (changed(actions={"agent_0": np.zeros((1, ROWS, 1), np.float32)}), {}, "no actions of agent_1"),
    (changed(observations=np.zeros((1, ROWS, 3, 14), np.float32)), {}, "14 numbers wide, not 11"),
    (changed(observations=np.zeros((1, ROWS, 2, 11), np.float32)), {}, "and 3 agents"),
    (changed(observations=np.zeros((1, ROWS, 3, 1, 11), np.float32)), {}, "3 agents of vectors"),
    (changed(rewards=np.zeros((2, ROWS, 3), np.float32)), {}, "no 1 streams"),
    (changed(rewards=bad("rewards", 7, np.nan)), {}, "not finite (NaN or infinity) in row 7"),
    (changed(terminals=bad("terminals", 7, 2)), {}, "holds values other than 0 and 1"),
    (legal(3, 4, 0.5), {}, "infos.legals of agent_2 are not 0 and 1"),
    (legal(3, 6, 0), {}, "agent_2: action 6 of row 3 is none of its available ones"),
    (hoppers(), {"version": 2.0}, "of version 2.0; version 1.x is read"),
    (hoppers(), {"version": None}, "of version None"),
    (hoppers(), {"index": 0}, "is empty"),
    (hoppers(), {"index": 2**31 - 1}, "observations is to take"),
    (hoppers(), {"compressor": {"id": "zstd", "level": 1}}, "is compressed by zstd"),
    (hoppers(), {"chunks": [1, 10**9, 3, 11]}, "is stored in parts of"),
]


@pytest.mark.parametrize(("tree", "settings", "message"), BAD)
def test_a_bad_vault_is_refused_in_one_line(
    tmp_path: Path, tree: dict[str, Any], settings: dict[str, Any], message: str
) -> None:
    if "chunks" in settings:  # that fit one array only
        tree = {"observations": tree["observations"]}
    path = write_vault(tmp_path / "a", tree, **settings)
    assert message in refusal(
        path, "5m_vs_6m" if "legals" in tree.get("infos", {}) else "hopper-3x1"
    )


def refusal(path: Path, env_id: str = "hopper-3x1") -> str:
    with pytest.raises(UserError) as caught:
        import_files([path], "mine", env_id)
    told = str(caught.value)
    assert "\n" not in told and str(path) in told
    return told


def cut_short(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


DAMAGE: list[tuple[Callable[[Path], object], str]] = [
    (lambda path: (path / "manifest.ocdbt").write_text("hello"), "vault_index is damaged"),
    (lambda path: (path / "metadata.json").unlink(), "metadata.json cannot be read"),
    (lambda path: (path / "metadata.json").write_text("[" * 10**5), "metadata.json cannot be read"),
    (lambda path: (path / "metadata.json").write_text('{"version": 1.2}'), "names no arrays"),
    (lambda path: [cut_short(file) for file in (path / "d").iterdir()], "is damaged"),
    (lambda path: [file.unlink() for file in (path / "d").iterdir()], "is damaged"),
]


@pytest.mark.parametrize(("damage", "message"), DAMAGE)
def test_a_damaged_vault_is_refused_in_one_line(
    tmp_path: Path, damage: Callable[[Path], object], message: str
) -> None:
    path = write_vault(tmp_path / "a", hoppers())
    damage(path)
    assert message in refusal(path)


def test_one_vault_of_several_has_to_be_named_and_its_environment(tmp_path: Path) -> None:
    for name in ("Good", "Poor"):
        write_vault(tmp_path / "3hopper.vlt" / name, hoppers())
    assert f"such as {tmp_path / '3hopper.vlt' / 'Good'}" in refusal(tmp_path / "3hopper.vlt")
    assert "say it with --env" in refusal(tmp_path / "3hopper.vlt" / "Good", "")
    (tmp_path / "none.vlt").mkdir()
    assert "is no vault" in refusal(tmp_path / "none.vlt")


def test_without_tensorstore_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_vault(tmp_path / "a", hoppers())
    monkeypatch.setitem(sys.modules, "tensorstore", None)
    with pytest.raises(UserError, match="needs TensorStore") as caught:
        import_files([tmp_path / "a"], "mine", "hopper-3x1")
    assert install("vault") in str(caught.value)
