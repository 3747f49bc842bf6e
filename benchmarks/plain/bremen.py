"""Plain minibatch updates of BREMEN: the dynamics models and the behaviour clone."""

from copy import deepcopy
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss

from otc_dist.description.algorithms import BremenSection
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

from .parts import Minibatches, follow, mlp, step


class PlainBremen:
    """Models one after another, as a loop over an ensemble is usually written."""

    def __init__(self, section: BremenSection, spec: AgentSpec, data: Transitions) -> None:
        s, a, hidden = spec.observation_size, spec.action_size, section.hidden
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

    def update(self) -> list[float]:
        s, a, _, next_s, _ = self.minibatches.draw()
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


def moments(values: Tensor) -> tuple[Tensor, Tensor]:
    return values.mean(0), values.std(0) + 1e-3


def normalised(values: Tensor, of: tuple[Tensor, Tensor]) -> Tensor:
    mean, std = of
    return (values - mean) / std
