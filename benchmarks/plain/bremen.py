"""Plain BREMEN: minibatch updates of models and clone, and improvements of the policy by TRPO."""

from collections.abc import Callable
from copy import deepcopy
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.distributions import Independent, Normal, kl_divergence
from torch.nn.functional import mse_loss
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from otc_dist.algorithms.bremen.algorithm import BremenSection
from otc_dist.spec import AgentSpec, Task
from otc_dist.transitions import Transitions

from .parts import Minibatches, follow, mlp, moments, normalised, step


class PlainBremen:
    """Models one after another, as a loop over an ensemble is usually written."""

    def __init__(
        self, section: BremenSection, spec: AgentSpec, data: Transitions, task: Task
    ) -> None:
        s, a, hidden = spec.observation_size, spec.action_size, section.hidden
        self.section, self.task = section, task
        self.minibatches = Minibatches(data, section.batch_size)
        states, actions, _, next_states, _ = self.minibatches.fields
        self.state_moments, self.action_moments = moments(states), moments(actions)
        self.change_moments = moments(next_states - states)
        self.models = nn.ModuleList(mlp(s + a, hidden, s) for _ in range(section.models))
        self.clone, self.rate = mlp(s, hidden, a), section.average_rate
        self.average_models, self.average_clone = deepcopy(self.models), deepcopy(self.clone)
        adam = torch.optim.Adam
        self.model_adam = adam(self.models.parameters(), section.model_learning_rate)
        self.clone_adam = adam(self.clone.parameters(), section.actor_learning_rate)
        self.policy, self.values = mlp(s, hidden, a), mlp(s, (64, 64), 1)
        self.value_adam = adam(self.values.parameters(), 1e-3)

    def update(self) -> list[float]:
        s, a, _, next_s, _ = self.minibatches.sample()
        x = normalised(s, self.state_moments)
        pair = torch.cat((x, normalised(a, self.action_moments)), 1)
        change = normalised(next_s - s, self.change_moments)

        model_loss = torch.zeros(())
        for model in self.models:
            model_loss = model_loss + mse_loss(model(pair), change)
        step(self.model_adam, model_loss)
        clone_loss = mse_loss(self.clone(x).tanh(), a)
        step(self.clone_adam, clone_loss)
        follow(self.average_models, self.models, self.rate)
        follow(self.average_clone, self.clone, self.rate)
        return [model_loss.item(), clone_loss.item()]

    def improve(self) -> list[float]:
        """Rollouts in the averaged models, one step of TRPO, and a fit of the value function."""
        with torch.no_grad():
            x, actions, rewards, advantages, targets = self.rollouts(self.minibatches.sample()[0])
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        length = self.trust_region_step(x, actions, advantages)
        for _ in range(100):
            rows = torch.randint(len(x), (512,))
            step(self.value_adam, mse_loss(self.values(x[rows]).squeeze(-1), targets[rows]))
        return [rewards.mean().item(), length]

    def rollouts(self, starts: Tensor) -> tuple[Tensor, ...]:
        """Normalised states, actions, rewards, advantages and returns of all steps, in one row."""
        section, s, steps = self.section, starts, []
        which = torch.randint(section.models, (section.horizon,)).tolist()
        mean, std = self.change_moments
        for model in which:
            x = normalised(s, self.state_moments)
            drawn = self.acting(x).sample()
            a = drawn.clamp(-1, 1)
            pair = torch.cat((x, normalised(a, self.action_moments)), 1)
            next_s = s + mean + std * self.average_models[model](pair)
            reward, end = self.task.reward(s, a, next_s), self.task.terminated(next_s)
            steps.append((x, drawn, reward, end.float()))
            others = starts[torch.randint(len(starts), (len(starts),))]
            s = torch.where(end.unsqueeze(-1), others, next_s)
        x, actions, rewards, ends = (torch.stack(part) for part in zip(*steps, strict=True))
        last = normalised(s, self.state_moments).unsqueeze(0)
        values = self.values(torch.cat((x, last))).squeeze(-1)
        advantage, found = torch.zeros(len(starts)), []
        for t in reversed(range(len(x))):
            going_on = section.discount * (1 - ends[t])
            error = rewards[t] + going_on * values[t + 1] - values[t]
            advantage = error + section.trace * going_on * advantage
            found.append(advantage)
        advantages = torch.stack(found[::-1])
        returns = advantages + values[:-1]
        return tuple(part.flatten(0, 1) for part in (x, actions, rewards, advantages, returns))

    def acting(self, x: Tensor) -> Independent:
        return Independent(Normal(self.policy(x).tanh(), self.section.std), 1)

    def trust_region_step(self, x: Tensor, actions: Tensor, advantages: Tensor) -> float:
        """The length of the step, 0 if none was accepted; every ninth state enters the Fisher
        matrix.
        """
        parameters = list(self.policy.parameters())
        with torch.no_grad():
            old, old_some = self.acting(x), self.acting(x[::9])
            old_density = old.log_prob(actions)

        def gain() -> Tensor:
            ratio = torch.exp(self.acting(x).log_prob(actions) - old_density)
            return ((ratio - 1) * advantages).mean()

        gradient = flat(torch.autograd.grad(gain(), parameters))
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
                near = kl_divergence(old, self.acting(x)).mean() <= self.section.radius
                if near and gain() > 0.1 * length * (gradient @ full):
                    return length
            vector_to_parameters(before, parameters)
        return 0.0


class BremenProducts:
    """The matrix products of an update alone, of all models at once: no code can be quicker.

    Of each layer of the models and the clone: forward, for its weights, and for its inputs but
    for the first layer's.
    """

    def __init__(self, section: BremenSection, spec: AgentSpec) -> None:
        s, a, hidden, batch = (
            spec.observation_size,
            spec.action_size,
            section.hidden,
            section.batch_size,
        )
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
    """Ten iterations for x with A x = b."""
    solution, residual, direction = torch.zeros_like(target), target, target
    square = residual @ residual
    for _ in range(10):
        image = product(direction)
        size = square / (direction @ image)
        solution, residual = solution + size * direction, residual - size * image
        before, square = square, residual @ residual
        direction = residual + square / before * direction
    return solution
