"""BREMEN: behaviour-regularised model ensemble (Matsushima et al., ICLR 2021).

An ensemble of dynamics models and a clone of the behaviour policy are fitted to the data; then a
policy that starts from the clone is improved by TRPO in rollouts of the models. After the next
deployment models and clone are fitted further, and the deployed policy is improved further: BREMEN
itself starts from a clone again, the OTC paper tunes the policy. What keeps it near the data is
where it starts and how little each step may change it.

Rewards and ends of episodes in the rollouts are the task's, not learned, as in BREMEN's code.
docs/method.md says where this differs from that code, and why.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from otc_dist.algorithms.bremen.advantages import ValueFunction, generalised_advantages
from otc_dist.algorithms.bremen.dynamics import STATISTICS, Ensemble, normalised_observations
from otc_dist.algorithms.bremen.policy_step import PolicyStep
from otc_dist.algorithms.interface import Batch
from otc_dist.description.algorithms import AlgorithmSection, LargeSection
from otc_dist.spec import Task
from otc_dist.steps.networks import Mlp, descend, fresh_state
from otc_dist.steps.noise import Noise, NoiseSpec
from otc_dist.steps.state import Fuse, State
from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor

IMPROVEMENT = {"compiled": 150.0, "eager": 250.0, "cuda-graph": 150.0}  # ms; the last a guess
AVERAGED_SHARE = 0.1  # of the updates made: the longest that weights are averaged over


class Rollouts(NamedTuple):
    """H steps in the models, B side by side; where one ends, another starts in its place."""

    observations: Tensor  # (H, B, s)
    actions: Tensor  # (H, B, a), as the policy drew them: beyond [-1, 1] perhaps
    rewards: Tensor  # (H, B)
    ends: Tensor  # (H, B) 0 or 1
    last: Tensor  # (B, s), the states after the last step


class BremenSection(LargeSection):
    """BREMEN. It has no Q, hence no d_q. docs/method.md compares it with its authors' code."""

    has_q: ClassVar[bool] = False
    plans: ClassVar[bool] = True
    update: ClassVar[float] = 3.8
    brief: ClassVar[tuple[str, ...]] = ("algorithm.improvements=1",)

    name: Literal["bremen"] = "bremen"
    actor_learning_rate: float = Field(default=1e-4, gt=0, description="of the clone")
    model_learning_rate: float = Field(default=5e-4, gt=0, description="Table 3's of the critic")
    average_rate: float = Field(
        default=1e-3, gt=0, le=1, description="of the averages of the models' and clone's weights"
    )
    models: int = Field(default=5, ge=1, description="dynamics models in the ensemble")
    improvements: int = Field(
        default=50, ge=0, description="trust-region steps after each phase's updates"
    )
    horizon: int = Field(default=100, ge=1, description="steps of a rollout in the models")
    std: float = Field(default=0.1, gt=0, description="of the policy in rollouts")
    trace: float = Field(default=0.95, ge=0, le=1, description="lambda of the advantages (GAE)")
    radius: float = Field(
        default=0.01, gt=0, description="largest mean KL divergence of one step, nats"
    )

    def afterwards(self, engine: str) -> float:
        return self.improvements * IMPROVEMENT[engine]


@dataclass(frozen=True)
class Bremen:
    """BREMEN for one agent with continuous actions in [-1, 1].

    A policy is N(tanh f(s), std^2), bounded where it acts. Deployed is its mean. Rollouts and the
    offline policy's start use averages of the models' and the clone's weights.

    Attributes:
        observation_size, action_size: the agent's own.
        task: rewards and ends of the rollouts.
    """

    Section: ClassVar[type[AlgorithmSection]] = BremenSection

    observation_size: int
    action_size: int
    settings: BremenSection
    task: Task

    metric_names: tuple[str, ...] = ("model_loss", "clone_loss")
    improvement_metric_names: tuple[str, ...] = (
        "model_reward",  # of a step, mean
        "model_ends",  # share of steps that end an episode
        "value_error",  # of the value function before its fit, std over that of its targets
        "gain",
        "divergence",
        "step_length",  # 1 for a full step, 0 for none
    )

    policy_keys: tuple[str, ...] = ("policy", "value", "value_moments", "value_updates")

    @cached_property
    def ensemble(self) -> Ensemble:
        hidden, models = self.settings.hidden, self.settings.models
        return Ensemble(self.observation_size, self.action_size, hidden, models)

    @cached_property
    def actor(self) -> Mlp:
        return Mlp((self.observation_size,), self.settings.hidden, self.action_size)

    @cached_property
    def policy_step(self) -> PolicyStep:
        return PolicyStep(self.actor, self.settings.std, self.settings.radius)

    @cached_property
    def value_function(self) -> ValueFunction:
        return ValueFunction(self.observation_size, self.settings.discount)

    def initial_state(self, random: np.random.Generator, offline: Batch) -> dict[str, np.ndarray]:
        """Fresh networks; what else there is does not depend on chance.

        Keys: models and clone, each with `_moments` (2, n) and `_average`; policy, equal to the
        clone; `ValueFunction.initial_state`; `Ensemble.statistics` of B_0; updates (float64
        scalar), the number of updates made.
        """
        state = fresh_state(
            {
                "models": self.ensemble.network.initialise(random),
                "clone": self.actor.initialise(random),
            }
        )
        return {
            **state,
            "models_average": state["models"].copy(),
            "clone_average": state["clone"].copy(),
            "policy": state["clone"].copy(),
            **self.ensemble.statistics(offline),
            **self.value_function.initial_state(random, offline),
        }

    def noise_spec(self, batch_size: int) -> Mapping[str, NoiseSpec]:
        """Nothing: the minibatch is all that is random in an update."""
        return {}

    def update(
        self, state: State, batch: Batch, imitated: Batch, noise: Noise
    ) -> tuple[State, Tensor]:
        """One gradient step of every model, and of the clone on what it imitates."""
        state = dict(state, updates=state["updates"] + 1)
        state, model_loss = descend(
            state,
            "models",
            self.settings.model_learning_rate,
            lambda models: self.ensemble.loss(models, state, batch),
        )
        state, clone_loss = descend(
            state,
            "clone",
            self.settings.actor_learning_rate,
            lambda clone: self.clone_loss(clone, state, imitated),
        )
        for name in ("models", "clone"):
            state[f"{name}_average"] = self.average(state, name)
        return state, torch.stack((model_loss / self.settings.models, clone_loss))

    def clone_loss(self, clone: Tensor, state: State, batch: Batch) -> Tensor:
        """mean (a - tanh f(s))^2, which is the negative log likelihood up to constants."""
        observations = normalised_observations(state, batch.observation)
        return torch.nn.functional.mse_loss(self.mean(clone, observations), batch.action)

    def average(self, state: State, name: str) -> Tensor:
        """Exponential moving average of a network's weights (n,), after an update.

        It reaches back over the last 1 / average_rate updates, or, if that is less, over about
        AVERAGED_SHARE of all.
        """
        count = state["updates"]
        weight = (1 / (1 + AVERAGED_SHARE * (count - 1))).clamp(min=self.settings.average_rate)
        return torch.lerp(state[f"{name}_average"], state[name], weight.to(state[name].dtype))

    def mean(self, actor: Tensor, normalised: Tensor) -> Tensor:
        """tanh f(s) (..., a) of a policy or the clone, for normalised observations (..., s)."""
        return self.actor.apply(actor, normalised).tanh()

    def acting_noise_spec(self, copies: int) -> Mapping[str, NoiseSpec]:
        """Nothing: the mean is deployed."""
        return {}

    def act(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        return self.mean(state["policy"], normalised_observations(state, observations))

    @property
    def improvements(self) -> int:
        return self.settings.improvements

    def first_policy(self, state: State) -> State:
        """The policy starts from the clone; the value function goes on from where it was."""
        return dict(state, policy=state["clone_average"])

    def improvement_noise_spec(self, batch_size: int) -> Mapping[str, NoiseSpec]:
        steps = (self.settings.horizon, batch_size)
        return {
            "action": NoiseSpec("normal", (*steps, self.action_size)),
            "model": NoiseSpec("uniform", (self.settings.horizon,)),
            "restart": NoiseSpec("uniform", steps),
            "value": self.value_function.noise_spec(),
        }

    def improve(self, fuse: Fuse, state: State, batch: Batch, noise: Noise) -> tuple[State, Tensor]:
        """Rollouts, a trust-region step of the policy, then a fit of the value function.

        The order is BREMEN's: the value function has not seen the rollouts that it judges.
        """
        settings, rollouts = self.settings, self.rollouts(fuse, state, batch, noise)
        visited = torch.cat((rollouts.observations, rollouts.last.unsqueeze(0)))
        normalised = normalised_observations(state, visited)
        values = self.value_function.values(state, normalised)
        advantages = generalised_advantages(
            rollouts.rewards, rollouts.ends, values, settings.discount, settings.trace
        )
        observations = normalised[:-1].flatten(0, 1)
        step = self.policy_step(
            fuse,
            state["policy"],
            observations,
            rollouts.actions.flatten(0, 1),
            advantages.flatten(),
        )
        targets = (advantages + values[:-1]).flatten()
        new = self.value_function.fit(fuse, state, observations, targets, noise["value"])
        metrics = (
            rollouts.rewards.mean(),
            rollouts.ends.mean(),
            advantages.std() / targets.std(),
            step.gain,
            step.divergence,
            step.length,
        )
        return dict(new, policy=step.parameters), torch.stack(metrics)

    def rollouts(self, fuse: Fuse, state: State, batch: Batch, noise: Noise) -> Rollouts:
        """Rollouts of the policy from the batch's states.

        At each step one model, drawn at random, moves all of them, as in BREMEN's code. Where an
        episode ends, another starts from a random state of the batch.
        """
        models = self.ensemble.network.apart(state["models_average"])
        which = (noise["model"] * self.settings.models).long().tolist()
        restarts = (noise["restart"] * len(batch.observation)).long()
        known = {name: state[name] for name in ("policy", *STATISTICS)}
        # Contiguous, as all that follow, or `move` would be compiled once more for the first.
        move, observation = fuse(self.move), batch.observation.contiguous()
        steps = []
        for t in range(self.settings.horizon):
            start = batch.observation[restarts[t]]
            model = models[which[t]]
            *moved, following = move(known, model, observation, noise["action"][t], start)
            steps.append((observation, *moved))
            observation = following
        observations, actions, rewards, ends = map(torch.stack, zip(*steps, strict=True))
        return Rollouts(observations, actions, rewards, ends, observation)

    def move(
        self, known: State, model: Tensor, observation: Tensor, noise: Tensor, start: Tensor
    ) -> tuple[Tensor, ...]:
        """One step of all rollouts by one model: actions, rewards, ends, and the states after it.

        Args:
            start: (B, s), where those that end begin again.
        """
        mean = self.mean(known["policy"], normalised_observations(known, observation))
        drawn = mean + self.settings.std * noise
        action = drawn.clamp(-1, 1)
        following = self.ensemble.predict(model, known, observation, action)
        reward = self.task.reward(observation, action, following)
        end = self.task.terminated(following)
        after = torch.where(end.unsqueeze(-1), start, following)
        return drawn, reward, end.to(reward.dtype), after
