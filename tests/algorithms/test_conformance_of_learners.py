"""What a learner keeps to, whatever its algorithm: one test for all of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from otc_dist.algorithms.interface import Improving
from otc_dist.datasets import store
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.names import DatasetName
from otc_dist.datasets.writing import Provenance, locked, publish
from otc_dist.envs import registry
from otc_dist.learner import checkpoint
from otc_dist.learner.learner import Learner
from otc_dist.terminal.errors import UserError

from ..brains import ONLINE, SPEC, silent, unsaved
from .every import (
    CHOICES,
    CHOOSING,
    DISCRETE,
    EACH,
    OFFLINE_UPDATES,
    SECTIONS,
    TUNING_UPDATES,
    brain,
    data_for,
    describe,
    online,
    pretrained,
    spec_for,
)


@EACH
def test_the_same_seed_gives_the_same_bytes(name: str) -> None:
    digests = []
    for seed in (0, 0, 1):
        learner = pretrained(name, f"seed={seed}")
        learner.tune(1, online(name, 1), silent)
        digests.append(learner.policy_digest())
    assert digests[0] == digests[1] != digests[2]


@EACH
def test_with_an_earlier_policy_goes_back_all_but_what_is_known_of_the_data(
    name: str, tmp_path: Path
) -> None:
    learner = pretrained(name, "sampling.name=balanced")
    learner.tune(1, online(name, 1), silent)
    earlier = learner.policy[1]
    learner.save(tmp_path / "pi_1")
    learner.tune(2, online(name, 2), silent)
    algorithm, newest = learner.policy
    learner.revert(tmp_path / "pi_1")
    back, stays = learner.policy[1], {key for key in newest if key.startswith("sampler_")}
    assert stays and learner.tuned == 2
    if isinstance(algorithm, Improving):
        stays |= newest.keys() - set(algorithm.policy_keys)
    assert back.keys() == newest.keys()
    for key, value in back.items():
        assert torch.equal(value, (newest if key in stays else earlier)[key]), key
    changed = {key for key in newest.keys() - stays if not torch.equal(newest[key], earlier[key])}
    assert changed  # or nothing was tested


@EACH
def test_a_checkpoint_restores_to_equal_updates(name: str, tmp_path: Path) -> None:
    """Everything that goes on is in it: weights, targets, moments, counts and statistics."""
    learner = pretrained(name)
    saved = []
    for k in range(3):
        if k:
            learner.tune(k, online(name, k), silent)
        learner.save(tmp_path / str(k))
        saved.append((tmp_path / str(k)).read_bytes())
    for k in (0, 1):
        resumed = brain(name)
        resumed.load(tmp_path / str(k))
        resumed.restore([online(name, j) for j in range(1, k + 1)])
        resumed.tune(k + 1, online(name, k + 1), silent)
        resumed.save(tmp_path / "resumed")
        assert (tmp_path / "resumed").read_bytes() == saved[k + 1]


@EACH
def test_optimizers_and_targets_outlive_deployments(name: str, tmp_path: Path) -> None:
    learner = pretrained(name)
    learner.tune(1, online(name, 1), silent)
    learner.save(tmp_path / "tuned")
    state = checkpoint.parts(checkpoint.read(tmp_path / "tuned")[0])["algorithm"]
    assert state["updates"] == OFFLINE_UPDATES + TUNING_UPDATES
    moments = [key for key in state if key.endswith("_moments")]
    assert moments
    for key in moments:
        network = key.removesuffix("_moments")
        assert state[key].shape == (2, *state[network].shape)
        assert np.abs(state[key]).max() > 0, key
    for key in (key for key in state if key.endswith("_target")):
        assert not np.array_equal(state[key], state[key.removesuffix("_target")]), key


@EACH
def test_checkpoints_of_others_are_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / "mine"
    pretrained(name).save(path)
    spec = spec_for(name)
    others = [brain(other) for other in SECTIONS if other != name and spec_for(other) is spec]
    others += [brain(name, change) for change in ("algorithm.discount=0.9", "seed=1")]
    for other in others:
        with pytest.raises(UserError, match=r"^[^\n]*made by another description[^\n]*$"):
            other.load(path)
    colleague = brain(name, spec=replace(spec, name="agent_1"))
    with pytest.raises(UserError, match=r"^[^\n]*is agent_0's, not agent_1's$"):
        colleague.load(path)


@EACH
def test_data_that_are_not_finite_are_refused(name: str) -> None:
    """Any field's, offline and online; nothing of them is merged."""
    learner = pretrained(name)
    digest = learner.policy_digest()
    for field in ("observations", "actions", "rewards", "next_observations"):
        bad = data_for(spec_for(name), 0, 200)
        getattr(bad, field)[17] = np.nan
        with pytest.raises(ValueError, match="not finite"):
            brain(name, data=bad)
        with pytest.raises(ValueError, match="not finite"):
            learner.tune(1, bad[:ONLINE], silent)
    assert (learner.tuned, learner.policy_digest()) == (0, digest)
    learner.tune(1, online(name, 1), silent)


@EACH
def test_the_wrong_kind_of_actions_is_refused(name: str) -> None:
    other = SPEC if SECTIONS[name].discrete else CHOOSING
    with pytest.raises(UserError, match=rf"^algorithm.name = '{name}' does not fit [^\n]*$"):
        brain(name, spec=other)


@EACH
def test_d_q_needs_a_q(name: str) -> None:
    if SECTIONS[name].has_q:
        learner = pretrained(name, "sampling.distance=value", "sampling.acceptance=rank")
        learner.tune(1, online(name, 1), silent)
        assert np.isfinite(learner.alpha.similarity)
    else:
        with pytest.raises(UserError, match=r"^[^\n]*needs a Q, and [^\n]* has none[^\n]*$"):
            describe(name, "sampling.distance=value")


@pytest.mark.parametrize("name", DISCRETE)
def test_a_mask_that_offers_nothing_is_refused(name: str) -> None:
    learner = pretrained(name)
    observations = data_for(CHOOSING, 3, 5).observations
    observations[2, -CHOICES:] = 0
    with pytest.raises(UserError, match=r"^[^\n]*has no available action[^\n]*$"):
        learner.act(observations, "deployment", 1, 0)
    bad = data_for(CHOOSING, 4, ONLINE)
    bad.observations[3, -CHOICES:] = 0
    with pytest.raises(ValueError, match="available"):
        learner.tune(1, bad, silent)
    with pytest.raises(ValueError, match="available"):
        brain(name, data=bad)


def published(env_id: str, level: str, seeds: list[int]) -> str:
    """The name of a made-up data set in which the agents' data depend on their own seeds alone."""
    agents = registry.team_spec(env_id).agents
    own = [data_for(spec, seed, 200) for spec, seed in zip(agents, seeds, strict=True)]
    joint = JointTransitions(
        observations=tuple(data.observations for data in own),
        actions=tuple(data.actions for data in own),
        rewards=tuple(data.rewards for data in own),
        next_observations=tuple(data.next_observations for data in own),
        terminated=np.zeros(200, np.bool_),
        truncated=np.zeros(200, np.bool_),
        episodes=np.zeros(200, np.int64),
    )
    name = DatasetName(env_id, level)
    with locked(name):
        publish(name, joint, Provenance("a test", {}, {}, np.zeros(1), 0))
    return f"{env_id}/{level}"


@EACH
def test_an_agent_learns_from_its_own_data_alone(name: str) -> None:
    """Through the files: another agent's data differ, this one's policy does not, to the bit."""
    env_id = "5m_vs_6m" if SECTIONS[name].discrete else "hopper-3x1"
    team = registry.team_spec(env_id)
    seeds = list(range(len(team.agents)))
    original = published(env_id, "original", seeds)
    other = published(env_id, "other", [0, 99, *seeds[2:]])
    digests: list[list[str]] = []
    for dataset in (original, other):
        digests.append([])
        for spec in team.agents[:2]:
            data = store.load_agent(store.agent_file(dataset, spec.name, 200), spec.name)
            learner = Learner(describe(name, env=env_id), spec, data, registry.task(env_id))
            learner.pretrain(silent, unsaved)
            digests[-1].append(learner.policy_digest())
    assert digests[0][0] == digests[1][0]
    assert digests[0][1] != digests[1][1]


@EACH
def test_what_an_update_costs_is_known_to_the_forecast(name: str) -> None:
    section = SECTIONS[name]
    assert "update" in vars(section), (
        f"{section.__name__} has no `update` of its own, in ms: python benchmarks/algorithms.py"
    )
    assert section.update > 0
