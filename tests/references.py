"""A second, plain version of the mathematics, in float64: what the fast one must equal.

BCQ and the conditional VAE are torch modules with autograd and torch.optim.Adam, written from
the published equations; OTC is loops in numpy. Nothing here is shared with the library but the
order of its parameter vectors.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

Float = NDArray[np.float64]


class Network(nn.Module):
    """ReLU layers on the concatenation of the inputs."""

    def __init__(self, inputs: int, hidden: Sequence[int], outputs: int) -> None:
        super().__init__()
        sizes = (inputs, *hidden, outputs)
        self.layers = nn.ModuleList(nn.Linear(a, b).double() for a, b in pairwise(sizes))

    def forward(self, *inputs: Tensor) -> Tensor:
        x = torch.cat(inputs, -1)
        for layer in self.layers[:-1]:
            x = torch.relu(layer(x))
        return self.layers[-1](x)


def set_flat(networks: Sequence[Network], flat: Tensor, twins: bool = False) -> None:
    """Copy a flat vector in: layer by layer weight (in, out) and bias.

    Networks come one after another, or as twins: each layer's weights of both, then biases.
    """
    start = 0

    def take(*shape: int) -> Tensor:
        nonlocal start
        part = flat[start : start + int(np.prod(shape))]
        start += len(part)
        return part.view(*shape)

    with torch.no_grad():
        for group in [networks] if twins else [[network] for network in networks]:
            for layers in zip(*(network.layers for network in group), strict=True):
                for layer in layers:
                    layer.weight.copy_(take(layer.in_features, layer.out_features).T)
                for layer in layers:
                    layer.bias.copy_(take(layer.out_features))
    assert start == len(flat)


def get_flat(networks: Sequence[Network], twins: bool = False) -> Tensor:
    """The inverse of `set_flat`."""
    parts = []
    for group in [networks] if twins else [[network] for network in networks]:
        for layers in zip(*(network.layers for network in group), strict=True):
            parts += [layer.weight.detach().T.reshape(-1) for layer in layers]
            parts += [layer.bias.detach() for layer in layers]
    return torch.cat(parts)


@dataclass
class Bcq:
    """BCQ of Fujimoto, Meger and Precup, 2019: their Algorithm 1 with their code's constants."""

    s: int
    a: int
    hidden: Sequence[int] = (64, 64)
    actor_rate: float = 1e-4
    critic_rate: float = 1e-4
    vae_rate: float = 1e-3
    discount: float = 0.99
    tau: float = 0.005
    phi: float = 0.05
    soft_minimum: float = 0.75

    def __post_init__(self) -> None:
        s, a, hidden, latent = self.s, self.a, self.hidden, 2 * self.a
        self.encoder = Network(s + a, hidden, 2 * latent)
        self.decoder = Network(s + latent, hidden, a)
        self.critics = [Network(s + a, hidden, 1) for _ in range(2)]
        self.target_critics = [Network(s + a, hidden, 1) for _ in range(2)]
        self.actor, self.target_actor = Network(s + a, hidden, a), Network(s + a, hidden, a)
        adam = torch.optim.Adam
        vae = [*self.encoder.parameters(), *self.decoder.parameters()]
        self.vae_adam = adam(vae, lr=self.vae_rate)
        twins = [p for critic in self.critics for p in critic.parameters()]
        self.critic_adam = adam(twins, lr=self.critic_rate)
        self.actor_adam = adam(self.actor.parameters(), lr=self.actor_rate)

    def load(self, state: Mapping[str, Tensor]) -> None:
        set_flat([self.encoder, self.decoder], state["vae"])
        set_flat(self.critics, state["critic"], twins=True)
        set_flat(self.target_critics, state["critic_target"], twins=True)
        set_flat([self.actor], state["actor"])
        set_flat([self.target_actor], state["actor_target"])

    def weights(self) -> dict[str, Tensor]:
        return {
            "vae": get_flat([self.encoder, self.decoder]),
            "critic": get_flat(self.critics, twins=True),
            "critic_target": get_flat(self.target_critics, twins=True),
            "actor": get_flat([self.actor]),
            "actor_target": get_flat([self.target_actor]),
        }

    def decode(self, s: Tensor, z: Tensor) -> Tensor:
        return torch.tanh(self.decoder(s, z))

    def perturbed(self, actor: Network, s: Tensor, a: Tensor) -> Tensor:
        return (a + self.phi * torch.tanh(actor(s, a))).clamp(-1, 1)

    def candidates(self, actor: Network, s: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """States repeated (B n, s) and perturbed actions (B n, a), for noise (B, n, latent)."""
        repeated = s.repeat_interleave(noise.shape[1], 0)
        z = noise.reshape(len(repeated), -1).clamp(-0.5, 0.5)
        return repeated, self.perturbed(actor, repeated, self.decode(repeated, z))

    def value(self, s: Tensor, noise: Tensor) -> Tensor:
        """E_a Q_1(s, a) over decoded and perturbed actions."""
        repeated, actions = self.candidates(self.actor, s, noise)
        return self.critics[0](repeated, actions).view(len(s), -1).mean(1)

    def act(self, s: Tensor, noise: Tensor) -> Tensor:
        repeated, actions = self.candidates(self.actor, s, noise)
        best = self.critics[0](repeated, actions).view(len(s), -1).argmax(1)
        return actions.view(len(s), -1, self.a)[range(len(s)), best]

    def update(self, batch: Sequence[Tensor], noise: Mapping[str, Tensor]) -> list[float]:
        """One update; the losses of the VAE, the critics and the actor, and the mean target."""
        s, a, r, next_s, done = batch
        mean, log_std = self.encoder(s, a).chunk(2, -1)
        std = torch.exp(log_std.clamp(-4, 15))
        decoded = self.decode(s, mean + std * noise["vae"])
        kl = -0.5 * (1 + torch.log(std**2) - mean**2 - std**2).mean()
        vae_loss = ((decoded - a) ** 2).mean() + 0.5 * kl
        step(self.vae_adam, vae_loss)

        with torch.no_grad():
            repeated, actions = self.candidates(self.target_actor, next_s, noise["target"])
            q1, q2 = (critic(repeated, actions) for critic in self.target_critics)
            q = self.soft_minimum * torch.min(q1, q2) + (1 - self.soft_minimum) * torch.max(q1, q2)
            best = q.view(len(s), -1).max(1).values
            y = r + (1 - done) * self.discount * best
        critic_loss = sum(((critic(s, a)[:, 0] - y) ** 2).mean() for critic in self.critics)
        step(self.critic_adam, critic_loss)

        sampled = self.decode(s, noise["actor"].clamp(-0.5, 0.5)).detach()
        actor_loss = -self.critics[0](s, self.perturbed(self.actor, s, sampled)).mean()
        step(self.actor_adam, actor_loss)

        targets = [*self.target_critics, self.target_actor]
        follow([*self.critics, self.actor], targets, self.tau)
        return [x.item() for x in (vae_loss, critic_loss, actor_loss, y.mean())]


@dataclass
class ConditionalVae:
    """The embedding's conditional VAE on standardised transitions."""

    s: int
    a: int
    size: int
    hidden: Sequence[int]
    rate: float
    kl_weight: float

    def __post_init__(self) -> None:
        self.encoder = Network(2 * self.s + self.a, self.hidden, 2 * self.size)
        self.decoder = Network(2 * self.s + self.size, self.hidden, self.a)
        parameters = [*self.encoder.parameters(), *self.decoder.parameters()]
        self.adam = torch.optim.Adam(parameters, lr=self.rate)

    def fit_moments(self, s: Tensor, a: Tensor) -> None:
        self.s_mean, self.s_std = s.mean(0), s.std(0, correction=0) + 1e-3
        self.a_mean, self.a_std = a.mean(0), a.std(0, correction=0) + 1e-3

    def standardised(self, s: Tensor, a: Tensor, next_s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return (
            (s - self.s_mean) / self.s_std,
            (a - self.a_mean) / self.a_std,
            (next_s - self.s_mean) / self.s_std,
        )

    def embed(self, s: Tensor, a: Tensor, next_s: Tensor) -> Tensor:
        with torch.no_grad():
            return self.encoder(*self.standardised(s, a, next_s))[:, : self.size]

    def update(self, batch: Sequence[Tensor], noise: Tensor) -> list[float]:
        s, a, next_s = self.standardised(batch[0], batch[1], batch[3])
        mean, log_std = self.encoder(s, a, next_s).chunk(2, -1)
        log_std = log_std.clamp(-8, 4)
        decoded = self.decoder(s, next_s, mean + torch.exp(log_std) * noise)
        kl = 0.5 * (torch.exp(2 * log_std) + mean**2 - 1 - 2 * log_std).sum(1).mean()
        loss = ((decoded - a) ** 2).mean() + self.kl_weight * kl
        step(self.adam, loss)
        return [loss.item()]


def step(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()


def follow(networks: Sequence[Network], targets: Sequence[Network], tau: float) -> None:
    """Polyak averaging."""
    with torch.no_grad():
        for network, target in zip(networks, targets, strict=True):
            for p, average in zip(network.parameters(), target.parameters(), strict=True):
                average.copy_(tau * p + (1 - tau) * average)


def nearest_l1(queries: Float, references: Float) -> Float:
    """min over D of ||e - e*||_1, one pair at a time."""
    return np.array([min(np.abs(q - r).sum() for r in references) for q in queries])


def match_by_value(q: Float, online_q: Float) -> NDArray[np.int64]:
    """arg min over D of |Q - Q*|, densely."""
    return np.abs(q[:, None] - online_q[None, :]).argmin(1)


def value_distance(v: Float, matched: Float, normaliser: str) -> Float:
    """d_q(s', s'*) of the paper, and with the two other normalisers."""
    if normaliser == "paper":
        return np.abs(v / v.mean() - matched / matched.mean())
    if normaliser == "shared":
        return np.abs(v - matched) / abs(np.concatenate([v, matched]).mean())
    return np.abs((v - matched) / matched)


def priorities(distances: Float, alpha: float) -> Float:
    """Eq. 3: P(j) of each transition, rank 1 the nearest, ties in order."""
    order = sorted(range(len(distances)), key=lambda j: distances[j])
    weight = np.zeros(len(distances))
    for position, j in enumerate(order):
        weight[j] = (1.0 / (position + 1)) ** alpha
    return weight / weight.sum()


def prioritized(
    distances: Float, alpha: float, noise: Float, count: int, with_replacement: bool
) -> list[int]:
    """Sample by Eq. 3 from standard exponential noise.

    With replacement: the inverse of the cumulative distribution over ranks. Without: the
    transitions whose exponential clock of rate P(j) rings first, the clocks being in rank order
    (another form of the Gumbel top-k).
    """
    chances = priorities(distances, alpha)
    order = sorted(range(len(distances)), key=lambda j: distances[j])
    if with_replacement:
        cumulative = np.cumsum(chances[order])
        quantiles = 1 - np.exp(-noise[:count])
        return [order[int(np.argmax(cumulative >= u))] for u in quantiles]
    clocks = [noise[position] / chances[j] for position, j in enumerate(order)]
    return [order[p] for p in sorted(range(len(order)), key=lambda p: clocks[p])[:count]]


class Standardised:
    """What plain algorithms have in common whose networks see states standardised by B_0."""

    def fit_normaliser(self, s: Tensor) -> None:
        self.mean = s.sum(0) / len(s)
        self.std = torch.sqrt(((s - self.mean) ** 2).sum(0) / len(s)) + 1e-3

    def standard(self, s: Tensor) -> Tensor:
        return (s - self.mean) / self.std
