"""An ensemble of deterministic dynamics models (ME-TRPO: Kurutach et al., ICLR 2018; BREMEN).

Each model predicts the normalised change of the observation, all are trained on the same
minibatches, and they differ by their initial weights, as in BREMEN's code, which bootstraps
nothing either.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from otc_dist.algorithms.interface import Batch
from otc_dist.steps.networks import Mlp
from otc_dist.steps.standardisation import mean_and_std

if TYPE_CHECKING:
    from torch import Tensor

STATISTICS = tuple(
    f"{part}_{moment}" for part in ("observation", "action", "change") for moment in ("mean", "std")
)
PREDICTION_LIMIT = 1e5  # BREMEN's: keeps a diverging rollout finite


@dataclass(frozen=True)
class Ensemble:
    """Models s' = s + mean_d + std_d f_j((s - mean_s) / std_s, (a - mean_a) / std_a).

    The statistics are those of B_0. They are part of the state, under the keys that `statistics`
    gives them, and never change.
    """

    observation_size: int
    action_size: int
    hidden: tuple[int, ...]
    models: int

    @cached_property
    def network(self) -> Mlp:
        inputs = (self.observation_size, self.action_size)
        return Mlp(inputs, self.hidden, self.observation_size, copies=self.models)

    @staticmethod
    def statistics(offline: Batch) -> dict[str, np.ndarray]:
        """`observation_mean`, `_std` (s,), `action_mean`, `_std` (a,), `change_mean`, `_std` (s,).

        The change is s' - s.
        """
        pairs = zip(offline.observation.T, offline.next_observation.T, strict=True)
        parts: dict[str, Iterable[Tensor]] = {
            "observation": offline.observation.T,
            "action": offline.action.T,
            "change": (after - before for before, after in pairs),
        }
        found = {}
        for name, columns in parts.items():
            mean, std = mean_and_std(columns)
            found[f"{name}_mean"], found[f"{name}_std"] = mean.numpy(), std.numpy()
        return found

    def loss(self, models: Tensor, state: Mapping[str, Tensor], batch: Batch) -> Tensor:
        """Sum over the models of mean (f_j(s, a) - d)^2, d the normalised change.

        A sum, so that each model has the gradient that it would have alone.
        """
        change = batch.next_observation - batch.observation
        wanted = (change - state["change_mean"]) / state["change_std"]
        predicted = self.network.apply(models, *_normalised(state, batch.observation, batch.action))
        return ((predicted - wanted) ** 2).mean((1, 2)).sum()

    def predict(
        self, model: Tensor, state: Mapping[str, Tensor], observations: Tensor, actions: Tensor
    ) -> Tensor:
        """s' (B, s) by one model, a row of `Mlp.apart` (n,)."""
        network = self.network.first()
        change = network.apply(model, *_normalised(state, observations, actions))
        following = observations + state["change_mean"] + state["change_std"] * change
        return following.clamp(-PREDICTION_LIMIT, PREDICTION_LIMIT)


def normalised_observations(state: Mapping[str, Tensor], observations: Tensor) -> Tensor:
    """(..., s), by the `Ensemble.statistics` of B_0."""
    return (observations - state["observation_mean"]) / state["observation_std"]


def _normalised(
    state: Mapping[str, Tensor], observations: Tensor, actions: Tensor
) -> tuple[Tensor, Tensor]:
    scaled = (actions - state["action_mean"]) / state["action_std"]
    return normalised_observations(state, observations), scaled
