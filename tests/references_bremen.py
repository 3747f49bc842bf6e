"""Plain BREMEN in float64: torch modules with autograd and torch.optim.Adam for models and clone,
one rollout after another, sums written out, and TRPO with an explicit Fisher matrix.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from otc_dist.spec import Task

from .references import Float, Network, get_flat, set_flat, step


@dataclass
class Bremen:
    """BREMEN of Matsushima et al., 2021, with the constants of their code's commands."""

    task: Task
    s: int
    a: int
    hidden: Sequence[int]
    clone_rate: float
    model_rate: float
    horizon: int
    std: float
    radius: float
    count: int = 5
    discount: float = 0.99
    trace: float = 0.95

    def __post_init__(self) -> None:
        s, a, hidden = self.s, self.a, self.hidden
        self.models = [Network(s + a, hidden, s) for _ in range(self.count)]
        self.clone, self.policy = Network(s, hidden, a), Network(s, hidden, a)
        adam = torch.optim.Adam
        self.model_adams = [adam(model.parameters(), lr=self.model_rate) for model in self.models]
        self.clone_adam = adam(self.clone.parameters(), lr=self.clone_rate)
        self.value_network = Network(s, (64, 64), 1)
        self.value_adam = adam(self.value_network.parameters(), lr=1e-3)
        self.averages: dict[str, Tensor] = {}
        self.updates = 0

    def load(self, state: Mapping[str, Tensor]) -> None:
        set_flat(self.models, state["models"], twins=True)
        set_flat([self.clone], state["clone"])
        set_flat([self.policy], state["policy"])
        set_flat([self.value_network], state["value"])
        self.averages = {name: state[f"{name}_average"].clone() for name in ("models", "clone")}

    def weights(self) -> dict[str, Tensor]:
        return {
            "models": get_flat(self.models, twins=True),
            "clone": get_flat([self.clone]),
            "policy": get_flat([self.policy]),
            "value": get_flat([self.value_network]),
            "models_average": self.averages["models"],
            "clone_average": self.averages["clone"],
        }

    def averaged(self) -> list[Network]:
        """The models that rollouts use."""
        networks = [Network(self.s + self.a, self.hidden, self.s) for _ in self.models]
        set_flat(networks, self.averages["models"], twins=True)
        return networks

    def fit_normalisers(self, s: Tensor, a: Tensor, next_s: Tensor) -> dict[str, Tensor]:
        self.moments = {}
        for name, x in (("observation", s), ("action", a), ("change", next_s - s)):
            mean = x.sum(0) / len(x)
            std = (((x - mean) ** 2).sum(0) / len(x)).sqrt() + 1e-3
            self.moments |= {f"{name}_mean": mean, f"{name}_std": std}
        return self.moments

    def normal(self, name: str, x: Tensor) -> Tensor:
        return (x - self.moments[f"{name}_mean"]) / self.moments[f"{name}_std"]

    def update(self, batch: Sequence[Tensor], noise: Mapping[str, Tensor]) -> list[float]:
        """One update; the mean loss of the models, and the clone's."""
        s, a, _, next_s, _ = batch
        losses = []
        for model, adam in zip(self.models, self.model_adams, strict=True):
            predicted = model(self.normal("observation", s), self.normal("action", a))
            loss = ((predicted - self.normal("change", next_s - s)) ** 2).mean()
            step(adam, loss)
            losses.append(loss.item())
        clone_loss = ((self.mean(self.clone, s) - a) ** 2).mean()
        step(self.clone_adam, clone_loss)
        self.updates += 1
        weight = max(0.02, 1 / (1 + (self.updates - 1) / 10))
        for name, weights in self.weights().items():
            if name in self.averages:
                kept = self.averages[name]
                self.averages[name] = weight * weights + (1 - weight) * kept
        return [sum(losses) / len(losses), clone_loss.item()]

    def mean(self, policy: Network, s: Tensor) -> Tensor:
        return torch.tanh(policy(self.normal("observation", s)))

    def fit_value_scale(self, rewards: Tensor) -> Tensor:
        self.value_scale = torch.sqrt((rewards**2).sum() / len(rewards)) / (1 - self.discount)
        return self.value_scale

    def value(self, s: Tensor) -> Tensor:
        bounded = self.normal("observation", s).clamp(-10, 10)
        return self.value_scale * self.value_network(bounded)[..., 0]

    def improve(self, starts: Tensor, noise: Mapping[str, Tensor]) -> list[float]:
        """One improvement; mean reward and ends, std of the value's error over its targets', gain,
        divergence and length of the step.
        """
        with torch.no_grad():
            episodes, ends = self.rollouts(starts, noise)
            values = [self.value(torch.stack(states)).tolist() for states, *_ in episodes]
        advantages = [self.advantages(*episode) for episode in episodes]
        targets = [
            advantage + value
            for of_states, found in zip(values, advantages, strict=True)
            for value, advantage in zip(of_states, found, strict=True)
        ]
        # In the order of time, then rollout, as every ninth state enters the Fisher matrix.
        order = np.argsort(np.concatenate([place for *_, place in episodes]))
        states = torch.stack([s for states, *_ in episodes for s in states])[order]
        actions = torch.stack([a for _, actions, *_ in episodes for a in actions])[order]
        raw = np.concatenate(advantages)[order]
        scaled = torch.from_numpy((raw - raw.mean()) / (raw.std() + 1e-8))

        old = self.mean(self.policy, states).detach()

        def gain(policy: Network) -> Tensor:
            new_density, old_density = (
                torch.distributions.Normal(mean, self.std).log_prob(actions).sum(1)
                for mean in (self.mean(policy, states), old)
            )
            return (torch.exp(new_density - old_density) * scaled).mean() - scaled.mean()

        def divergence(policy: Network, rows: slice = slice(None)) -> Tensor:
            new, before = (
                torch.distributions.Normal(mean[rows], self.std)
                for mean in (self.mean(policy, states), old)
            )
            return torch.distributions.kl_divergence(before, new).sum(1).mean()

        fisher = self.fisher(states[::9])
        taken = trust_region(self.policy, gain, divergence, fisher, self.radius)

        wanted = torch.tensor(targets)[order]
        for chosen in noise["value"]:
            rows = (chosen * len(states)).long()
            error = (self.value(states[rows]) - wanted[rows]) / self.value_scale
            step(self.value_adam, (error**2).mean())
        rewards = [r for _, _, rewards, *_ in episodes for r in rewards]
        return [float(np.mean(rewards)), ends, np.std(raw) / np.std(targets), *taken]

    def rollouts(self, starts: Tensor, noise: Mapping[str, Tensor]) -> tuple[list[Any], float]:
        """Episodes (states, actions, rewards, state after, whether it ended there, places)."""
        episodes, ends, models = [], 0, self.averaged()
        for b in range(len(starts)):
            states, actions, rewards, places = [], [], [], []
            s = starts[b]
            for t in range(self.horizon):
                a = self.mean(self.policy, s) + self.std * noise["action"][t, b]
                bounded = a.clamp(-1, 1)
                model = models[int(noise["model"][t] * self.count)]
                change = model(self.normal("observation", s), self.normal("action", bounded))
                moments = self.moments
                next_s = s + change * moments["change_std"] + moments["change_mean"]
                states.append(s)
                actions.append(a)
                rewards.append(float(self.task.reward(s, bounded, next_s)))
                places.append(t * len(starts) + b)
                s = next_s
                if self.task.terminated(next_s):
                    ends += 1
                    episodes.append((states, actions, rewards, next_s, True, places))
                    states, actions, rewards, places = [], [], [], []
                    s = starts[int(noise["restart"][t, b] * len(starts))]
            if states:
                episodes.append((states, actions, rewards, s, False, places))
        return episodes, ends / (len(starts) * self.horizon)

    def advantages(
        self,
        states: list[Tensor],
        actions: list[Tensor],
        rewards: list[float],
        after: Tensor,
        ended: bool,
        places: list[int],
    ) -> Float:
        """sum_l (gamma lambda)^l d_{t+l} of one episode, d = r + gamma V(s') - V(s)."""
        with torch.no_grad():
            values = [float(self.value(s)) for s in [*states, after]]
        values[-1] *= not ended
        errors = [
            reward + self.discount * values[t + 1] - values[t] for t, reward in enumerate(rewards)
        ]
        decay = self.discount * self.trace
        return np.array(
            [
                sum(decay**i * error for i, error in enumerate(errors[t:]))
                for t in range(len(errors))
            ]
        )

    def fisher(self, states: Tensor) -> Float:
        """mean_s J^T J / std^2, J the Jacobian of the policy's mean."""
        total = 0.0
        for s in states:
            mean = self.mean(self.policy, s)
            jacobian = np.stack([gradient(self.policy, component) for component in mean])
            total = total + jacobian.T @ jacobian / self.std**2
        return np.asarray(total) / len(states)


def gradient(policy: Network, value: Tensor) -> Float:
    """In the order of the flat vector."""
    found = torch.autograd.grad(value, list(policy.parameters()), retain_graph=True)
    return torch.cat([part.reshape(len(part), -1).T.reshape(-1) for part in found]).numpy()


def trust_region(
    policy: Network,
    gain: Callable[[Network], Tensor],
    divergence: Callable[[Network], Tensor],
    fisher: Float,
    radius: float,
) -> list[float]:
    """Move `policy` by one step of TRPO; gain, divergence and length of the step."""
    damped = fisher + 0.1 * np.eye(len(fisher))
    g = gradient(policy, gain(policy))
    direction = conjugate_gradient(damped, g)
    full = np.sqrt(2 * radius / (direction @ damped @ direction)) * direction
    old = get_flat([policy])
    for exponent in range(10):
        length = 0.8**exponent
        set_flat([policy], old + torch.from_numpy(length * full))
        with torch.no_grad():
            gained, diverged = gain(policy).item(), divergence(policy).item()
        if gained > 0 and gained > 0.1 * length * (g @ full) and diverged <= radius:
            return [gained, diverged, length]
    set_flat([policy], old)
    return [0.0, 0.0, 0.0]


def conjugate_gradient(matrix: Float, target: Float) -> Float:
    """The tenth iterate of conjugate gradients for matrix x = target, by what characterises it:
    the minimiser of x^T matrix x / 2 - target^T x over the span of target, matrix target, ...,
    matrix^9 target (Nocedal and Wright, Theorem 5.2).
    """
    basis = [target / np.linalg.norm(target)]
    for _ in range(9):
        following = matrix @ basis[-1]
        for _ in range(2):  # once leaves a rounding error
            for unit in basis:
                following = following - (unit @ following) * unit
        size = np.linalg.norm(following)
        if size < 1e-8:  # the span holds the solution
            break
        basis.append(following / size)
    span = np.stack(basis, axis=1)
    return np.asarray(span @ np.linalg.solve(span.T @ matrix @ span, span.T @ target))
