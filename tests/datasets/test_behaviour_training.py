import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from otc_dist.datasets.behaviour import policy_of
from otc_dist.datasets.behaviour_training import training
from otc_dist.datasets.behaviour_training.__main__ import main
from otc_dist.datasets.behaviour_training.ppo import RunningMoments, Settings, Trainer
from otc_dist.envs import registry

SMALL = Settings(copies=3, horizon=8, epochs=2, minibatch=12)


def _trainer(seed=0, env_id="hopper-1x3"):
    return Trainer(env_id, registry.make(env_id, SMALL.copies), seed, SMALL)


def _trained(seed):
    trainer = _trainer(seed)
    for _ in range(3):
        trainer.update(trainer.collect())
    return trainer


def test_training_is_a_function_of_the_seed():
    first, second, other = (_trained(seed).snapshot() for seed in (1, 1, 2))
    for name, values in first.items():
        np.testing.assert_array_equal(values, second[name], strict=True)
    assert not np.array_equal(first["layer_2.weight"], other["layer_2.weight"])


def test_numpy_policy_acts_as_the_trained_network():
    trainer = _trained(0)
    policy = policy_of(trainer.snapshot())
    observations = trainer.env.observe()[0]
    with torch.no_grad():
        means = trainer.model.actor(trainer._normalised(observations, learn=False)).numpy()
    noise = np.ones_like(means)
    expected = np.clip(means + np.exp(trainer.model.log_std.detach().numpy()) * noise, -1, 1)
    np.testing.assert_allclose(policy.act(observations, noise), expected, atol=1e-5)


def test_discrete_actions_are_sampled_from_the_softmax_over_what_is_available():
    trainer = _trainer(env_id="5m_vs_6m")
    trainer.update(trainer.collect())
    policy = policy_of(trainer.snapshot())
    observation = trainer.env.observe()[0][:1]
    rows = np.repeat(observation, 20_000, axis=0)
    actions = policy.act(rows, policy.noise(np.random.default_rng(0), len(rows)))[:, 0]
    with torch.no_grad():
        logits = trainer.model.actor(torch.from_numpy(observation))[0].numpy()
    expected = np.where(observation[0, -12:] > 0, np.exp(logits), 0)
    shares = np.bincount(actions.astype(int), minlength=12) / len(rows)
    np.testing.assert_allclose(shares, expected / expected.sum(), atol=0.015)
    np.testing.assert_array_equal(shares[observation[0, -12:] == 0], 0)


def test_agents_that_share_a_network_are_so_many_more_copies():
    trainer = _trainer(env_id="5m_vs_6m")
    batch = trainer.collect()
    assert batch.observations.shape == (SMALL.horizon, 5 * SMALL.copies, 67)
    # All get the team's reward, and their episodes end together.
    rewards = batch.rewards.reshape(SMALL.horizon, 5, SMALL.copies)
    assert (rewards == rewards[:, :1]).all()
    assert trainer.steps == SMALL.horizon * SMALL.copies


def test_running_moments_are_those_of_all_rows():
    rows = np.random.default_rng(0).normal(3.0, 2.0, (100, 4))
    moments = RunningMoments(4)
    for part in np.split(rows, [1, 40, 70]):
        moments.update(part)
    np.testing.assert_allclose(moments.mean, rows.mean(axis=0), rtol=1e-4)
    np.testing.assert_allclose(moments.variance, rows.var(axis=0), rtol=1e-3)


def test_advantages_stop_at_an_episodes_end():
    trainer = _trainer()
    batch = trainer.collect()
    advantages = trainer._advantages(batch)
    batch.ends[4] = 1.0
    batch.rewards[5:] = 100.0
    changed = trainer._advantages(batch)
    # An end in step 4 hides all that comes after it from the steps up to it.
    batch.rewards[5:] = -100.0
    np.testing.assert_array_equal(changed[:5], trainer._advantages(batch)[:5])
    assert not np.array_equal(changed[5:], advantages[5:])


def test_the_command_writes_snapshots_and_their_card(tmp_path, monkeypatch, capsys):
    task = replace(
        training.TASKS["hopper"],
        settings=SMALL,
        maximum_steps=3 * 24,
        evaluation_episodes=2,
    )
    monkeypatch.setitem(training.TASKS, "hopper", task)
    assert main(["hopper", "--seed", "3", "--out", str(tmp_path)]) == 0
    card = json.loads((tmp_path / "hopper" / "card.json").read_text())
    files = sorted(path.name for path in (tmp_path / "hopper").glob("*.safetensors"))
    assert files == [row["file"] for row in card["snapshots"]]
    assert card["medium"] == files[-1]
    assert card["seed"] == 3
    assert "hopper" in capsys.readouterr().out


def test_help_names_the_tasks(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "5m_vs_6m,halfcheetah" in capsys.readouterr().out
