"""Plain BREMEN: minibatch updates of models and clone, and improvements of the policy by TRPO."""

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.distributions import Independent, Normal, kl_divergence
from torch.nn.functional import mse_loss
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from otc_dist.algorithms.bremen.algorithm import BremenSection
from otc_dist.spec import Task

from .parts import Statistics, follow, mlp, normalised, statistics, step

VALUE_STEPS, VALUE_BATCH = 100, 512


class PlainBremen:
    """BREMEN of Matsushima et al., 2021, with the constants of their code's commands.

    Models one after another, as a loop over an ensemble is usually written.
    """

    standardised = False  # as a whole: it has statistics of its own, which `fit_statistics` finds

    def __init__(
        self, section: BremenSection, s: int, a: int, task: Task, dtype: torch.dtype = torch.float32
    ) -> None:
        hidden = section.hidden
        self.section, self.action_size, self.task, self.updates = section, a, task, 0
        self.statistics: dict[str, Statistics] = {}
        self.models = nn.ModuleList(mlp(s + a, hidden, s, dtype) for _ in range(section.models))
        self.clone, self.policy = mlp(s, hidden, a, dtype), mlp(s, hidden, a, dtype)
        self.average_models, self.average_clone = deepcopy(self.models), deepcopy(self.clone)
        adam = torch.optim.Adam
        self.model_adam = adam(self.models.parameters(), section.model_learning_rate)
        self.clone_adam = adam(self.clone.parameters(), section.actor_learning_rate)
        self.values = mlp(s, (64, 64), 1, dtype)
        self.value_adam = adam(self.values.parameters(), 1e-3)

    def fit_statistics(self, offline: Sequence[Tensor]) -> None:
        """Those of B_0, once: of inputs and outputs of the models, and of rewards."""
        s, a, r, next_s, _ = offline
        fields = {"observation": s, "action": a, "change": next_s - s}
        self.statistics = {name: statistics(values) for name, values in fields.items()}
        self.value_scale = r.square().mean().sqrt() / (1 - self.section.discount)

    def normal(self, name: str, values: Tensor) -> Tensor:
        return normalised(values, self.statistics[name])

    def sample_noise(self, count: int) -> dict[str, Tensor]:
        return {}

    def update(self, batch: Sequence[Tensor], noise: Mapping[str, Tensor]) -> list[float]:
        """The mean loss of the models, and the clone's."""
        s, a, _, next_s, _ = batch
        x = self.normal("observation", s)
        pair = torch.cat((x, self.normal("action", a)), 1)
        change = self.normal("change", next_s - s)

        model_loss = torch.zeros((), dtype=s.dtype)
        for model in self.models:
            model_loss = model_loss + mse_loss(model(pair), change)
        step(self.model_adam, model_loss)
        clone_loss = mse_loss(self.clone(x).tanh(), a)
        step(self.clone_adam, clone_loss)

        self.updates += 1
        rate = max(self.section.average_rate, 1 / (1 + (self.updates - 1) / 10))
        follow(self.average_models, self.models, rate)
        follow(self.average_clone, self.clone, rate)
        return [model_loss.item() / len(self.models), clone_loss.item()]

    def sample_improvement_noise(self, count: int) -> dict[str, Tensor]:
        horizon = self.section.horizon
        return {
            "action": torch.randn(horizon, count, self.action_size),
            "model": torch.rand(horizon),
            "restart": torch.rand(horizon, count),
            "value": torch.rand(VALUE_STEPS, VALUE_BATCH),
        }

    def improve(self, starts: Tensor, noise: Mapping[str, Tensor]) -> list[float]:
        """Rollouts in the averaged models, one step of TRPO, and a fit of the value function.

        Returns:
            Mean reward and ends, std of the value's error over its targets', gain, divergence and
            length of the step.
        """
        with torch.no_grad():
            x, actions, rewards, ends, last = self.rollouts(starts, noise)
            advantages, targets = self.advantages(x, rewards, ends, last)
        x, actions, advantages, targets = (
            part.flatten(0, 1) for part in (x, actions, advantages, targets)
        )
        centred = (advantages - advantages.mean()) / (advantages.std(correction=0) + 1e-8)
        taken = self.trust_region_step(x, actions, centred)
        wanted = targets / self.value_scale
        for rows in (noise["value"] * len(x)).long():
            step(self.value_adam, mse_loss(self.value(x[rows]), wanted[rows]))
        error = advantages.std() / targets.std()
        return [*(found.item() for found in (rewards.mean(), ends.mean(), error)), *taken]

    def rollouts(self, starts: Tensor, noise: Mapping[str, Tensor]) -> tuple[Tensor, ...]:
        """Normalised states (H, B, s), actions as drawn (H, B, a), rewards and ends (H, B), and
        the normalised states after all of them (B, s).
        """
        s, steps, mean, std = starts, [], *self.statistics["change"]
        which = (noise["model"] * len(self.models)).long().tolist()
        restarts = (noise["restart"] * len(starts)).long()
        for t, model in enumerate(which):
            x = self.normal("observation", s)
            drawn = self.mean(x) + self.section.std * noise["action"][t]
            a = drawn.clamp(-1, 1)
            pair = torch.cat((x, self.normal("action", a)), 1)
            next_s = s + mean + std * self.average_models[model](pair)
            reward, end = self.task.reward(s, a, next_s), self.task.terminated(next_s)
            steps.append((x, drawn, reward, end.to(s.dtype)))
            s = torch.where(end.unsqueeze(-1), starts[restarts[t]], next_s)
        x, actions, rewards, ends = (torch.stack(part) for part in zip(*steps, strict=True))
        return x, actions, rewards, ends, self.normal("observation", s)

    def advantages(
        self, x: Tensor, rewards: Tensor, ends: Tensor, last: Tensor
    ) -> tuple[Tensor, Tensor]:
        """By GAE (H, B), and the returns (H, B) that V is to learn."""
        values = self.value_scale * self.value(torch.cat((x, last.unsqueeze(0))))
        advantage, found = torch.zeros_like(last[:, 0]), []
        for t in reversed(range(len(x))):
            going_on = self.section.discount * (1 - ends[t])
            error = rewards[t] + going_on * values[t + 1] - values[t]
            advantage = error + self.section.trace * going_on * advantage
            found.append(advantage)
        advantages = torch.stack(found[::-1])
        return advantages, advantages + values[:-1]

    def value(self, x: Tensor) -> Tensor:
        """V of normalised states, in units of the value scale."""
        value: Tensor = self.values(x.clamp(-10, 10)).squeeze(-1)
        return value

    def act(self, s: Tensor) -> Tensor:
        return self.mean(self.normal("observation", s))

    def mean(self, x: Tensor) -> Tensor:
        mean: Tensor = self.policy(x).tanh()
        return mean

    def acting(self, x: Tensor) -> Independent:
        return Independent(Normal(self.mean(x), self.section.std), 1)

    def trust_region_step(self, x: Tensor, actions: Tensor, advantages: Tensor) -> list[float]:
        """Gain, divergence and length of the step, 0 if none was accepted; every ninth state
        enters the Fisher matrix.
        """
        parameters = list(self.policy.parameters())
        with torch.no_grad():
            old, old_some = self.acting(x), self.acting(x[::9])
            old_density = old.log_prob(actions)

        def gain(new: Independent) -> Tensor:
            return (torch.expm1(new.log_prob(actions) - old_density) * advantages).mean()

        gradient = flat(torch.autograd.grad(gain(self.acting(x)), parameters))
        divergence = kl_divergence(old_some, self.acting(x[::9])).mean()
        slope = flat(torch.autograd.grad(divergence, parameters, create_graph=True))

        def fisher(vector: Tensor) -> Tensor:
            product = torch.autograd.grad(slope @ vector, parameters, retain_graph=True)
            return flat(product) + 0.1 * vector

        direction = conjugate_gradient(fisher, gradient)
        scale = torch.sqrt(2 * self.section.radius / (direction @ fisher(direction)))
        full, before = scale * direction, parameters_to_vector(parameters).detach()
        with torch.no_grad():
            for length in (0.8**exponent for exponent in range(10)):
                vector_to_parameters(before + length * full, parameters)
                new = self.acting(x)
                gained, diverged = gain(new), kl_divergence(old, new).mean()
                if diverged <= self.section.radius and gained > 0.1 * length * (gradient @ full):
                    return [gained.item(), diverged.item(), length]
            vector_to_parameters(before, parameters)
        return [0.0, 0.0, 0.0]


class BremenProducts:
    """The matrix products of an update alone, of all models at once: no code can be quicker.

    Of each layer of the models and the clone: forward, for its weights, and for its inputs but
    for the first layer's.
    """

    def __init__(self, section: BremenSection, s: int, a: int) -> None:
        hidden, batch = section.hidden, section.batch_size
        self.layers = []
        for count, sizes in ((section.models, (s + a, *hidden, s)), (1, (s, *hidden, a))):
            for i, (fan_in, fan_out) in enumerate(pairwise(sizes)):
                x, gradient = torch.randn(count, batch, fan_in), torch.randn(count, batch, fan_out)
                self.layers.append((i > 0, x, torch.randn(count, fan_in, fan_out), gradient))

    def update(self) -> None:
        for inner, x, weights, gradient in self.layers:
            torch.bmm(x, weights)
            torch.bmm(x.mT, gradient)
            if inner:
                torch.bmm(gradient, weights.mT)


def flat(tensors: tuple[Tensor, ...]) -> Tensor:
    return torch.cat([tensor.reshape(-1) for tensor in tensors])


def conjugate_gradient(product: Callable[[Tensor], Tensor], target: Tensor) -> Tensor:
    """The tenth iterate for A x = b, by what characterises it: the minimiser of
    x^T A x / 2 - b^T x over the span of b, A b, ..., A^9 b (Nocedal and Wright, Theorem 5.2).
    """
    basis, images, following = [], [], target
    for _ in range(10):
        basis.append(following / following.norm())
        images.append(product(basis[-1]))
        span, following = torch.stack(basis), images[-1]
        for _ in range(2):  # once leaves a rounding error
            following = following - span.T @ (span @ following)
        if following.norm() < 1e-8:  # the span holds the solution
            break
    return span.T @ torch.linalg.solve(span @ torch.stack(images).T, span @ target)
