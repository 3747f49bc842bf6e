"""Bringing a simulator to where a log ends: to the bit; on another kind of processor, by states."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.envs import registry
from otc_dist.envs.rollout import Rollout
from otc_dist.services.process import FailureError
from otc_dist.services.restore import resimulate
from otc_dist.transitions import Float64, JointStep

ENV, COPIES, STEPS = "predator-prey-2", 2, 30  # an episode has 25
NO = (False, False)


def rollout() -> Rollout:
    return Rollout(registry.make(ENV, COPIES), 0, "deployment", 1)


def elsewhere(state: Float64) -> Float64:
    """The same state as another kind of processor rounds it, but for the steps that it counts."""
    rounded = np.nextafter(state.astype(np.float32), np.float32(np.inf)).astype(np.float64)
    rounded[:, 0] = state[:, 0]
    return rounded


def written(path: Path, ends_differ: bool = False) -> list[JointStep]:
    """A log that another kind of processor wrote."""
    there, random, steps = rollout(), np.random.default_rng(0), []
    header = LogHeader("run", 1, 0, "", "", registry.team_spec(ENV), COPIES)
    writer = LogWriter.create(path, header)
    for number in range(STEPS):
        there.go_to(elsewhere(there._env.state()))
        actions = [random.uniform(-1, 1, (COPIES, 2)).astype(np.float32) for _ in range(2)]
        step = there.advance(actions, NO)
        if ends_differ and number == STEPS - 1:
            step = replace(step, terminated=~step.terminated)
        writer.write(step)
        steps.append(step)
    writer.close()
    return steps


def test_on_the_same_kind_every_bit_must_come_out(tmp_path: Path) -> None:
    written(tmp_path / "log.mcap")
    with pytest.raises(FailureError, match=r"step 0 does not come out as it was logged"):
        resimulate(rollout(), tmp_path / "log.mcap", STEPS, moved=False)


def test_on_another_kind_it_goes_on_from_the_logged_states(tmp_path: Path) -> None:
    steps = written(tmp_path / "log.mcap")
    here = rollout()
    last = resimulate(here, tmp_path / "log.mcap", STEPS, moved=True)
    assert last is not None and here.step == STEPS
    assert last.state.tobytes() == steps[-1].state.tobytes()  # the log's, not this machine's
    assert [episode.length for episode in here.episodes] == [25] * COPIES
    for mine, theirs in zip(here.observations, steps[-1].next_observations, strict=True):
        assert mine.tobytes() == theirs.tobytes()  # one step from the state that was logged
    here.advance(list(steps[0].actions), NO)


def test_on_another_kind_an_episode_that_ends_elsewhere_is_refused(tmp_path: Path) -> None:
    written(tmp_path / "log.mcap", ends_differ=True)
    with pytest.raises(FailureError, match=r"\(terminated differs\)"):
        resimulate(rollout(), tmp_path / "log.mcap", STEPS, moved=True)
