"""The embedding of d_e equals a plain conditional VAE, and keeps its dimensions alive."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import mse_loss

from benchmarks.plain.parts import mlp, normalised, statistics, step
from otc_dist.algorithms.interface import Batch
from otc_dist.otc.embedding import Embedding, active_dimensions
from otc_dist.steps.noise import sample_noise

from ..flat_weights import get_flat, set_flat

S, A, SIZE, HIDDEN = 11, 2, 10, (32, 16)
EMBEDDING = Embedding(S, A, SIZE, HIDDEN, learning_rate=1e-3, kl_weight=1e-2)


class PlainEmbedding:
    """The conditional VAE of `EMBEDDING` on standardised transitions."""

    def __init__(self) -> None:
        self.encoder = mlp(2 * S + A, HIDDEN, 2 * SIZE, torch.float64)
        self.decoder = mlp(2 * S + SIZE, HIDDEN, A, torch.float64)
        parameters = [*self.encoder.parameters(), *self.decoder.parameters()]
        self.adam = torch.optim.Adam(parameters, lr=1e-3)

    def fit_statistics(self, offline: Batch) -> None:
        self.states, self.actions = statistics(offline.observation), statistics(offline.action)

    def standardised(self, batch: Batch) -> Sequence[Tensor]:
        """s, a and s'."""
        return (
            normalised(batch.observation, self.states),
            normalised(batch.action, self.actions),
            normalised(batch.next_observation, self.states),
        )

    def embed(self, batch: Batch) -> Tensor:
        with torch.no_grad():
            return self.encoder(torch.cat(self.standardised(batch), 1))[:, :SIZE]

    def update(self, batch: Batch, noise: Tensor) -> list[float]:
        s, a, next_s = self.standardised(batch)
        mean, log_std = self.encoder(torch.cat((s, a, next_s), 1)).chunk(2, 1)
        log_std = log_std.clamp(-8, 4)
        latent = mean + log_std.exp() * noise
        divergence = 0.5 * ((2 * log_std).exp() + mean**2 - 1 - 2 * log_std).sum(1).mean()
        decoded = self.decoder(torch.cat((s, next_s, latent), 1))
        loss = mse_loss(decoded, a) + 1e-2 * divergence
        step(self.adam, loss)
        return [loss.item()]


def random_batch(random: np.random.Generator, size: int) -> Batch:
    s, next_s = random.normal(3.0, 2.0, (2, size, S))
    a = np.tanh(s[:, :A] - next_s[:, :A]) + 0.1 * random.standard_normal((size, A))
    fields = (s, a, np.zeros(size), next_s, np.zeros(size))
    return Batch(*(torch.from_numpy(field) for field in fields))


def test_losses_and_weights_equal_the_plain_version_in_float64() -> None:
    random = np.random.default_rng(0)
    data = random_batch(random, 500)
    initial = EMBEDDING.initial_state(random, data)
    state = {name: torch.from_numpy(np.array(x, np.float64)) for name, x in initial.items()}
    plain = PlainEmbedding()
    set_flat([plain.encoder, plain.decoder], state["network"])
    plain.fit_statistics(data)
    np.testing.assert_allclose(state["state_mean"], plain.states[0], rtol=1e-6)
    np.testing.assert_allclose(state["action_std"], plain.actions[1], rtol=1e-6)
    plain.states = state["state_mean"], state["state_std"]
    plain.actions = state["action_mean"], state["action_std"]

    for _ in range(120):
        batch = random_batch(random, 64)
        drawn = sample_noise(random, EMBEDDING.noise_spec(64), 1)["embedding"][0]
        noise = torch.from_numpy(drawn).double()
        state, metrics = EMBEDDING.update(state, batch, {"embedding": noise})
        expected = plain.update(batch, noise)
        np.testing.assert_allclose(metrics.numpy(), expected, rtol=1e-10, atol=1e-12)
    weights = get_flat([plain.encoder, plain.decoder])
    np.testing.assert_allclose(state["network"], weights, atol=1e-10)

    batch = random_batch(random, 50)
    np.testing.assert_allclose(EMBEDDING.embed(state, batch), plain.embed(batch), atol=1e-10)


def test_statistics_stay_those_of_the_offline_data() -> None:
    random = np.random.default_rng(1)
    initial = EMBEDDING.initial_state(random, random_batch(random, 100))
    state = {name: torch.from_numpy(x) for name, x in initial.items()}
    noise = {"embedding": torch.zeros(8, SIZE)}
    shifted = Batch(*(field.float() + 100 for field in random_batch(random, 8)))
    new, _ = EMBEDDING.update(state, shifted, noise)
    for name in ("state_mean", "state_std", "action_mean", "action_std"):
        assert torch.equal(new[name], state[name])


def test_active_dimensions_are_those_that_vary() -> None:
    spread = torch.tensor([1.0, 0.2, 0.11, 0.09, 0.0])  # variances 1, .04, .0121, .0081, 0
    values = torch.tensor([-1.0, 1.0]).repeat(5000).unsqueeze(1) * spread
    assert active_dimensions(values) == 3
