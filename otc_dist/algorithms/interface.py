"""What every algorithm offers: pure functions of (state, batch, noise).

An algorithm is made as `Kind(observation_size, action_size, settings)`, with the `Task` behind them
where its section `plans`; of discrete actions, action_size is how many there are to choose from.
`Kind.Section` is the class of its settings (`AlgorithmSection`).

The object holds sizes and hyper-parameters only, and is hashable, as a frozen dataclass is: equal
ones are compiled once. Everything that changes lies in the state, a dictionary of tensors;
everything random comes in as noise. So the same functions run compiled, in a CUDA graph, or
eagerly, and a test can run them in float64.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import (
    TYPE_CHECKING,
    NamedTuple,
    Protocol,
    runtime_checkable,
)

import numpy as np

from otc_dist.steps.noise import Noise, NoiseSpec
from otc_dist.steps.state import Fuse, State
from otc_dist.system.lazy import torch
from otc_dist.transitions import RowLayout

if TYPE_CHECKING:
    from torch import Tensor


class Batch(NamedTuple):
    """B transitions of one agent, as tensors.

    Continuous actions are scaled to [-1, 1]; a discrete one is its index, and the masks of
    available actions are the tails of s and s' (`AgentSpec.choices`).
    """

    observation: Tensor  # (B, s)
    action: Tensor  # (B, a)
    reward: Tensor  # (B,)
    next_observation: Tensor  # (B, s)
    terminated: Tensor  # (B,) 0 or 1


def unpack(rows: Tensor, layout: RowLayout) -> Batch:
    """Views of packed rows (B, width)."""
    return Batch(
        rows[:, layout.observation],
        rows[:, layout.action],
        rows[:, layout.reward],
        rows[:, layout.next_observation],
        rows[:, layout.terminated],
    )


def action_features(actions: Tensor, choices: int) -> Tensor:
    """Actions (B, a) as a network takes them: a discrete one (B, 1) as a one-hot vector."""
    if not choices:
        return actions
    return (actions == torch.arange(choices, device=actions.device)).to(actions.dtype)


class Algorithm(Protocol):
    """An offline RL algorithm as pure functions."""

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the values that `update` returns."""
        ...

    def initial_state(self, random: np.random.Generator, offline: Batch) -> dict[str, np.ndarray]:
        """Fresh parameters, targets, moments, the update counter, and statistics of B_0.

        Keys are those of `fresh_state`: a network's name, `NAME_moments` of its optimizer,
        `NAME_target`; and `updates`, which every algorithm has. Those that begin with `sampler_`
        are the samplers'.

        Args:
            offline: all of B_0, by which inputs are normalised from then on.
        """
        ...

    def noise_spec(self, batch_size: int) -> Mapping[str, NoiseSpec]:
        """The random arrays that one `update` of a batch of this size needs."""
        ...

    def update(
        self, state: State, batch: Batch, imitated: Batch, noise: Noise
    ) -> tuple[State, Tensor]:
        """One gradient update: the new state, and the values of `metric_names`.

        It counts itself in `updates`, changes nothing in place, and keeps to the state's precision.
        Keys of the state that are not the algorithm's are passed on. `torch.func.vmap` may map it
        over the states of several seeds.

        Args:
            batch: transitions (B) to learn values from.
            imitated: transitions (B) for whatever imitates the behaviour in the data. Where a
                sampler corrects the former only, these are a plain sample; else both are one.
        """
        ...

    def acting_noise_spec(self, copies: int) -> Mapping[str, NoiseSpec]:
        """The random arrays that `act` needs for `copies` observations."""
        ...

    def act(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        """Deployed actions (E, a) in [-1, 1], or indices (E, 1), for observations (E, s)."""
        ...


@runtime_checkable
class Critic(Protocol):
    """What an algorithm with a Q offers beside `Algorithm`; d_q needs it.

    `has_q` of its section says whether it does.
    """

    def q(self, state: State, observations: Tensor, actions: Tensor) -> Tensor:
        """Q(s, a_i) (B,) of the critic that learns, not of its target; no gradient is taken."""
        ...

    def value_noise_spec(self, count: int, samples: int) -> Mapping[str, NoiseSpec]:
        """The random arrays that `value` needs for `count` states."""
        ...

    def value(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        """V(s) = E_a Q(s, a) (B,) over the policy's actions, by the samples in `noise`."""
        ...


@runtime_checkable
class Improving(Protocol):
    """What an algorithm offers whose policy is improved after a phase's updates (BREMEN)."""

    @property
    def improvements(self) -> int:
        """Improvement steps after the updates of a phase."""
        ...

    @property
    def improvement_metric_names(self) -> tuple[str, ...]:
        """Names of the values that `improve` returns."""
        ...

    @property
    def policy_keys(self) -> tuple[str, ...]:
        """The part of the state that goes back with the policy (`deployment.revert`).

        The rest, like models of the data, is as good whichever policy is deployed.
        """
        ...

    def first_policy(self, state: State) -> State:
        """The state in which offline training's improvements find the policy.

        Those of tuning find it as it was deployed.
        """
        ...

    def improvement_noise_spec(self, batch_size: int) -> Mapping[str, NoiseSpec]:
        """The random arrays that one `improve` from a batch of this size needs."""
        ...

    def improve(self, fuse: Fuse, state: State, batch: Batch, noise: Noise) -> tuple[State, Tensor]:
        """One improvement from the states of a batch, and `improvement_metric_names`' values.

        Args:
            fuse: how the engine runs a pure function; an improvement is made of several, since
                what to compute next depends on what was found.
        """
        ...
