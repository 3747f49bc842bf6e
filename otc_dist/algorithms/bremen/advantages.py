"""What actions in a rollout are worth: a value function, and advantages over it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from otc_dist.algorithms.interface import Batch
from otc_dist.steps.networks import Mlp, descend, fresh_state
from otc_dist.steps.noise import NoiseSpec
from otc_dist.steps.state import Fuse, State
from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor

HIDDEN = (64, 64)
LEARNING_RATE = 1e-3
STEPS, BATCH = 100, 512  # gradient steps of one fit, and their minibatch
INPUT_LIMIT = 10.0  # of a normalised observation, as in BREMEN's code


@dataclass(frozen=True)
class ValueFunction:
    """V(s) of normalised observations, a small network.

    Its outputs are scaled by the root mean square of B_0's rewards over 1 - gamma, so that they
    are of order one whatever the rewards' unit.
    """

    observation_size: int
    discount: float

    @cached_property
    def network(self) -> Mlp:
        return Mlp((self.observation_size,), HIDDEN, 1)

    def initial_state(self, random: np.random.Generator, offline: Batch) -> dict[str, np.ndarray]:
        """Keys: value, value_moments; value_updates (float64 scalar); value_scale (scalar)."""
        state = fresh_state({"value": self.network.initialise(random)})
        size = float((offline.reward.double() ** 2).mean().sqrt()) / (1 - self.discount)
        return {
            "value": state["value"],
            "value_moments": state["value_moments"],
            "value_updates": state["updates"],
            "value_scale": np.array(size or 1.0, np.float32),
        }

    def noise_spec(self) -> NoiseSpec:
        return NoiseSpec("uniform", (STEPS, BATCH))

    def values(self, state: Mapping[str, Tensor], normalised: Tensor) -> Tensor:
        """V(s) (...), for normalised observations (..., s)."""
        return self._scaled(state["value"], normalised) * state["value_scale"]

    def fit(
        self, fuse: Fuse, state: State, normalised: Tensor, targets: Tensor, noise: Tensor
    ) -> State:
        """Some steps of Adam on minibatches, drawn with replacement, of mean (V(s) - target)^2.

        Args:
            normalised: observations (N, s).
            targets: (N,).
            noise: as `noise` describes.
        """
        # `descend` counts for Adam's correction by `updates`: here the value function's own.
        own = {name: state[name] for name in ("value", "value_moments")}
        own["updates"] = state["value_updates"]
        fit_step, targets = fuse(self.fit_step), targets / state["value_scale"]
        for rows in (noise * len(targets)).long():
            own = fit_step(own, normalised[rows], targets[rows])
        return {**state, **own, "updates": state["updates"], "value_updates": own["updates"]}

    def fit_step(self, own: State, x: Tensor, y: Tensor) -> State:
        """One step of Adam on  mean (V(x) - y)^2, in units of `value_scale`."""
        own = dict(own, updates=own["updates"] + 1)
        new, _ = descend(
            own, "value", LEARNING_RATE, lambda value: ((self._scaled(value, x) - y) ** 2).mean()
        )
        return new

    def _scaled(self, value: Tensor, normalised: Tensor) -> Tensor:
        bounded = normalised.clamp(-INPUT_LIMIT, INPUT_LIMIT)
        return self.network.apply(value, bounded).squeeze(-1)


def generalised_advantages(
    rewards: Tensor, ends: Tensor, values: Tensor, discount: float, trace: float
) -> Tensor:
    """A_t = d_t + gamma lambda (1 - end_t) A_{t+1},  d_t = r_t + gamma (1 - end_t) V_{t+1} - V_t.

    Generalised advantage estimation (Schulman et al., ICLR 2016). Nothing after an end counts;
    a rollout that the horizon cuts off is worth V of the state it has reached.

    Args:
        rewards: (H, B).
        ends: (H, B), 1 where step t ended an episode, otherwise 0.
        values: (H + 1, B), V(s_0) .. V(s_H).
        discount, trace: gamma, lambda.

    Returns:
        (H, B).
    """
    following = 1 - ends
    errors = rewards + discount * following * values[1:] - values[:-1]
    advantage = torch.zeros_like(errors[0])
    found = []
    for error, going_on in zip(errors.flip(0), following.flip(0), strict=True):
        advantage = error + discount * trace * going_on * advantage
        found.append(advantage)
    return torch.stack(found).flip(0)
