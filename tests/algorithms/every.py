"""Every algorithm that the description knows, small: its settings, agents, data and learners."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from otc_dist.algorithms import create
from otc_dist.algorithms.interface import Algorithm, Batch
from otc_dist.description import Description
from otc_dist.description.kinds import ALGORITHMS
from otc_dist.learner.learner import Learner
from otc_dist.spec import AgentSpec
from otc_dist.steps.noise import NoiseSpec, sample_noise
from otc_dist.steps.state import State
from otc_dist.transitions import Transitions

from ..brains import ONLINE, SMALL, SPEC, silent, transitions, unsaved
from .arrays import random_batch, random_choices

SECTIONS: dict[str, Any] = {name: ALGORITHMS.section(name) for name in ALGORITHMS}
# Where the defaults would take time, beside what a section's `brief` says.
SMALLER: dict[str, dict[str, object]] = {
    "bcq": {"acting_candidates": 7},
    "cql": {"action_samples": 3},
    "bremen": {"models": 2, "horizon": 3},
}
CHOICES = 4
CHOOSING = AgentSpec("agent_0", 5 + CHOICES, (0.0,), (CHOICES - 1.0,), choices=CHOICES)
BATCH, OFFLINE_UPDATES, TUNING_UPDATES = 16, 8, 3
EACH = pytest.mark.parametrize("name", SECTIONS)
IN_BOTH_PRECISIONS = pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
DISCRETE = [name for name, section in SECTIONS.items() if section.discrete]


class FirstEntry:
    """A task: reach far along the first entry of the observation."""

    def reward(self, observation: Any, action: Any, next_observation: Any) -> Any:
        return next_observation[..., 0] - 0.1 * (action**2).sum(-1)

    def terminated(self, next_observation: Any) -> Any:
        return next_observation[..., 0] > 2


def describe(name: str, *assignments: str, env: str = "hopper-3x1") -> Description:
    """Small, tuned by OTC with d_e, which every algorithm can."""
    sizes = ALGORITHMS.kept({"hidden": [8, 8], "batch_size": BATCH}, name)
    algorithm = {"name": name, **sizes, **SMALLER.get(name, {})}
    data = {
        **SMALL,
        "env": {"id": env},
        "algorithm": algorithm,
        "embedding": {**SMALL["embedding"], "updates": 3},
        "offline": {"updates": OFFLINE_UPDATES},
        "deployment": {"count": 2, "transitions": ONLINE, "updates": TUNING_UPDATES},
    }
    return Description.build(data, (*SECTIONS[name].brief, *assignments))


def spec_for(name: str) -> AgentSpec:
    return CHOOSING if SECTIONS[name].discrete else SPEC


def data_for(spec: AgentSpec, seed: int, count: int) -> Transitions:
    if not spec.choices:
        return transitions(seed, count, spec)
    batch = random_choices(np.random.default_rng(seed), spec.observation_size, spec.choices, count)
    s, a, r, next_s, done = (field.numpy().astype(np.float32) for field in batch)
    return Transitions(s, a, r, next_s, done > 0, np.zeros(count, np.bool_))


def brain(name: str, *assignments: str, spec: AgentSpec | None = None, **arguments: Any) -> Learner:
    spec = spec or spec_for(name)
    data = arguments.pop("data", None) or data_for(spec, 0, 200)
    return Learner(describe(name, *assignments, **arguments), spec, data, FirstEntry())


def pretrained(name: str, *assignments: str, **arguments: Any) -> Learner:
    learner = brain(name, *assignments, **arguments)
    learner.pretrain(silent, unsaved)
    return learner


def online(name: str, deployment: int) -> Transitions:
    return data_for(spec_for(name), 100 + deployment, ONLINE)


class Trial:
    """One algorithm with a state, a batch and noise, in one precision."""

    def __init__(self, name: str, dtype: torch.dtype = torch.float32) -> None:
        self.spec, self.dtype, self.name = spec_for(name), dtype, name
        self.algorithm: Algorithm = create(describe(name).algorithm, self.spec, FirstEntry())
        self.random = np.random.default_rng(0)
        self.batch = self.batch_of(BATCH)
        self.initial = self.algorithm.initial_state(self.random, self.batch_of(50, torch.float32))
        self.state = {key: self.cast(torch.from_numpy(x)) for key, x in self.initial.items()}

    def batch_of(self, size: int, dtype: torch.dtype | None = None) -> Batch:
        spec = self.spec
        make, actions = (random_choices, spec.choices) if spec.choices else (random_batch, 2)
        batch = make(self.random, spec.observation_size, actions, size)
        return Batch(*(field.to(dtype or self.dtype) for field in batch))

    def noise(self, specs: Mapping[str, NoiseSpec]) -> dict[str, Tensor]:
        """Noise for one call."""
        arrays = sample_noise(np.random.default_rng(1), specs, 1)
        return {key: torch.from_numpy(array[0]).to(self.dtype) for key, array in arrays.items()}

    def cast(self, tensor: Tensor) -> Tensor:
        return tensor.to(self.dtype) if tensor.is_floating_point() else tensor

    def update(self, state: State) -> tuple[State, Tensor]:
        noise = self.noise(self.algorithm.noise_spec(BATCH))
        return self.algorithm.update(state, self.batch, self.batch, noise)
