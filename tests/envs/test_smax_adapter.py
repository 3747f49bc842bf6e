"""SMAX through our interface; all but the first where JaxMARL is installed."""

import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest

from otc_dist.envs import registry
from otc_dist.envs.rollout import Rollout
from otc_dist.system.extras import install
from otc_dist.terminal.errors import UserError

SMAX = "smax/5m_vs_6m"
installed = pytest.mark.skipif(find_spec("jaxmarl") is None, reason="JaxMARL is not installed")


@pytest.mark.parametrize("argv", [f"env {SMAX}", f"data {SMAX}/random"])
def test_without_the_package_one_line_says_what_to_install(argv):
    code = (
        "import sys\n"
        "sys.modules['jaxmarl'] = None\n"
        "from otc_dist.datasets import store\n"
        "from otc_dist.envs import registry\n"
        "from otc_dist.terminal.errors import run_main\n"
        "ask = {'env': registry.team_spec, 'data': store.ensure}\n"
        "run_main(lambda argv: ask[argv[0]](argv[1]) and 0)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code, *argv.split()],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.startswith("error: ")
    assert "needs JaxMARL" in ended.stderr and install("smax") in ended.stderr
    assert ended.stderr.count("\n") == 1


def _random(observations, random):
    actions = []
    for seen in observations:
        keys = random.random((len(seen), 11)) * (seen[:, -11:] > 0)
        actions.append(keys.argmax(axis=1).astype(np.float32)[:, None])
    return actions


@installed
@pytest.mark.slow
def test_battles_are_played_and_repeated_from_their_states():
    spec = registry.team_spec(SMAX)
    assert [agent.observation_size for agent in spec.agents] == [140 + 11] * 5
    assert spec.max_episode_steps == 100
    env, random = registry.make(SMAX, 3), np.random.default_rng(0)
    rollout, steps = Rollout(env, 0, "deployment", 1), []
    for _ in range(40):
        steps.append(rollout.advance(_random(rollout.observations, random), (False,) * 5))
    assert len(rollout.episodes) >= 3
    assert rollout.successes is not None
    other = registry.make(SMAX, 3)
    for step in steps:
        other.set_state(step.state)
        outcome = other.step(step.actions)
        np.testing.assert_array_equal(outcome.rewards[0], step.rewards[0])
        np.testing.assert_array_equal(outcome.terminated, step.terminated)
        for ours, theirs in zip(other.observe(), step.next_observations, strict=True):
            np.testing.assert_array_equal(ours, theirs)
    with pytest.raises(ValueError, match="cannot take action"):
        other.step([np.full((3, 1), 11, np.float32)] * 5)


@installed
def test_an_unknown_map_is_one_line():
    with pytest.raises(UserError, match="unknown SMAX map '5m_vs_7m'; did you mean '5m_vs_6m'"):
        registry.team_spec("smax/5m_vs_7m")
