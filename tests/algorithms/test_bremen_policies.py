"""How a policy gets better by BREMEN: in its models, within the radius, and by a learner."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from otc_dist.algorithms.bremen.advantages import generalised_advantages
from otc_dist.steps.noise import sample_noise

from ..brains import silent
from .arrays import first
from .bremens import Bounded, Endless, improved, make, start, taught
from .checks import BATCH, plainly
from .every import online, pretrained

OF_POLICY = {"policy", "value", "value_moments", "value_updates"}


def test_the_first_policy_is_the_clone() -> None:
    bremen = make(4, 2, (8, 8))
    state, batch = start(bremen, np.random.default_rng(3))
    for _ in range(2):
        state, _ = bremen.update(state, batch, batch, {})
    state, _ = improved(bremen, state, batch, seed=0)
    begun = bremen.first_policy(state)
    assert not torch.equal(begun["policy"], state["policy"])
    assert torch.equal(begun["policy"], state["clone_average"])
    assert not torch.equal(begun["policy"], state["clone"])
    assert {name for name in state if begun[name] is not state[name]} == {"policy"}


def test_tuning_improves_the_deployed_policy() -> None:
    """The offline policy starts from the clone; without a step tuning leaves it as it is."""
    learner = pretrained("bremen", "algorithm.improvements=0")
    offline = learner.policy[1]
    assert torch.equal(offline["policy"], offline["clone_average"])
    learner.tune(1, online("bremen", 1), silent)
    tuned = learner.policy[1]
    assert torch.equal(tuned["policy"], offline["policy"])
    assert not torch.equal(tuned["models"], offline["models"])
    assert not torch.equal(tuned["clone_average"], offline["clone_average"])


def test_going_back_to_an_earlier_policy_keeps_the_newest_models(tmp_path: Path) -> None:
    learner = pretrained("bremen", "deployment.count=3")
    earlier = learner.policy[1]
    learner.save(tmp_path / "pi_0")
    learner.tune(1, online("bremen", 1), silent)
    newest = learner.policy[1]
    learner.revert(tmp_path / "pi_0")
    names = set(newest)
    assert any(not torch.equal(newest[name], earlier[name]) for name in names - OF_POLICY)
    for name, value in learner.policy[1].items():
        assert torch.equal(value, (earlier if name in OF_POLICY else newest)[name]), name
    assert not torch.equal(newest["policy"], earlier["policy"])


def test_steps_stay_within_the_radius() -> None:
    bremen = make(4, 2, (16, 16), radius=0.02)
    state, batch = start(bremen, np.random.default_rng(4))
    names = bremen.improvement_metric_names
    for seed in range(10):
        new, metrics = improved(bremen, state, batch, seed)
        found = dict(zip(names, metrics.tolist(), strict=True))
        assert 0 < found["divergence"] <= 0.02
        assert found["gain"] > 0
        state = new


def test_improvements_raise_the_reward_in_the_models() -> None:
    bremen = make(2, 1, (16, 16), task=Endless(), horizon=20, model_learning_rate=1e-2)
    random = np.random.default_rng(5)
    state, batch = taught(bremen, random)
    state = bremen.first_policy(state)
    judged = first(sample_noise(random, bremen.improvement_noise_spec(len(batch.action)), 1))
    before = bremen.rollouts(plainly, state, batch, judged).rewards.mean()
    for seed in range(20):
        state, _ = improved(bremen, state, batch, seed)
    assert bremen.rollouts(plainly, state, batch, judged).rewards.mean() > before + 1.0


def test_where_a_rollout_ends_another_starts_from_a_state_of_the_batch() -> None:
    bremen = make(4, 2, (8, 8), horizon=20)
    state, batch = start(bremen, np.random.default_rng(6))
    noise = first(sample_noise(np.random.default_rng(0), bremen.improvement_noise_spec(BATCH), 1))
    rollouts = bremen.rollouts(plainly, state, batch, noise)
    following = torch.cat((rollouts.observations[1:], rollouts.last.unsqueeze(0)))
    ended = rollouts.ends.bool()
    assert ended.any() and not ended.all()
    starts = {tuple(s.tolist()) for s in batch.observation}
    assert torch.equal(rollouts.observations[0], batch.observation)
    assert all(tuple(s.tolist()) in starts for s in following[ended])
    assert not any(tuple(s.tolist()) in starts for s in following[~ended])
    assert not Bounded().terminated(rollouts.observations[1:][~ended[:-1]]).any()


def test_what_comes_after_an_end_counts_for_nothing_before_it() -> None:
    random = np.random.default_rng(7)
    rewards, ends = torch.from_numpy(random.standard_normal((6, 2))), torch.zeros(6, 2).double()
    values = torch.from_numpy(random.standard_normal((7, 2)))
    ends[2, 0] = 1
    found = generalised_advantages(rewards, ends, values, 0.99, 0.95)
    changed_rewards, changed_values = rewards.clone(), values.clone()
    changed_rewards[3:], changed_values[3:] = 10, 10
    other = generalised_advantages(changed_rewards, ends, changed_values, 0.99, 0.95)
    assert torch.equal(found[:3, 0], other[:3, 0])
    assert not torch.isclose(found[:3, 1], other[:3, 1]).any()
    assert found[2, 0] == rewards[2, 0] - values[2, 0]


def test_task_and_models_see_actions_within_bounds() -> None:
    class Watching(Bounded):
        largest = 0.0

        def reward(self, observation: Any, action: Any, next_observation: Any) -> Any:
            self.largest = max(self.largest, float(action.abs().max()))
            return super().reward(observation, action, next_observation)

    task = Watching()
    bremen = make(4, 2, (8, 8), task=task, std=3.0)
    state, batch = start(bremen, np.random.default_rng(8))
    improved(bremen, state, batch, seed=0)
    assert task.largest == 1.0


def test_models_learn_the_dynamics_and_differ_by_their_weights() -> None:
    bremen = make(2, 1, (16, 16), models=2, model_learning_rate=1e-2)
    state, batch = taught(bremen, np.random.default_rng(9))
    models = bremen.ensemble.network.apart(state["models_average"])
    predicted = [
        bremen.ensemble.predict(model, state, batch.observation, batch.action) for model in models
    ]
    for prediction in predicted:
        error = (prediction - batch.next_observation) / state["change_std"]
        assert (error**2).mean() < 0.01
    assert not torch.equal(predicted[0], predicted[1])


def test_diverging_models_stay_finite() -> None:
    bremen = make(4, 2, (8, 8), task=Endless(), horizon=60)
    state, batch = start(bremen, np.random.default_rng(10))
    state["models_average"] = 1e6 * state["models_average"]
    new, metrics = improved(bremen, state, batch, seed=0)
    assert metrics.isfinite().all()
    assert all(tensor.isfinite().all() for tensor in new.values())
