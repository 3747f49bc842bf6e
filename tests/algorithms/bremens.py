"""Small BREMENs, and what they begin with."""

from typing import Any

import numpy as np
import torch

from otc_dist.algorithms.bremen.algorithm import Bremen, BremenSection
from otc_dist.algorithms.interface import Batch
from otc_dist.steps.noise import sample_noise
from otc_dist.steps.state import State

from .arrays import double, first, random_batch
from .checks import BATCH, plainly


class Bounded:
    """Some task: forward costs effort, and ends where the first entry leaves an interval."""

    def reward(self, observation: Any, action: Any, next_observation: Any) -> Any:
        return next_observation[..., 0] + observation[..., 1] - 0.1 * (action * action).sum(-1)

    def terminated(self, next_observation: Any) -> Any:
        return abs(next_observation[..., 0]) > 1.0


class Endless(Bounded):
    def terminated(self, next_observation: Any) -> Any:
        return next_observation[..., 0] > np.inf


def make(
    s: int, a: int, hidden: tuple[int, ...], task: Bounded | None = None, **settings: Any
) -> Bremen:
    usual: dict[str, Any] = {
        "actor_learning_rate": 3e-4,
        "model_learning_rate": 5e-4,
        "average_rate": 0.02,
        "discount": 0.99,
        "models": 5,
        "improvements": 3,
        "horizon": 7,
        "std": 0.1,
        "trace": 0.95,
        "radius": 0.05,
    }
    section = BremenSection(hidden=hidden, **{**usual, **settings})
    return Bremen(s, a, section, task or Bounded())


def start(bremen: Bremen, random: np.random.Generator) -> tuple[State, Batch]:
    batch = random_batch(random, bremen.observation_size, bremen.action_size, BATCH)
    return double(bremen.initial_state(random, batch)), batch


def taught(bremen: Bremen, random: np.random.Generator) -> tuple[State, Batch]:
    """After 300 updates on  s' = s + (a, a)."""
    batch = random_batch(random, 2, 1, 256)
    batch = batch._replace(next_observation=batch.observation + batch.action)
    state = double(bremen.initial_state(random, batch))
    for _ in range(300):
        state, _ = bremen.update(state, batch, batch, {})
    return state, batch


def improved(bremen: Bremen, state: State, batch: Batch, seed: int) -> tuple[State, torch.Tensor]:
    specs = bremen.improvement_noise_spec(len(batch.observation))
    noise = first(sample_noise(np.random.default_rng(seed), specs, 1))
    with torch.no_grad():
        return bremen.improve(plainly, state, batch, noise)
