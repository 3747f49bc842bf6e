"""Twin critics: two action values trained on one target, against overestimation (Fujimoto, van
Hoof and Meger, ICML 2018), and what the algorithms that have them share.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from otc_dist.algorithms.interface import Batch
from otc_dist.steps.networks import Mlp, descend
from otc_dist.steps.standardisation import mean_and_std
from otc_dist.steps.state import State

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class TwinCritics:
    """Q_1(s, a) and Q_2(s, a) as pure functions of one flat parameter vector (size,).

    States (..., s) and actions (..., a) may have different leading shapes that broadcast.
    """

    observation_size: int
    action_size: int
    hidden: tuple[int, ...]

    @cached_property
    def network(self) -> Mlp:
        return Mlp((self.observation_size, self.action_size), self.hidden, 1, copies=2)

    def initialise(self, random: np.random.Generator) -> np.ndarray:
        return self.network.initialise(random)

    def both(self, parameters: Tensor, observations: Tensor, actions: Tensor) -> Tensor:
        """Q_1 and Q_2 (2, ...)."""
        return self.network.apply(parameters, observations, actions).squeeze(-1)

    def minimum(self, parameters: Tensor, observations: Tensor, actions: Tensor) -> Tensor:
        """min_j Q_j(s, a) (...)."""
        return self.both(parameters, observations, actions).amin(0)

    def first(self, parameters: Tensor, observations: Tensor, actions: Tensor) -> Tensor:
        """Q_1(s, a) (...), without the cost of the other."""
        network = self.network
        alone = network.first_parameters(parameters)
        return network.first().apply(alone, observations, actions).squeeze(-1)

    def loss(self, parameters: Tensor, batch: Batch, target: Tensor) -> Tensor:
        """Sum over the twins of mean (Q_j(s, a) - y)^2, for targets y (B,)."""
        q = self.both(parameters, batch.observation, batch.action)
        return ((q - target) ** 2).mean(-1).sum()


def td_target(batch: Batch, discount: float, next_values: Tensor) -> Tensor:
    """y = r + gamma V(s') (B,), and y = r at a terminal s', for next values V(s') (B,)."""
    return batch.reward + discount * (1 - batch.terminated) * next_values


class ActorCriticSettings(Protocol):
    """What an `ActorCritic` must be given; the section of each algorithm has it."""

    @property
    def hidden(self) -> tuple[int, ...]: ...

    @property
    def critic_learning_rate(self) -> float: ...


@dataclass(frozen=True)
class ActorCritic:
    """What continuous-action algorithms with twin critics have in common.

    Their state holds the critics' parameters as "critic".

    Attributes:
        observation_size, action_size: the agent's own.
    """

    observation_size: int
    action_size: int
    settings: ActorCriticSettings

    @cached_property
    def critics(self) -> TwinCritics:
        return TwinCritics(self.observation_size, self.action_size, self.settings.hidden)

    def fit_critics(self, state: State, batch: Batch, target: Tensor) -> tuple[State, Tensor]:
        """One step of the critics towards targets y (B,): the new state and the loss before it."""
        return descend(
            state,
            "critic",
            self.settings.critic_learning_rate,
            lambda critic: self.critics.loss(critic, batch, target),
        )

    def q(self, state: State, observations: Tensor, actions: Tensor) -> Tensor:
        """Q_1(s, a) (...)."""
        return self.critics.first(state["critic"], observations, actions)


@dataclass(frozen=True)
class StandardisedActorCritic(ActorCritic):
    """An `ActorCritic` whose networks see states standardised by B_0, as TD3+BC's and CORL's do.

    Its state holds `state_mean` and `state_std` (s,), which never change. What a learner calls
    takes states as they are: `update`, `act`, `q` and `value`.
    """

    @staticmethod
    def statistics(offline: Batch) -> dict[str, np.ndarray]:
        """`state_mean` and `state_std` of B_0."""
        mean, std = mean_and_std(offline.observation.T)
        return {"state_mean": mean.numpy(), "state_std": std.numpy()}

    @staticmethod
    def standardised(state: State, observations: Tensor) -> Tensor:
        """(s - mean) / std (..., s)."""
        return (observations - state["state_mean"]) / state["state_std"]

    def standardised_batch(self, state: State, batch: Batch) -> Batch:
        """The batch with s and s' standardised."""
        return batch._replace(
            observation=self.standardised(state, batch.observation),
            next_observation=self.standardised(state, batch.next_observation),
        )

    def q(self, state: State, observations: Tensor, actions: Tensor) -> Tensor:
        """Q_1(s, a) (...), for states as they are."""
        return super().q(state, self.standardised(state, observations), actions)
