"""What every algorithm keeps to, whatever it learns: one test for all of them.

A new algorithm is covered as soon as the description knows its section.
"""

import numpy as np
import torch

from otc_dist.algorithms.interface import Critic, Improving

from .checks import plainly
from .every import (
    BATCH,
    CHOICES,
    EACH,
    IN_BOTH_PRECISIONS,
    SECTIONS,
    Trial,
    data_for,
    pretrained,
    spec_for,
)


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
    begun = algorithm.first_policy({**trial.state, "sampler_ratio": torch.ones(3)})
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
    for key, tensor in learner._learned.state.items():
        learner._learned.state[key] = tensor if key == "updates" else 50 * tensor
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
