"""Data sets are made once, the same everywhere, whole or not at all, one file per agent."""

import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from otc_dist.datasets import store, writing
from otc_dist.datasets.card import DatasetCard
from otc_dist.envs import registry
from otc_dist.envs.robot_specs import PARTITIONS
from otc_dist.terminal.errors import UserError

NAME, SIZE = "hopper-3x1/random", 1500


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path))
    return tmp_path


def set_folder() -> Path:
    return store.agent_file(NAME, "agent_0", SIZE).parent


def test_every_level_of_every_robot_has_d4rls_size() -> None:
    sizes = {
        (env_id, level): store.usual_size(f"{env_id}/{level}")
        for env_id in PARTITIONS
        for level in ("random", "medium", "medium-replay")
    }
    assert sizes["hopper-3x1", "medium-replay"] == sizes["hopper-1x3", "medium-replay"] == 402_000
    assert sizes["walker2d-2x3", "medium-replay"] == 302_000
    assert sizes["halfcheetah-2x3", "medium-replay"] == 202_000
    assert {size for (_, level), size in sizes.items() if level != "medium-replay"} == {1_000_000}


def test_an_agents_file_holds_its_own_columns_and_nothing_of_the_others(cache: Path) -> None:
    store.ensure(NAME, SIZE)
    joint = store.load_joint(NAME, SIZE)
    raw = [store.agent_file(NAME, f"agent_{i}", SIZE).read_bytes() for i in range(3)]
    for own in range(3):
        tensors = load_file(store.agent_file(NAME, f"agent_{own}", SIZE))
        assert sum(array.size for array in tensors.values()) == SIZE * (11 + 1 + 1 + 11 + 3)
        for other in range(3):
            assert (joint.actions[other].tobytes() in raw[own]) == (other == own)


def test_all_agents_files_are_row_aligned(cache: Path) -> None:
    store.ensure(NAME, SIZE)
    joint = store.load_joint(NAME, SIZE)
    for index in range(3):
        own = store.load_agent(store.agent_file(NAME, f"agent_{index}", SIZE), f"agent_{index}")
        np.testing.assert_array_equal(own.observations, joint.observations[0])
        np.testing.assert_array_equal(own.actions, joint.actions[index])
        np.testing.assert_array_equal(own.terminated, joint.terminated)
    inside = np.flatnonzero(np.diff(joint.episodes) == 0)
    np.testing.assert_array_equal(
        joint.next_observations[0][inside], joint.observations[0][inside + 1]
    )


def test_the_same_set_has_the_same_hashes_everywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cards = []
    for place in ("here", "there"):
        monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / place))
        cards.append(store.ensure(NAME, SIZE))
    assert cards[0] == cards[1]


def test_a_machine_where_one_agent_learns_keeps_that_agents_file_alone(cache: Path) -> None:
    card = store.ensure(NAME, SIZE, agents=["agent_1"])
    alone = store.agent_file(NAME, "agent_1", SIZE).read_bytes()
    assert sorted(path.name for path in set_folder().iterdir()) == [
        "agent_1.safetensors",
        "card.json",
    ]
    store.ensure(NAME, SIZE, agents=["agent_0"])  # another's comes beside it
    assert not store.agent_file(NAME, "agent_2", SIZE).exists()
    whole = store.ensure(NAME, SIZE)
    assert whole.files["agent_1"] == card.files["agent_1"]
    assert store.agent_file(NAME, "agent_1", SIZE).read_bytes() == alone
    with pytest.raises(UserError, match="unknown agent 'agent_7'"):
        store.ensure(NAME, SIZE, agents=["agent_7"])


def test_the_returns_are_of_complete_episodes(cache: Path) -> None:
    card, joint = store.ensure(NAME, SIZE), store.load_joint(NAME, SIZE)
    ids = np.unique(joint.episodes[joint.terminated])
    sums = [joint.rewards[0][joint.episodes == i].sum(dtype=np.float64) for i in ids]
    assert (card.episodes, card.incomplete_episodes) == (len(ids), 1)
    assert card.returns is not None
    assert card.normalised_score is not None
    assert card.returns.mean == pytest.approx(np.mean(sums))
    assert card.returns.std == pytest.approx(np.std(sums))
    expected = registry.normalised_score("hopper-3x1", card.returns.mean)
    assert card.normalised_score.mean == pytest.approx(expected)


def test_a_set_in_the_cache_is_not_made_again(cache: Path) -> None:
    made = store.ensure(NAME, SIZE)
    times = {path: path.stat().st_mtime_ns for path in set_folder().iterdir()}
    calls: list[int] = []
    assert store.ensure(NAME, SIZE, lambda done, total: calls.append(done)) == made
    assert calls == []
    assert {path: path.stat().st_mtime_ns for path in set_folder().iterdir()} == times


@pytest.mark.parametrize("damage", ["flip", "cut", "remove", "card", "recipe"])
def test_a_damaged_or_outdated_set_is_made_again(
    cache: Path, damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    made = store.ensure(NAME, SIZE)
    file, card = set_folder() / "agent_2.safetensors", set_folder() / "card.json"
    content = file.read_bytes()
    if damage == "flip":
        file.write_bytes(content[:-5000] + bytes([content[-5000] ^ 1]) + content[-4999:])
    elif damage == "cut":
        file.write_bytes(content[:-1])
    elif damage == "remove":
        file.unlink()
    elif damage == "card":
        card.write_text(card.read_text()[:-20])
    else:
        old = made.model_copy(update={"recipe": {**made.recipe, "mujoco": "3.0.0"}})
        card.write_text(old.to_json())
    assert store.ensure(NAME, SIZE) == made
    assert file.read_bytes() == content
    assert sorted(path.name for path in set_folder().parent.iterdir()) == [".lock", str(SIZE)]
    assert "again" in caplog.text


def test_an_unknown_name_gets_the_nearest_known_one() -> None:
    with pytest.raises(UserError, match="did you mean 'hopper-3x1/medium-replay'"):
        store.ensure("hopper-3x1/medium-reply")
    with pytest.raises(UserError, match=r"unknown data set '\.\./secrets'"):
        store.agent_file("../secrets", "agent_0")
    with pytest.raises(UserError, match="unknown agent 'agent_3'"):
        store.agent_file(NAME, "agent_3")
    with pytest.raises(UserError, match="-1 transitions"):
        store.ensure(NAME, -1)


MAKE = [sys.executable, "-m", "otc_dist.datasets", "make", NAME, "--transitions", str(SIZE)]


def test_processes_that_want_the_same_set_at_once_make_it_once(cache: Path) -> None:
    processes = [
        subprocess.Popen(MAKE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    results = [process.communicate(timeout=60) for process in processes]
    assert [process.returncode for process in processes] == [0, 0, 0]
    assert len({output for output, _ in results}) == 1
    assert sum(f"{SIZE:,} of {SIZE:,} transitions" in errors for _, errors in results) == 1


HOLD = """
import sys, time
from otc_dist.datasets.names import DatasetName
from otc_dist.datasets.writing import locked
with locked(DatasetName.parse(sys.argv[1])):
    print("held", flush=True)
    {}
"""


@pytest.mark.parametrize("holder", ["sys.stdin.read()", "while True: pass"])
def test_who_waits_for_a_set_says_for_whom_and_gives_up_if_that_one_stands_still(
    cache: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, holder: str
) -> None:
    monkeypatch.setattr(writing, "_PATIENCE", 1.0)
    monkeypatch.setattr(writing, "_LOG_EVERY", 0.5)
    command = [sys.executable, "-c", HOLD.format(holder), NAME]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as held:
        try:
            assert held.stdout is not None and held.stdout.readline() == b"held\n"
            if "pass" in holder:  # it works: it is waited for until it ends
                threading.Timer(2.5, held.kill).start()
                store.ensure(NAME, SIZE)
                assert f"process {held.pid} is still making {NAME}" in caplog.text
            else:
                with pytest.raises(UserError, match=rf"process {held.pid}, .* has done nothing"):
                    store.ensure(NAME, SIZE)
            assert f"process {held.pid} is making {NAME}; waiting for it" in caplog.text
        finally:
            held.kill()


LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
from otc_dist.datasets.__main__ import main
from otc_dist.terminal.errors import run_main
run_main(main)
"""


def test_a_write_that_fails_leaves_nothing_behind(cache: Path) -> None:
    command = [sys.executable, "-c", LIMITED, *MAKE[3:]]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert result.returncode == 2
    assert result.stderr.splitlines()[-1].startswith("error: cannot write")
    assert "Traceback" not in result.stderr
    assert [path.name for path in (cache / "datasets" / NAME).iterdir()] == [".lock"]


def test_a_full_disk_is_one_line(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(UserError, match="No space left on device; free some space"):
        store.ensure(NAME, SIZE)
    assert not set_folder().exists()


def test_what_a_killed_process_left_is_removed(cache: Path) -> None:
    left = cache / "datasets" / NAME / ".making-abc"
    left.mkdir(parents=True)
    (left / "agent_0.safetensors").write_bytes(b"half")
    store.ensure(NAME, SIZE)
    assert not left.exists()


def test_a_card_of_a_later_format_is_not_read(cache: Path) -> None:
    card = store.ensure(NAME, SIZE)
    later = card.model_copy(update={"format_version": 2})
    (set_folder() / "card.json").write_text(later.to_json())
    assert DatasetCard.read(set_folder()) is None
