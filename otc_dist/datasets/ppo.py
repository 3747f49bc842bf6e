"""PPO for one robot (Schulman et al. 2017), which trains the behaviour policies.

With the implementation details of CleanRL's `ppo_continuous_action`: observation normalisation,
reward scaling by the running deviation of the discounted return, generalised advantage
estimation, clipped value loss, orthogonal initialisation. An episode that a time limit ended is
bootstrapped from the value of its last state.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from otc_dist.datasets.behaviour import LAYERS, OBSERVATION_CLIP
from otc_dist.envs.robot_specs import single_agent_id
from otc_dist.envs.robots import RobotEnv
from otc_dist.randomness import derive_seed
from otc_dist.transitions import Float32, Float64

Tensors = dict[str, Float32]  # as `BehaviourPolicy` takes them


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
    gradient_norm: float = 0.5
    initial_std: float = 1.0  # of the actions, whose bounds are -1 and 1


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


def _network(sizes: tuple[int, ...], last_gain: float) -> nn.Sequential:
    layers: list[nn.Module] = []
    for index, (inputs, outputs) in enumerate(itertools.pairwise(sizes)):
        last = index == len(sizes) - 2
        layer = nn.Linear(inputs, outputs)
        nn.init.orthogonal_(layer.weight, last_gain if last else math.sqrt(2))
        nn.init.zeros_(layer.bias)
        layers += [layer] if last else [layer, nn.Tanh()]
    return nn.Sequential(*layers)


class ActorCritic(nn.Module):
    """Two separate 64x64 tanh networks over the normalised observation."""

    def __init__(self, observations: int, actions: int, initial_std: float) -> None:
        super().__init__()
        self.actor = _network((observations, 64, 64, actions), 0.01)
        self.critic = _network((observations, 64, 64, 1), 1.0)
        self.log_std = nn.Parameter(torch.full((actions,), math.log(initial_std)))

    def log_probability(self, observations: Tensor, actions: Tensor) -> Tensor:
        """log pi(a|s) of unclipped actions (n, A): (n,)."""
        means: Tensor = self.actor(observations)
        z = (actions - means) * torch.exp(-self.log_std)
        return (-0.5 * z * z - self.log_std - 0.5 * math.log(2 * math.pi)).sum(-1)

    def value(self, observations: Tensor) -> Tensor:
        """V(s), (n,)."""
        values: Tensor = self.critic(observations)
        return values.squeeze(-1)


@dataclass(frozen=True)
class Batch:
    """One iteration's experience, (horizon, copies, ...)."""

    observations: Tensor  # normalised
    actions: Tensor  # not clipped
    log_probabilities: Tensor
    values: Tensor
    rewards: Tensor  # scaled; at a truncation with the discounted value of s' added
    ends: Tensor  # 1 where an episode ended after the step
    last_value: Tensor  # (copies,)


class Trainer:
    """PPO on one robot, with its environments and its running statistics."""

    def __init__(self, robot: str, seed: int, settings: Settings) -> None:
        torch.manual_seed(derive_seed(seed, robot, "behaviour_training"))
        self.robot, self.seed, self.settings = robot, seed, settings
        self.env = RobotEnv(single_agent_id(robot), settings.copies)
        agent = self.env.spec.agents[0]
        self.model = ActorCritic(agent.observation_size, agent.action_size, settings.initial_std)
        self.optimizer = torch.optim.Adam(
            self.model.parameters(), lr=settings.learning_rate, eps=1e-5
        )
        self.observation_moments = RunningMoments(agent.observation_size)
        self.return_moments = RunningMoments(1)
        self.steps = 0
        self.episode_returns: list[float] = []  # true returns of finished episodes
        self._running_returns = np.zeros(settings.copies)
        self._discounted = np.zeros(settings.copies)
        self._episodes = 0
        self._reset(np.arange(settings.copies))
        self._observation = self._normalised(self.env.observe()[0], learn=True)

    def _reset(self, which: NDArray[np.int64]) -> None:
        episodes = range(self._episodes, self._episodes + len(which))
        seeds = [derive_seed(self.seed, self.robot, "training", episode) for episode in episodes]
        self._episodes += len(which)
        self.env.reset(which, np.array(seeds, np.int64))

    def _normalised(self, observation: Float32, *, learn: bool) -> Tensor:
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
            mean = model.actor(observation)
            action = mean + torch.exp(model.log_std) * torch.randn_like(mean)
            log_probability = model.log_probability(observation, action)
            value = model.value(observation)
            outcome = self.env.step([action.numpy()])
            reward, ended = outcome.rewards[0], outcome.terminated | outcome.truncated

            self._running_returns += reward
            self._discounted = self._discounted * settings.gamma + reward
            self.return_moments.update(self._discounted[:, None])
            deviation = np.sqrt(self.return_moments.variance[0] + 1e-8)
            scaled = np.clip(reward / deviation, -10, 10).astype(np.float32)
            if outcome.truncated.any():  # a time limit is not the task's end: bootstrap
                successor = self._normalised(self.env.observe()[0], learn=False)
                bootstrap = settings.gamma * model.value(successor).numpy()
                scaled += bootstrap * outcome.truncated
            if ended.any():
                which = np.flatnonzero(ended)
                self.episode_returns += self._running_returns[which].tolist()
                self._running_returns[which] = 0.0
                self._discounted[which] = 0.0
                self._reset(which)
            columns.append(
                (
                    observation,
                    action,
                    log_probability,
                    value,
                    torch.from_numpy(scaled),
                    torch.from_numpy(ended.astype(np.float32)),
                )
            )
            self._observation = self._normalised(self.env.observe()[0], learn=True)
        self.steps += settings.horizon * settings.copies
        observations, actions, log_probabilities, values, rewards, ends = (
            torch.stack(column) for column in zip(*columns, strict=True)
        )
        last_value = model.value(self._observation)
        return Batch(observations, actions, log_probabilities, values, rewards, ends, last_value)

    def _advantages(self, batch: Batch) -> Tensor:
        """Generalised advantage estimates, (horizon, copies)."""
        settings = self.settings
        advantages = torch.empty_like(batch.rewards)
        running, next_value = torch.zeros_like(batch.last_value), batch.last_value
        for t in reversed(range(settings.horizon)):
            going = 1.0 - batch.ends[t]
            delta = batch.rewards[t] + settings.gamma * next_value * going - batch.values[t]
            running = delta + settings.gamma * settings.gae_lambda * going * running
            advantages[t], next_value = running, batch.values[t]
        return advantages

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
                log_probability = model.log_probability(observations[rows], actions[rows])
                ratio = torch.exp(log_probability - old_log[rows])
                clipped = ratio.clamp(1 - settings.clip, 1 + settings.clip)
                policy_loss = -torch.min(advantage * ratio, advantage * clipped).mean()
                value, old = model.value(observations[rows]), old_values[rows]
                near = old + (value - old).clamp(-settings.clip, settings.clip)
                target = returns[rows]
                errors = torch.max((value - target) ** 2, (near - target) ** 2)
                loss = policy_loss + settings.value_weight * 0.5 * errors.mean()
                self.optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                nn.utils.clip_grad_norm_(model.parameters(), settings.gradient_norm)
                self.optimizer.step()

    def snapshot(self) -> Tensors:
        """The policy as it is now."""
        linear = [layer for layer in self.model.actor if isinstance(layer, nn.Linear)]
        tensors = {
            "observation_mean": self.observation_moments.mean.astype(np.float32),
            "observation_std": np.sqrt(self.observation_moments.variance + 1e-8).astype(np.float32),
            "log_std": self.model.log_std.detach().numpy().copy(),
        }
        for name, layer in zip(LAYERS, linear, strict=True):
            tensors[f"{name}.weight"] = layer.weight.detach().numpy().copy()
            tensors[f"{name}.bias"] = layer.bias.detach().numpy().copy()
        return tensors
