"""The embedding of d_e: a conditional VAE G = {E(mu, sigma | s, a, s'), D(a | s, s', z)}.

It is trained on B_0 only and then frozen: an embedding that moved would rescale the distances
and so contaminate the ratio of Eq. 4.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from torch import Tensor
from torch.nn.functional import mse_loss

from otc_dist.algorithms.interface import Batch
from otc_dist.steps.networks import Mlp, adam, value_and_gradient
from otc_dist.steps.noise import Noise, NoiseSpec
from otc_dist.steps.standardisation import mean_and_std
from otc_dist.steps.state import State

ACTIVE_VARIANCE = 0.01  # a dimension of mu is active above this variance over the data
LOG_STD_RANGE = (-8.0, 4.0)


@dataclass(frozen=True)
class Embedding:
    """mu(s, a, s') as pure functions.

    Attributes:
        kl_weight: weight of KL(N(mu, sigma) || N(0, 1)). Since (s, s') nearly determines a, the
            usual weights collapse the latent: keep it small.
    """

    observation_size: int
    action_size: int
    size: int
    hidden: tuple[int, ...]
    learning_rate: float
    kl_weight: float

    metric_names: tuple[str, ...] = ("embedding_loss",)

    @cached_property
    def encoder(self) -> Mlp:
        inputs = (self.observation_size, self.action_size, self.observation_size)
        return Mlp(inputs, self.hidden, 2 * self.size)

    @cached_property
    def decoder(self) -> Mlp:
        inputs = (self.observation_size, self.observation_size, self.size)
        return Mlp(inputs, self.hidden, self.action_size)

    def initial_state(self, random: np.random.Generator, rows: Batch) -> dict[str, np.ndarray]:
        """Fresh parameters, and the statistics of B_0 by which inputs are standardised."""
        network = np.concatenate(
            [self.encoder.initialise(random), self.decoder.initialise(random)], dtype=np.float32
        )
        state: dict[str, np.ndarray] = {
            "network": network,
            "moments": np.zeros((2, len(network)), dtype=np.float32),
            "updates": np.zeros((), dtype=np.float64),
        }
        for name, values in (("state", rows.observation), ("action", rows.action)):
            mean, std = mean_and_std(values.T)
            state[f"{name}_mean"], state[f"{name}_std"] = mean.numpy(), std.numpy()
        return state

    def noise_spec(self, batch_size: int) -> Mapping[str, NoiseSpec]:
        return {"embedding": NoiseSpec("normal", (batch_size, self.size))}

    def update(self, state: State, batch: Batch, noise: Noise) -> tuple[State, Tensor]:
        """One Adam step on  mean (a - a_hat)^2 + kl_weight KL  of standardised transitions."""

        def loss(network: Tensor) -> Tensor:
            s, a, next_s = self._standardise(state, batch)
            mean, log_std = self._encode(network, s, a, next_s)
            std = log_std.exp()
            latent = mean + std * noise["embedding"]
            decoded = self.decoder.apply(network[self.encoder.size :], s, next_s, latent)
            divergence = -0.5 * (1 + 2 * log_std - mean**2 - std**2).sum(-1).mean()
            return mse_loss(decoded, a) + self.kl_weight * divergence

        value, gradient = value_and_gradient(loss, state["network"])
        count = state["updates"] + 1
        network, moments = adam(
            state["network"], gradient, state["moments"], count, self.learning_rate
        )
        new = dict(state, network=network, moments=moments, updates=count)
        return new, value.view(1)

    def embed(self, state: State, batch: Batch) -> Tensor:
        """mu(s, a, s') (B, size)."""
        return self._encode(state["network"], *self._standardise(state, batch))[0]

    def _encode(self, network: Tensor, *inputs: Tensor) -> tuple[Tensor, Tensor]:
        encoded = self.encoder.apply(network[: self.encoder.size], *inputs)
        mean, log_std = encoded.chunk(2, dim=-1)
        return mean, log_std.clamp(*LOG_STD_RANGE)

    @staticmethod
    def _standardise(state: State, batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
        mean, std = state["state_mean"], state["state_std"]
        return (
            (batch.observation - mean) / std,
            (batch.action - state["action_mean"]) / state["action_std"],
            (batch.next_observation - mean) / std,
        )


def active_dimensions(embeddings: Tensor) -> int:
    """How many dimensions of mu vary over the data (N, size): variance above 0.01."""
    return int((embeddings.var(0) > ACTIVE_VARIANCE).sum())
