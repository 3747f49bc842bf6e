import subprocess
import sys

import numpy as np
import pytest

from otc_dist.envs import registry
from otc_dist.terminal.errors import UserError


def test_every_environment_is_made_as_its_spec_says():
    for env_id in registry.env_ids():
        spec, env = registry.team_spec(env_id), registry.make(env_id, 2)
        assert env.spec == spec
        assert env.copies == 2
        env.reset(np.arange(2), np.arange(2))
        sizes = [observation.shape[1] for observation in env.observe()]
        assert sizes == [agent.observation_size for agent in spec.agents]
        env.close()


def test_paper_partitions():
    sizes = {
        env_id: [agent.action_size for agent in registry.team_spec(env_id).agents]
        for env_id in ("hopper-3x1", "halfcheetah-2x3", "walker2d-2x3")
    }
    assert sizes == {
        "hopper-3x1": [1, 1, 1],
        "halfcheetah-2x3": [3, 3],
        "walker2d-2x3": [3, 3],
    }


def test_unknown_environment_is_answered_with_the_nearest():
    for ask in (registry.team_spec, lambda name: registry.make(name, 1)):
        with pytest.raises(UserError, match="did you mean 'hopper-3x1'"):
            ask("hoper-3x1")


def test_normalised_score_is_0_for_random_and_100_for_expert():
    assert registry.normalised_score("hopper-3x1", -20.272305) == pytest.approx(0.0)
    assert registry.normalised_score("hopper-1x3", 3234.3) == pytest.approx(100.0)
    assert registry.normalised_score("halfcheetah-2x3", 4770.0) == pytest.approx(40.7, abs=0.05)
    assert registry.normalised_score("walker2d-2x3", 2852.0) == pytest.approx(62.1, abs=0.05)


def test_environments_and_generation_need_no_torch_and_specs_no_simulator():
    code = (
        "import sys\n"
        "from otc_dist.envs import registry\n"
        "registry.team_spec('hopper-3x1')\n"
        "assert 'mujoco' not in sys.modules\n"
        "import otc_dist.datasets.generate, otc_dist.envs.rollout, otc_dist.envs.parallel\n"
        "assert 'torch' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


@pytest.mark.parametrize("env_id", ["predator-prey-10000", f"cooperative-navigation-{10**30}"])
def test_a_number_of_agents_that_no_team_has_is_unknown(env_id: str) -> None:
    assert not registry.known(env_id)
    with pytest.raises(UserError, match="unknown environment"):
        registry.team_spec(env_id)
