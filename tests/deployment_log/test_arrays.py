"""`read_log` gives what the log holds, row by row, and says what it lacks."""

import sys
from pathlib import Path

import numpy as np
import pytest

from otc_dist import UserError, read_log
from otc_dist.deployment_log.finishing import write_finished
from otc_dist.deployment_log.format import partial_path
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.salvage import Salvage

from .conftest import Recording, bits


def test_every_row_is_that_of_its_step_and_copy(tmp_path: Path, small: Recording) -> None:
    log = read_log(str(small.finish(tmp_path / "log.mcap")))
    assert len(log) == 24 and log.header == small.header
    assert list(zip(log.steps.tolist(), log.copies.tolist(), strict=True)) == [
        (step, copy) for step in range(12) for copy in range(2)
    ]
    for row, (step, copy) in enumerate(zip(log.steps, log.copies, strict=True)):
        logged = small.steps[step]
        for i, (name, own) in enumerate(log.agents.items()):
            for field in ("observations", "actions", "rewards", "next_observations"):
                assert bits(getattr(own, field)[row]) == bits(getattr(logged, field)[i][copy])
            assert own.terminated[row] == logged.terminated[copy]
            assert own.truncated[row] == logged.truncated[copy]
            assert log.exploring[name][row] == logged.exploring[i]
        episode = log.episode_table[log.episodes[row]]
        assert (episode.copy, episode.seed) == (copy, logged.episode_seeds[copy])
        assert log.episode_starts[row] == (episode.start == step)
    assert log.policies == {name: f"digest of {name}" for name in small.team.names}


def test_a_part_says_so(tmp_path: Path, small: Recording) -> None:
    small.write(tmp_path / "log.mcap", 5).close()
    log = read_log(tmp_path / "log.mcap")
    assert len(log) == 10 and log.partial == "unfinished: 5 steps, of how many is not known"
    assert log.policies == {}
    small.write(tmp_path / "none.mcap", 0).close()
    none = read_log(tmp_path / "none.mcap")
    assert len(none) == 0 and none.agents["agent_1"].actions.shape == (0, 2)
    assert none.episode_table == [] and none.to_pandas().shape[0] == 0


def test_pandas_has_a_row_for_each_agent(tmp_path: Path, small: Recording) -> None:
    log = read_log(small.finish(tmp_path / "log.mcap"))
    frame = log.to_pandas()
    assert frame.shape[0] == 48
    own = frame[frame.agent == "agent_1"].dropna(axis=1, how="all")
    for field, column in (("observations", "observation"), ("actions", "action")):
        names = [name for name in own if name.startswith(f"{column}_")]
        values = own[names].to_numpy(np.float32)
        np.testing.assert_array_equal(values, getattr(log.agents["agent_1"], field))
    returns = own.groupby("episode").reward.sum()
    expected = [episode.returns[1] for episode in log.episode_table]
    np.testing.assert_allclose(returns, expected, rtol=1e-5, atol=1e-5)
    assert own.episode_start.sum() == len(log.episode_table)


def test_without_pandas_one_line_says_what_to_install(
    tmp_path: Path, small: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = read_log(small.finish(tmp_path / "log.mcap"))
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(UserError, match=r"^to_pandas needs more packages: [^\n]*pip install"):
        log.to_pandas()


def test_what_is_no_whole_log_is_one_line(tmp_path: Path, small: Recording) -> None:
    small.write(tmp_path / "log.mcap").close()
    path = partial_path(tmp_path / "log.mcap")
    data = bytearray(path.read_bytes())
    data[-50] ^= 1  # within the last step
    path.write_bytes(data)
    for wrong in (path, tmp_path, tmp_path / "absent.mcap"):
        with pytest.raises(UserError) as caught:
            read_log(wrong)
        assert str(wrong) in str(caught.value) and "\n" not in str(caught.value)


def test_episodes_end_at_gaps(tmp_path: Path, small: Recording) -> None:
    """The first row after a gap begins what is left of its episode."""
    small.write(tmp_path / "damaged.mcap").close()
    damaged, path = partial_path(tmp_path / "damaged.mcap"), tmp_path / "log.mcap"
    with OpenLog(damaged) as log:
        first, size = log.first, log.layout.size
    data = bytearray(damaged.read_bytes())
    for step in (0, 4, 5):
        data[first + step * size + size // 2] ^= 1
    damaged.write_bytes(data)
    with Salvage(damaged) as whole:
        write_finished(path, whole.header, whole.blocks, whole.policies())
    found = read_log(path)
    assert found.partial is not None
    assert sorted(set(found.steps.tolist())) == [1, 2, 3, *range(6, 12)]
    for step in (1, 6):
        assert found.episode_starts[found.steps == step].all()
    for row in range(len(found)):
        episode = found.episode_table[found.episodes[row]]
        assert episode.start <= found.steps[row] < episode.start + episode.length
