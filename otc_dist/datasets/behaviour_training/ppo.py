"""PPO for one team (Schulman et al. 2017), which trains the behaviour policies.

With the implementation details of CleanRL's `ppo_continuous_action`: observation normalisation,
reward scaling by the running deviation of the discounted return, generalised advantage
estimation, clipped value loss, orthogonal initialisation. An episode that a time limit ended is
bootstrapped from the value of its last state.

Several agents share one network, each acts on its own observation (independent PPO with shared
parameters, de Witt et al. 2020), and their experience is that of so many more copies.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from otc_dist.algorithms.bremen.advantages import generalised_advantages
from otc_dist.datasets.behaviour import OBSERVATION_CLIP
from otc_dist.datasets.behaviour_training.ppo_models import Tensors, actor_critic
from otc_dist.envs.base import BatchedEnv, Contest
from otc_dist.randomness import derive_seed
from otc_dist.transitions import Float32, Float64


@dataclass(frozen=True)
class Settings:
    """CleanRL's defaults, but for a constant learning rate, 16 environments and minibatches."""

    copies: int = 16
    horizon: int = 128  # steps of each copy per iteration: 2048 in all
    epochs: int = 10
    minibatch: int = 128
    learning_rate: float = 3e-4
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip: float = 0.2
    value_weight: float = 0.5
    entropy_weight: float = 0.0
    gradient_norm: float = 0.5
    initial_std: float = 1.0  # of continuous actions, whose bounds are -1 and 1


class RunningMoments:
    """Mean and variance of all rows seen so far (Chan et al. 1979, parallel update)."""

    def __init__(self, size: int) -> None:
        self.mean: Float64 = np.zeros(size)
        self.variance: Float64 = np.ones(size)
        self.count = 1e-4

    def update(self, rows: Float64) -> None:
        """Take in rows (n, size)."""
        mean, variance, count = rows.mean(axis=0), rows.var(axis=0), len(rows)
        delta, total = mean - self.mean, self.count + count
        self.mean = self.mean + delta * count / total
        within = self.variance * self.count + variance * count
        self.variance = (within + delta**2 * self.count * count / total) / total
        self.count = total


@dataclass(frozen=True)
class Batch:
    """One iteration's experience, (horizon, agents x copies, ...)."""

    observations: Tensor  # normalised if actions are continuous
    actions: Tensor  # not clipped
    log_probabilities: Tensor
    values: Tensor
    rewards: Tensor  # scaled; at a truncation with the discounted value of s' added
    ends: Tensor  # 1 where an episode ended after the step
    last_value: Tensor  # (agents x copies,)


class Trainer:
    """PPO on one task, with its environments and its running statistics.

    Args:
        name: of the task, for the keys of random numbers.
        env: `settings.copies` copies of it. Its agents are alike.
    """

    def __init__(self, name: str, env: BatchedEnv, seed: int, settings: Settings) -> None:
        torch.manual_seed(derive_seed(seed, name, "behaviour_training"))
        self.name, self.env, self.seed, self.settings = name, env, seed, settings
        agent = env.spec.agents[0]
        self.model = actor_critic(agent, settings.initial_std)
        self.optimizer = torch.optim.Adam(
            self.model.parameters(), lr=settings.learning_rate, eps=1e-5
        )
        self._agents = len(env.spec.agents)
        self._normalises = not agent.choices  # masks must stay as they are
        self.observation_moments = RunningMoments(agent.observation_size)
        self.return_moments = RunningMoments(1)
        self.steps = 0
        self.episode_returns: list[float] = []  # true returns of finished episodes
        self.successes: list[bool] = []  # which of them were won, where the task has such a thing
        self._running_returns = np.zeros(settings.copies)
        self._discounted = np.zeros(settings.copies)
        self._episodes = 0
        self._reset(np.arange(settings.copies))
        self._observation = self._observe(learn=True)

    def _reset(self, which: NDArray[np.int64]) -> None:
        episodes = range(self._episodes, self._episodes + len(which))
        seeds = [derive_seed(self.seed, self.name, "training", episode) for episode in episodes]
        self._episodes += len(which)
        self.env.reset(which, np.array(seeds, np.int64))

    def _observe(self, *, learn: bool) -> Tensor:
        """What all agents see, (agents x copies, O)."""
        return self._normalised(np.concatenate(self.env.observe()), learn=learn)

    def _normalised(self, observation: Float32, *, learn: bool) -> Tensor:
        if not self._normalises:
            return torch.from_numpy(observation)
        if learn:
            self.observation_moments.update(observation.astype(np.float64))
        moments = self.observation_moments
        z = (observation - moments.mean) / np.sqrt(moments.variance + 1e-8)
        return torch.from_numpy(np.clip(z, -OBSERVATION_CLIP, OBSERVATION_CLIP).astype(np.float32))

    @torch.no_grad()
    def collect(self) -> Batch:
        """Play `horizon` steps in every copy."""
        settings, model = self.settings, self.model
        columns: list[tuple[Tensor, ...]] = []
        for _ in range(settings.horizon):
            observation = self._observation
            action, log_probability = model.sample(observation)
            value = model.value(observation)
            outcome = self.env.step(np.split(action.numpy(), self._agents))
            reward, ended = np.stack(outcome.rewards), outcome.terminated | outcome.truncated
            team = reward.mean(axis=0)

            self._running_returns += team
            self._discounted = self._discounted * settings.gamma + team
            self.return_moments.update(self._discounted[:, None])
            deviation = np.sqrt(self.return_moments.variance[0] + 1e-8)
            scaled = np.clip(reward / deviation, -10, 10).astype(np.float32)
            if outcome.truncated.any():  # a time limit is not the task's end: bootstrap
                bootstrap = settings.gamma * model.value(self._observe(learn=False)).numpy()
                scaled += bootstrap.reshape(scaled.shape) * outcome.truncated
            if ended.any():
                self._finish(np.flatnonzero(ended))
            columns.append(
                (
                    observation,
                    action,
                    log_probability,
                    value,
                    torch.from_numpy(scaled.ravel()),
                    torch.from_numpy(np.tile(ended.astype(np.float32), self._agents)),
                )
            )
            self._observation = self._observe(learn=True)
        self.steps += settings.horizon * settings.copies
        observations, actions, log_probabilities, values, rewards, ends = (
            torch.stack(column) for column in zip(*columns, strict=True)
        )
        last_value = model.value(self._observation)
        return Batch(observations, actions, log_probabilities, values, rewards, ends, last_value)

    def _finish(self, which: NDArray[np.int64]) -> None:
        """Note the episodes that ended in the copies `which`, and start others."""
        self.episode_returns += self._running_returns[which].tolist()
        if isinstance(self.env, Contest):
            self.successes += self.env.success[which].tolist()
        self._running_returns[which] = 0.0
        self._discounted[which] = 0.0
        self._reset(which)

    def level(self) -> float:
        """Percent of the last episodes that were won; where there is no such thing, their return.

        Over as many episodes as there are copies, but at least 500 of won or lost ones.
        """
        copies = self.settings.copies
        if self.successes:
            return 100.0 * float(np.mean(self.successes[-max(copies, 500) :]))
        return float(np.mean(self.episode_returns[-copies:] or [0.0]))

    def _advantages(self, batch: Batch) -> Tensor:
        """Generalised advantage estimates, (horizon, copies)."""
        settings, values = self.settings, torch.cat((batch.values, batch.last_value[None]))
        return generalised_advantages(
            batch.rewards, batch.ends, values, settings.gamma, settings.gae_lambda
        )

    def update(self, batch: Batch) -> None:
        """Several epochs of clipped policy and value updates on one batch."""
        settings, model = self.settings, self.model
        advantages = self._advantages(batch)
        returns = (advantages + batch.values).flatten()
        observations, actions = batch.observations.flatten(0, 1), batch.actions.flatten(0, 1)
        old_log, old_values = batch.log_probabilities.flatten(), batch.values.flatten()
        advantages = advantages.flatten()
        for _ in range(settings.epochs):
            for rows in torch.split(torch.randperm(len(returns)), settings.minibatch):
                advantage = advantages[rows]
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                log_probability, entropy = model.evaluate(observations[rows], actions[rows])
                ratio = torch.exp(log_probability - old_log[rows])
                clipped = ratio.clamp(1 - settings.clip, 1 + settings.clip)
                policy_loss = -torch.min(advantage * ratio, advantage * clipped).mean()
                value, old = model.value(observations[rows]), old_values[rows]
                near = old + (value - old).clamp(-settings.clip, settings.clip)
                target = returns[rows]
                errors = torch.max((value - target) ** 2, (near - target) ** 2)
                loss = policy_loss + settings.value_weight * 0.5 * errors.mean()
                loss = loss - settings.entropy_weight * entropy
                self.optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                nn.utils.clip_grad_norm_(model.parameters(), settings.gradient_norm)
                self.optimizer.step()

    def snapshot(self) -> Tensors:
        """The policy as it is now."""
        moments = self.observation_moments
        mean, variance = moments.mean, moments.variance + 1e-8
        if not self._normalises:
            mean, variance = np.zeros_like(mean), np.ones_like(variance)
        return {
            "observation_mean": mean.astype(np.float32),
            "observation_std": np.sqrt(variance).astype(np.float32),
            **self.model.snapshot(),
        }
