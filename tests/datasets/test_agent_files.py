"""An agent's data set file: its own data only, and every kind of damage refused in one line."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from otc_dist.datasets.agent_files import Header, encode, load_agent, load_tensors
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Transitions

ROWS = 50
HEADER = Header(
    format_version=1,
    dataset="hopper-3x1/medium",
    env_id="hopper-3x1",
    agent="agent_1",
    transitions=ROWS,
    observation_size=11,
    action_size=1,
    origin="a test",
    versions={"numpy": "2"},
)
EPISODES = np.arange(ROWS) // 10


def some_data() -> Transitions:
    draw = np.random.default_rng(0)
    return Transitions(
        observations=draw.standard_normal((ROWS, 11)).astype(np.float32),
        actions=draw.uniform(-1, 1, (ROWS, 1)).astype(np.float32),
        rewards=draw.standard_normal(ROWS).astype(np.float32),
        next_observations=draw.standard_normal((ROWS, 11)).astype(np.float32),
        terminated=np.arange(ROWS) % 20 == 9,
        truncated=np.arange(ROWS) % 20 == 19,
    )


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "agent_1.safetensors"
    path.write_bytes(encode(HEADER, some_data(), EPISODES))
    return path


def refusal(path: Path, agent: str = "agent_1") -> str:
    with pytest.raises(UserError) as caught:
        load_agent(path, agent)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


def test_what_is_read_is_what_was_written(file: Path) -> None:
    data, expected = load_agent(file, "agent_1"), some_data()
    for name in vars(expected):
        found, original = getattr(data, name), getattr(expected, name)
        assert found.dtype == original.dtype
        np.testing.assert_array_equal(found, original)
    np.testing.assert_array_equal(load_tensors(file, "agent_1")["episodes"], EPISODES)


def test_equal_data_give_equal_bytes() -> None:
    first = encode(HEADER, some_data(), EPISODES)
    assert all(encode(HEADER, some_data(), EPISODES) == first for _ in range(5))


def test_a_plain_safetensors_reader_sees_who_it_is_for(file: Path) -> None:
    raw = file.read_bytes()
    text = raw[8 : 8 + int.from_bytes(raw[:8], "little")]
    header = json.loads(json.loads(text)["__metadata__"]["otc_dist"])
    assert (header["agent"], header["env_id"]) == ("agent_1", "hopper-3x1")
    assert load_file(file)["actions"].shape == (ROWS, 1)


def test_a_change_of_any_byte_is_noticed(file: Path) -> None:
    intact = file.read_bytes()
    start = 8 + int.from_bytes(intact[:8], "little")
    places = {0, 7, 8, 20, start - 1, start, len(intact) - 1}
    places |= set(np.linspace(9, len(intact) - 2, 60).astype(int).tolist())
    for place in sorted(places):
        damaged = bytearray(intact)
        damaged[place] ^= 0x04
        file.write_bytes(damaged)
        refusal(file)


@pytest.mark.parametrize("kept", [0, 4, 8, 100, -1])
def test_a_file_cut_short_is_refused(file: Path, kept: int) -> None:
    file.write_bytes(file.read_bytes()[:kept])
    refusal(file)


def test_another_agents_file_is_refused(file: Path) -> None:
    assert "holds the data of agent_1, not of agent_0" in refusal(file, "agent_0")


def test_a_missing_file_is_refused_with_the_command_that_makes_it(tmp_path: Path) -> None:
    path = tmp_path / "hopper-3x1" / "medium" / "500" / "agent_0.safetensors"
    assert "make hopper-3x1/medium --transitions 500" in refusal(path, "agent_0")


def test_a_foreign_safetensors_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "agent_1.safetensors"
    save_file({"weights": np.zeros(3, np.float32)}, path)
    assert "is not a data set file of otc_dist" in refusal(path)


def test_another_format_version_is_refused_naming_both(file: Path) -> None:
    future = HEADER.model_copy(update={"format_version": 7})
    file.write_bytes(encode(future, some_data(), EPISODES))
    message = refusal(file)
    assert "version 7" in message
    assert "reads 1" in message


def test_sizes_other_than_the_environments_are_refused(file: Path) -> None:
    header = HEADER.model_copy(update={"action_size": 2})
    data = replace(some_data(), actions=np.zeros((ROWS, 2), np.float32))
    file.write_bytes(encode(header, data, EPISODES))
    assert "(11, 2), where agent_1 of hopper-3x1 has (11, 1)" in refusal(file)


@pytest.mark.parametrize("name", ["observations", "actions", "rewards", "next_observations"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_is_refused(file: Path, name: str, value: float) -> None:
    tensors = load_file(file)
    tensors[name][7] = value
    save_file(tensors, file, metadata={"otc_dist": HEADER.sealed(tensors).model_dump_json()})
    message = refusal(file)
    assert name in message
    assert "row 7" in message


def test_data_that_contradict_the_header_are_not_written() -> None:
    with pytest.raises(ValueError, match="actions"):
        encode(HEADER, replace(some_data(), actions=np.zeros((ROWS, 3), np.float32)), EPISODES)
    with pytest.raises(ValueError, match="not finite"):
        encode(HEADER, replace(some_data(), rewards=np.full(ROWS, np.nan, np.float32)), EPISODES)
