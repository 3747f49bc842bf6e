"""What every algorithm keeps to, whatever it learns: one test for all of them.

A new algorithm is covered as soon as the description knows its section.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from otc_dist.algorithms import create
from otc_dist.algorithms.interface import Algorithm, Batch, Critic, Improving
from otc_dist.datasets import store
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.names import DatasetName
from otc_dist.datasets.writing import Provenance, locked, publish
from otc_dist.description import Description
from otc_dist.description.kinds import ALGORITHMS
from otc_dist.envs import registry
from otc_dist.learner import checkpoint
from otc_dist.learner.learner import Learner
from otc_dist.spec import AgentSpec
from otc_dist.steps.noise import NoiseSpec, sample_noise
from otc_dist.steps.state import State
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Transitions

from ..brains import ONLINE, SMALL, SPEC, silent, transitions, unsaved
from .arrays import random_batch, random_choices
from .checks import plainly

SECTIONS: dict[str, Any] = {name: ALGORITHMS.section(name) for name in ALGORITHMS}
# Where the defaults would take time.
SMALLER: dict[str, dict[str, object]] = {
    "bcq": {"acting_candidates": 7},
    "cql": {"action_samples": 3},
    "bremen": {"models": 2, "improvements": 1, "horizon": 3},
}
CHOICES = 4
CHOOSING = AgentSpec("agent_0", 5 + CHOICES, (0.0,), (CHOICES - 1.0,), choices=CHOICES)
BATCH, OFFLINE_UPDATES, TUNING_UPDATES = 16, 8, 3

EACH = pytest.mark.parametrize("name", SECTIONS)
IN_BOTH_PRECISIONS = pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
DISCRETE = [name for name, section in SECTIONS.items() if section.discrete]


class FirstEntry:
    """A task: reach far along the first entry of the observation."""

    def reward(self, observation: Any, action: Any, next_observation: Any) -> Any:
        return next_observation[..., 0] - 0.1 * (action**2).sum(-1)

    def terminated(self, next_observation: Any) -> Any:
        return next_observation[..., 0] > 2


def describe(name: str, *assignments: str, env: str = "hopper-3x1") -> Description:
    """Small, tuned by OTC with d_e, which every algorithm can."""
    algorithm = {"name": name, "hidden": [8, 8], "batch_size": BATCH, **SMALLER.get(name, {})}
    data = {
        **SMALL,
        "env": {"id": env},
        "algorithm": algorithm,
        "embedding": {**SMALL["embedding"], "updates": 3},
        "offline": {"updates": OFFLINE_UPDATES},
        "deployment": {"count": 2, "transitions": ONLINE, "updates": TUNING_UPDATES},
    }
    return Description.build(data, assignments)


def spec_for(name: str) -> AgentSpec:
    return CHOOSING if SECTIONS[name].discrete else SPEC


def data_for(spec: AgentSpec, seed: int, count: int) -> Transitions:
    if not spec.choices:
        return transitions(seed, count, spec)
    batch = random_choices(np.random.default_rng(seed), spec.observation_size, spec.choices, count)
    s, a, r, next_s, done = (field.numpy().astype(np.float32) for field in batch)
    return Transitions(s, a, r, next_s, done > 0, np.zeros(count, np.bool_))


def brain(name: str, *assignments: str, spec: AgentSpec | None = None, **arguments: Any) -> Learner:
    spec = spec or spec_for(name)
    data = arguments.pop("data", None) or data_for(spec, 0, 200)
    return Learner(describe(name, *assignments, **arguments), spec, data, FirstEntry())


def pretrained(name: str, *assignments: str, **arguments: Any) -> Learner:
    learner = brain(name, *assignments, **arguments)
    learner.pretrain(silent, unsaved)
    return learner


def online(name: str, deployment: int) -> Transitions:
    return data_for(spec_for(name), 100 + deployment, ONLINE)


class Trial:
    """One algorithm with a state, a batch and noise, in one precision."""

    def __init__(self, name: str, dtype: torch.dtype = torch.float32) -> None:
        self.spec, self.dtype, self.name = spec_for(name), dtype, name
        self.algorithm: Algorithm = create(describe(name).algorithm, self.spec, FirstEntry())
        self.random = np.random.default_rng(0)
        self.batch = self.batch_of(BATCH)
        self.initial = self.algorithm.initial_state(self.random, self.batch_of(50, torch.float32))
        self.state = {key: self.cast(torch.from_numpy(x)) for key, x in self.initial.items()}

    def batch_of(self, size: int, dtype: torch.dtype | None = None) -> Batch:
        spec = self.spec
        make, actions = (random_choices, spec.choices) if spec.choices else (random_batch, 2)
        batch = make(self.random, spec.observation_size, actions, size)
        return Batch(*(field.to(dtype or self.dtype) for field in batch))

    def noise(self, specs: Mapping[str, NoiseSpec]) -> dict[str, Tensor]:
        """Noise for one call."""
        arrays = sample_noise(np.random.default_rng(1), specs, 1)
        return {key: torch.from_numpy(array[0]).to(self.dtype) for key, array in arrays.items()}

    def cast(self, tensor: Tensor) -> Tensor:
        return tensor.to(self.dtype) if tensor.is_floating_point() else tensor

    def update(self, state: State) -> tuple[State, Tensor]:
        noise = self.noise(self.algorithm.noise_spec(BATCH))
        return self.algorithm.update(state, self.batch, self.batch, noise)


@EACH
def test_a_fresh_state_is_in_float32(name: str) -> None:
    """But for counts of updates, which float32 could not hold for ever."""
    for key, array in Trial(name).initial.items():
        assert array.dtype == (np.float64 if key.endswith("updates") else np.float32), key
        assert np.isfinite(array).all(), key


@EACH
@IN_BOTH_PRECISIONS
def test_updates_keep_shapes_and_precision_and_report_their_metrics(
    name: str, dtype: torch.dtype
) -> None:
    trial = Trial(name, dtype)
    state = trial.state
    state["updates"] = state["updates"].double()
    for _ in range(3):
        new, metrics = trial.update(state)
        assert set(new) == set(state)
        for key, tensor in new.items():
            assert (tensor.shape, tensor.dtype) == (state[key].shape, state[key].dtype), key
            assert tensor.isfinite().all(), key
            assert not tensor.requires_grad, key
        assert (metrics.shape, metrics.dtype) == ((len(trial.algorithm.metric_names),), dtype)
        assert metrics.isfinite().all()
        assert float(new["updates"]) == float(state["updates"]) + 1
        state = new


@EACH
@IN_BOTH_PRECISIONS
def test_actions_and_values_have_one_row_a_state(name: str, dtype: torch.dtype) -> None:
    trial, count = Trial(name, dtype), 7
    algorithm, states = trial.algorithm, trial.batch.observation[:count]
    state = trial.update(trial.state)[0]
    actions = algorithm.act(state, states, trial.noise(algorithm.acting_noise_spec(count)))
    assert (actions.shape, actions.dtype) == ((count, trial.spec.action_size), dtype)
    assert isinstance(algorithm, Critic) == SECTIONS[name].has_q
    if isinstance(algorithm, Critic):
        for samples in (1, 3):
            noise = trial.noise(algorithm.value_noise_spec(count, samples))
            values = algorithm.value(state, states, noise)
            assert (values.shape, values.dtype) == ((count,), dtype)
            assert values.isfinite().all()
        q = algorithm.q(state, states, actions)
        assert (q.shape, q.dtype) == ((count,), dtype)
        # Each row is judged alone.
        torch.testing.assert_close(algorithm.q(state, states[2:3], actions[2:3]), q[2:3])


@EACH
def test_an_update_is_a_pure_function(name: str) -> None:
    """It leaves its arguments alone, gives the same bytes again, and passes on foreign keys."""
    trial = Trial(name)
    foreign = torch.ones(3)
    state = {**trial.state, "sampler_ratio": foreign}
    before = {key: tensor.clone() for key, tensor in state.items()}
    batch = [field.clone() for field in trial.batch]
    new, metrics = trial.update(state)
    assert state.keys() == before.keys()
    assert all(torch.equal(tensor, before[key]) for key, tensor in state.items())
    assert all(torch.equal(a, b) for a, b in zip(trial.batch, batch, strict=True))
    assert new["sampler_ratio"] is foreign
    again, same = trial.update(state)
    assert torch.equal(metrics, same)
    assert all(torch.equal(tensor, again[key]) for key, tensor in new.items())
    assert any(not torch.equal(tensor, state[key]) for key, tensor in new.items())


@EACH
def test_an_improvement_is_a_pure_function(name: str) -> None:
    trial = Trial(name)
    algorithm = trial.algorithm
    if not isinstance(algorithm, Improving):
        assert name != "bremen"
        return
    begun = algorithm.begin_improvement({**trial.state, "sampler_ratio": torch.ones(3)})
    before = {key: tensor.clone() for key, tensor in begun.items()}
    noise = trial.noise(algorithm.improvement_noise_spec(BATCH))
    new, metrics = algorithm.improve(plainly, begun, trial.batch, noise)
    assert metrics.shape == (len(algorithm.improvement_metric_names),)
    assert metrics.isfinite().all()
    assert all(torch.equal(tensor, before[key]) for key, tensor in begun.items())
    assert new.keys() == begun.keys()
    again, _ = algorithm.improve(plainly, begun, trial.batch, noise)
    assert all(torch.equal(tensor, again[key]) for key, tensor in new.items())


@EACH
def test_deployed_actions_are_possible(name: str) -> None:
    """Within the bounds, or the index of an available action, whatever the networks say."""
    spec = spec_for(name)
    learner = pretrained(name)
    for key, tensor in learner._state.items():
        learner._state[key] = tensor if key == "updates" else 50 * tensor
    observations = data_for(spec, 3, 64).observations
    actions = learner.act(observations, "deployment", 1, 0)
    assert (actions.shape, actions.dtype) == ((64, spec.action_size), np.float32)
    if spec.choices:
        chosen = actions[:, 0].astype(int)
        assert (chosen == actions[:, 0]).all()
        assert (observations[np.arange(64), spec.observation_size - CHOICES + chosen] == 1).all()
    else:
        assert (actions >= np.float32(spec.action_low)).all()
        assert (actions <= np.float32(spec.action_high)).all()


@EACH
def test_the_same_seed_gives_the_same_bytes(name: str) -> None:
    digests = []
    for seed in (0, 0, 1):
        learner = pretrained(name, f"seed={seed}")
        learner.tune(1, online(name, 1), silent)
        digests.append(learner.policy_digest())
    assert digests[0] == digests[1] != digests[2]


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
    assert SECTIONS[name].__dict__["update"] > 0  # its own: none is taken for another's
