"""What a learner makes of its data: which it refuses, and that they are its own alone."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from otc_dist.datasets import store
from otc_dist.datasets.names import DatasetName
from otc_dist.datasets.writing import Provenance, locked, publish
from otc_dist.description import EmbeddingSection
from otc_dist.envs import registry
from otc_dist.learner.learner import Learner, Progress
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

from ..brains import (
    ARMS,
    SPEC,
    brain,
    describe,
    online,
    pretrained,
    silent,
    transitions,
    unsaved,
)

pytestmark = pytest.mark.usefixtures("small_blocks")


@pytest.mark.parametrize("name", ["observations", "actions", "rewards", "next_observations"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_data_that_are_not_finite_are_refused(name: str, value: float) -> None:
    bad = transitions(0, 200)
    getattr(bad, name)[(17, *[0] * (getattr(bad, name).ndim - 1))] = value
    with pytest.raises(ValueError, match="not finite"):
        brain(data=bad)
    learner = pretrained(*ARMS["uniform"])
    before = learner.policy_digest()
    with pytest.raises(ValueError, match="not finite"):
        learner.tune(1, bad[:40], silent)
    assert (learner.tuned, learner.policy_digest()) == (0, before)
    learner.tune(1, online(1), silent)  # nothing of it was merged: there is room


def test_nobody_learns_from_a_step_that_did_not_happen() -> None:
    data, (first, second) = online(1), (pretrained(), pretrained())
    broken = np.isin(np.arange(len(data)), (0, 7, 8))
    both = {"terminated": data.terminated | broken, "truncated": data.truncated | broken}
    first.tune(1, replace(data, rewards=np.where(broken, 1e6, data.rewards), **both), silent)
    stands_in = np.arange(len(data))
    stands_in[[0, 7, 8]] = 1, 6, 6
    second.tune(1, data[stands_in], silent)
    assert first.policy_digest() == second.policy_digest()


def rewritten(folder: Path, level: str, change: Callable[[int, Transitions], Transitions]) -> str:
    """The name of a copy of a small random data set in which each agent's data are `change`d."""
    store.ensure("hopper-3x1/random", 400)
    joint = store.load_joint("hopper-3x1/random", 400)
    agents = [change(i, joint.of_agent(i)) for i in range(3)]
    changed = replace(
        joint,
        actions=tuple(agent.actions for agent in agents),
        rewards=tuple(agent.rewards for agent in agents),
    )
    name = DatasetName("hopper-3x1", level)
    with locked(name):
        publish(name, changed, Provenance("a test", {}, {}, np.zeros(1), 0))
    return str(name.folder.relative_to(name.folder.parents[1]))


def test_offline_policy_depends_on_the_agents_own_data_alone(tmp_path: Path) -> None:
    """Through the files: agent_2's data differ, agent_0's policy is the same to the bit."""

    def disturb(index: int, data: Transitions) -> Transitions:
        if index != 2:
            return data
        return replace(data, actions=-0.5 * data.actions, rewards=data.rewards + 1)

    names = [
        rewritten(tmp_path, "asis", lambda index, data: data),
        rewritten(tmp_path, "disturbed", disturb),
    ]
    team = registry.team_spec("hopper-3x1")
    digests: list[dict[str, str]] = []
    for name in names:
        digests.append({})
        for spec in team.agents:
            data = store.load_agent(store.agent_file(name, spec.name, 400), spec.name)
            digests[-1][spec.name] = pretrained(
                *ARMS["otc-embedding"], spec=spec, data=data
            ).policy_digest()
    asis, disturbed = digests
    assert disturbed["agent_0"] == asis["agent_0"]
    assert disturbed["agent_1"] == asis["agent_1"]
    assert disturbed["agent_2"] != asis["agent_2"]


def test_data_of_another_size_are_refused() -> None:
    narrow = AgentSpec("agent_0", 5, (-1.0,), (1.0,))
    with pytest.raises(ValueError):
        brain(data=transitions(0, 200, narrow))
    shallow = AgentSpec("agent_0", 1, SPEC.action_low, SPEC.action_high)
    with pytest.raises(ValueError, match="sizes"):  # numpy would stretch it
        brain(data=transitions(0, 200, shallow))


@pytest.mark.slow
@pytest.mark.parametrize("env", ["hopper-3x1", "walker2d-2x3"])
def test_embedding_of_real_data_keeps_more_than_three_dimensions(env: str) -> None:
    """With the shipped weight of KL; a third of the shipped updates, few transitions."""
    name = f"{env}/medium-replay"
    store.ensure(name, 20_000)
    spec = registry.team_spec(env).agents[0]
    data = store.load_agent(store.agent_file(name, spec.name, 20_000), spec.name)
    small = describe(*ARMS["otc-embedding"], "offline.updates=0")
    usual = small.model_copy(update={"embedding": EmbeddingSection(updates=3000)})
    reports: list[Progress] = []
    Learner(usual, spec, data).pretrain(reports.append, unsaved)
    assert reports[-1].metrics["active_dimensions"] > 3
    assert reports[-1].metrics["embedding_loss"] < 0.1  # and it reconstructs actions
